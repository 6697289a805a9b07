"""Physical effects beside the inertias."""
