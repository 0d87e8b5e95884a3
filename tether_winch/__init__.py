"""Winch controller of the mother machine; it uses the contract and its sensors, no ground truth."""
