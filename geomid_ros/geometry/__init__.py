"""Floor 0: the geometry of physically possible inertias. Imports numpy only."""
