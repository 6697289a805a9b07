"""Model files: URDF, MJCF, estimate.json, effects.yaml, gap.json."""
