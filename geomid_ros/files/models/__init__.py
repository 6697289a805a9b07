"""Model files: URDF, MJCF, estimate.json, posterior.npz, population.json, effects.yaml, gap.json."""
