"""The ROS 2 side: the only code that imports rclpy. Nodes translate messages and keep time."""
