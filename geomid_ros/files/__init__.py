"""Layer 5: bags, robot descriptions, configuration and results on disk."""
