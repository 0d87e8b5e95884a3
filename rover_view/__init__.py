"""What viewers such as RViz and Foxglove need besides the plant's topics: frames and pictures."""
