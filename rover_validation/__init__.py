"""Validation against measurements: identify the plant's laws from measured sets, predict others.

The sets are files that the user names; none comes with the suite.
"""
