"""Public functions for notebooks and the command line, offered by ``import geomid_ros``."""
