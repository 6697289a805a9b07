"""Certainty of each named effect: held-out data, location of the gap, sizes and verdict."""
