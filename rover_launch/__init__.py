"""What the launch files start; `plan` knows it without ROS, `description` tells it to `launch`."""
