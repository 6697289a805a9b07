"""Which effects are needed: score test, beam search, rivals."""
