"""Frames and markers for viewers such as RViz and Foxglove, besides the plant's topics."""
