"""What the controllers share: handover of a motor, and the client of the winch."""
