"""The front door: what notebooks and the command line call. ``import geomid_ros`` offers it."""
