"""Devices that are not there: drives, IMU and load cell on the link, played against the plant."""
