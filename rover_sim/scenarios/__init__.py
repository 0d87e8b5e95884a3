"""Scenarios: the shipped YAML files, and the sections they are read into."""
