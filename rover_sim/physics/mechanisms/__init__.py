"""Drives and mechanisms: winch drum, jump drive, wheel drive, slider, motor and shaft."""
