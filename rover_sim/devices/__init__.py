"""Drives and sensors of a plant, with their watchdogs and errors."""
