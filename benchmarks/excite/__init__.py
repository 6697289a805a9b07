"""Designed motions: whether they are safe, what they tell, and how long a design takes."""
