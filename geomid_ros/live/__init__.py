"""Threads and processes of a running node, without ROS."""
