"""Exciting trajectories: their form, feasibility and information, and the search for one."""
