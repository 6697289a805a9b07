"""Floor 1: the robot, what is measured on it, and the rows that measurements make."""
