"""Pure numerics of tether and rover: no ROS, no files, SI units."""
