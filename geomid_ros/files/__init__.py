"""Floor 4: bags, robot descriptions, configuration and results on disk."""
