"""Control with the identified model: feed-forward efforts for trajectories."""
