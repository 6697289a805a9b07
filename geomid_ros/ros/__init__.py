"""The node, its messages and parameters, and the player: the only place that imports rclpy."""
