"""Layer 2: from rows to an estimate."""
