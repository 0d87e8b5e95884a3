"""Prediction of jumps: the only room of the controllers that runs the plant."""
