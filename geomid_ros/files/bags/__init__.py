"""Recordings: rosbag2 folders, .mcap and .db3 files."""
