"""Floor 4: simulating what was recorded once more, in MuJoCo, from the model files that were written."""
