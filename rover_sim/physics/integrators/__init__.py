"""Time steps of the whole plants: tether, rover, drives and ground together."""
