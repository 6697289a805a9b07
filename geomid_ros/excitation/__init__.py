"""Motions from which much is learned: their form, what makes them feasible, what they tell, and the search for one."""
