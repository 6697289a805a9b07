"""Runs a motion on a robot: finds its controller, monitors and records the motion."""
