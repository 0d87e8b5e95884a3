"""Launch plans of the suite, and their conversion to ROS 2 launch descriptions."""
