"""Numerics that every other room of the physics uses: compiled kernels, vectors, events."""
