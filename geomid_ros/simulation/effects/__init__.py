"""Physical effects in addition to the inertias."""
