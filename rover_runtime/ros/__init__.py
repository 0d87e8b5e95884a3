"""The ROS host: carries components as rclpy lifecycle nodes."""
