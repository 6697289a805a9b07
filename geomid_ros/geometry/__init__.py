"""Layer 0: geometry of physically consistent inertias. Imports numpy only."""
