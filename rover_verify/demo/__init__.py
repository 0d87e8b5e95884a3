"""Demonstrations: a mission and a jump, flown by the nodes."""
