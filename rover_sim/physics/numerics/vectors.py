"""Vectors and rotations in space as tuples, for compiled functions without allocation.

A vector is (x, y, z). A matrix is its nine entries by rows. A rotation is the three columns of its
matrix, the body's axes in the world frame. A quaternion is (w, x, y, z), body to world.

The Cayley vector th of a rotation C is the axis times 2 tan(angle/2); with [th] the cross product
matrix,

    C = I + s ([th] + [th]^2 / 2),     s = 1 / (1 + th.th / 4),
    C - I = [th] (C + I) / 2,
    dC = [A dth] C,                    A = s (I + [th] / 2).
"""

import numpy as np

from rover_sim.physics.numerics.compiled import checked, checked_inner

Vector = tuple[float, float, float]
Rotation = tuple[Vector, Vector, Vector]
Matrix = tuple[float, float, float, float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]


@checked_inner
def add(a: Vector, b: Vector) -> Vector:
    """Sum a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@checked_inner
def sub(a: Vector, b: Vector) -> Vector:
    """Difference a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@checked_inner
def scale(k: float, a: Vector) -> Vector:
    """Product k a."""
    return (k * a[0], k * a[1], k * a[2])


@checked_inner
def axpy(k: float, a: Vector, b: Vector) -> Vector:
    """Sum k a + b."""
    return (k * a[0] + b[0], k * a[1] + b[1], k * a[2] + b[2])


@checked
def dot(a: Vector, b: Vector) -> float:
    """Inner product a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@checked_inner
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@checked_inner
def product(rows: Matrix, u: Vector) -> Vector:
    """Product of a matrix and a vector."""
    return (
        rows[0] * u[0] + rows[1] * u[1] + rows[2] * u[2],
        rows[3] * u[0] + rows[4] * u[1] + rows[5] * u[2],
        rows[6] * u[0] + rows[7] * u[1] + rows[8] * u[2],
    )


@checked_inner
def rotate(columns: Rotation, u: Vector) -> Vector:
    """R u, from the body's axes to the world's."""
    x, y, z = columns
    return (
        u[0] * x[0] + u[1] * y[0] + u[2] * z[0],
        u[0] * x[1] + u[1] * y[1] + u[2] * z[1],
        u[0] * x[2] + u[1] * y[2] + u[2] * z[2],
    )


@checked_inner
def unrotate(columns: Rotation, u: Vector) -> Vector:
    """R^T u, from the world's axes to the body's."""
    return (dot(columns[0], u), dot(columns[1], u), dot(columns[2], u))


@checked_inner
def rotation_of(q: Quaternion) -> Rotation:
    """Columns of the rotation of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@checked_inner
def cayley_update(q: Quaternion, th: Vector) -> Quaternion:
    """Unit quaternion after the rotation by the Cayley vector th in body axes."""
    w, x, y, z = q
    a, b, c = 0.5 * th[0], 0.5 * th[1], 0.5 * th[2]
    p = (
        w - x * a - y * b - z * c,
        x + w * a + y * c - z * b,
        y + w * b + z * a - x * c,
        z + w * c + x * b - y * a,
    )
    k = 1.0 / np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])
    return (k * p[0], k * p[1], k * p[2], k * p[3])


@checked_inner
def cayley_scale(th: Vector) -> float:
    """Factor s = 1 / (1 + th.th / 4)."""
    return 1.0 / (1.0 + 0.25 * dot(th, th))


@checked_inner
def cayley(th: Vector, u: Vector) -> Vector:
    """Rotated vector C u."""
    return add(u, cayley_change(th, u))


@checked_inner
def cayley_change(th: Vector, u: Vector) -> Vector:
    """Change C u - u, without cancellation for small th."""
    first = cross(th, u)
    return scale(cayley_scale(th), axpy(0.5, cross(th, first), first))


@checked_inner
def cayley_tangent(th: Vector, u: Vector) -> Vector:
    """Rotation A u of C caused by the change u of th (tangent operator of the Cayley map)."""
    return scale(cayley_scale(th), axpy(0.5, cross(th, u), u))
