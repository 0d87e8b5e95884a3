"""The hanging rover: estimate, damping, attitude, pointing, descent and its node."""
