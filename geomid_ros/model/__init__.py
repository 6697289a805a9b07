"""Layer 1: the robot, its measured channels, and the linear rows of measurements."""
