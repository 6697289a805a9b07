"""The ablation of named numbers."""
