"""Runtime of the suite: components, the port that they speak to, and the hosts that carry them."""
