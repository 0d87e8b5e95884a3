"""Kinematics of a moving body for its sensors: velocities, specific force, camera image rate.

Vectors are tuples of three floats; body axes are base_link's.
"""

import math
from typing import NamedTuple

from rover_sim.physics.numerics.compiled import checked, checked_inner
from rover_sim.physics.numerics.vectors import (
    Quaternion,
    Vector,
    add,
    axpy,
    cross,
    dot,
    rotate,
    rotation_of,
    scale,
    sub,
    unrotate,
)


class BodyMotion(NamedTuple):
    """Position, orientation and velocities of Body 1."""

    position: Vector  # of base_link in map [m]
    orientation: Quaternion  # (w, x, y, z), base_link to map
    velocity: Vector  # in map [m/s]
    spin: Vector  # angular velocity in base_link [rad/s]


@checked_inner
def velocity_at(body: BodyMotion, point: Vector) -> Vector:
    """Velocity in map [m/s] of a point of the body."""
    return add(body.velocity, rotate(rotation_of(body.orientation), cross(body.spin, point)))


@checked
def mean_rate(before: Quaternion, after: Quaternion, dt: float) -> Vector:
    """Mean angular velocity in body axes [rad/s] between two orientations."""
    w0, v0 = before[0], (before[1], before[2], before[3])
    w1, v1 = after[0], (after[1], after[2], after[3])
    scalar = w0 * w1 + dot(v0, v1)
    vector = sub(sub(scale(w0, v1), scale(w1, v0)), cross(v0, v1))
    if scalar < 0.0:
        scalar, vector = -scalar, scale(-1.0, vector)
    size = math.sqrt(dot(vector, vector))
    if size < 1e-12:
        return scale(2.0 / dt, vector)
    return scale(2.0 * math.atan2(size, scalar) / (size * dt), vector)


@checked
def specific_force(
    before: BodyMotion, after: BodyMotion, point: Vector, gravity: float, dt: float
) -> Vector:
    """Mean specific force at a point of the body, in its mid-step axes [m/s^2].

    Args:
        before: the body at the start.
        after: at the end.
        point: in base_link [m].
        gravity: magnitude, along -z of map [m/s^2].
        dt: [s], > 0.
    """
    change = sub(velocity_at(after, point), velocity_at(before, point))
    force = axpy(1.0 / dt, change, (0.0, 0.0, gravity))
    p, q = before.orientation, after.orientation
    same = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] >= 0.0
    k = 1.0 if same else -1.0
    w, x, y, z = p[0] + k * q[0], p[1] + k * q[1], p[2] + k * q[2], p[3] + k * q[3]
    inverse = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return unrotate(rotation_of((inverse * w, inverse * x, inverse * y, inverse * z)), force)


@checked
def image_rate(body: BodyMotion, point: Vector, axis: Vector, distance: float) -> Vector:
    """Angular rate of the scene across a camera's optical axis [rad/s], in base_link.

    A scene point on the axis at the distance D moves by -(W x a + v/D), where a is the unit vector
    of the axis and v the camera's velocity across it. D may be infinite.
    """
    velocity = unrotate(rotation_of(body.orientation), velocity_at(body, point))
    across = axpy(-dot(velocity, axis), axis, velocity)
    nearness = 1.0 / distance if distance > 0.0 else 0.0
    return scale(-1.0, axpy(nearness, across, cross(body.spin, axis)))


@checked
def camera_ray(body: BodyMotion, point: Vector, axis: Vector) -> tuple[Vector, Vector]:
    """Position of a camera of the body [m] and unit vector of its optical axis, in map."""
    axes = rotation_of(body.orientation)
    look = rotate(axes, axis)
    return add(body.position, rotate(axes, point)), scale(1.0 / math.sqrt(dot(look, look)), look)
