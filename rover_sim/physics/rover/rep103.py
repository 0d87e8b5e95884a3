"""Conversion between the planar model's axes and those of REP-103.

The planar model has x horizontal, y up and angles counter-clockwise seen with y up and x to the
right. REP-103 has x forward, y left and z up. The plane is REP-103's x-z plane: the model's x is x,
its y is z, and its angle is a rotation about -y.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from rover_sim.physics.tether.ancf import Array


def vector(planar: ArrayLike) -> Array:
    """Positions, velocities, slopes or forces (..., 2) as (..., 3) in REP-103 axes."""
    source = np.asarray(planar, dtype=np.float64)
    target = np.zeros((*source.shape[:-1], 3))
    target[..., 0] = source[..., 0]
    target[..., 2] = source[..., 1]
    return target


def planar_vector(vector: ArrayLike) -> Array:
    """In-plane components (..., 2) of vectors (..., 3) in REP-103 axes."""
    return np.asarray(vector, dtype=np.float64)[..., [0, 2]]


def rotation_rate(omega: float) -> Array:
    """Angular velocity [rad/s] of the planar model as a vector (3,) in REP-103 axes."""
    return np.array([0.0, -omega, 0.0])


def quaternion(theta: float) -> Array:
    """Orientation (x, y, z, w), body to world, of a body turned by theta [rad]."""
    return np.array([0.0, -math.sin(0.5 * theta), 0.0, math.cos(0.5 * theta)])


def planar_angle(quaternion: ArrayLike) -> float:
    """Angle theta in (-pi, pi] [rad] of an orientation (x, y, z, w) about REP-103's y."""
    x, y, z, w = np.asarray(quaternion, dtype=np.float64)
    return math.atan2(2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y))
