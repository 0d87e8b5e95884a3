"""The rover's two bodies at the end of the tether, in the plane and in space."""
