"""Geometric identification of link inertias, online and from rosbags."""

__version__ = "0.1.0"
