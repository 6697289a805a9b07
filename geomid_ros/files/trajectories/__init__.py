"""Motions on disk."""
