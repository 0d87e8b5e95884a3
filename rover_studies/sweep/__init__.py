"""Sweeps: plans, workers, crash-safe results."""
