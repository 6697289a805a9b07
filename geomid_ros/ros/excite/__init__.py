"""Runs a motion on a robot: finds its controller, watches over it and records it."""
