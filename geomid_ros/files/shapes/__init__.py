"""Meshes and shapes of links, for priors."""
