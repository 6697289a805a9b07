"""The node, its messages and parameters, and the bag player: the only package that imports rclpy."""
