"""The mission: plans, legs, interlocks and its node."""
