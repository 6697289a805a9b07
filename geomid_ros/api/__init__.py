"""Public functions for notebooks and the command line; ``import geomid_ros`` exposes them."""
