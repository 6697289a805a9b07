"""The node and the player as processes of their own, each test in a ROS domain of its own."""
