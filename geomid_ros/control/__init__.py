"""What was identified moves the robot: efforts for trajectories."""
