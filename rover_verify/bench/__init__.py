"""Speed of plant, messages, missions and sweeps, beside a peer."""
