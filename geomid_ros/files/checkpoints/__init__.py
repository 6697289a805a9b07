"""Checkpoints of a running node."""
