"""What it takes to run a motion on a robot, without ROS: limits, the ways to the start and to a stop, the watch."""
