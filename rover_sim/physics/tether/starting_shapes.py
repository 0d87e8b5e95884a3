"""Initial shapes of a tether: straight line, circular arc, inextensible catenary.

Arc and catenary have unit tangents and the tether's unstretched length; only the straight
line can be an equilibrium of an elastic tether. Nodes have the shape (n + 1, 2, dim):
positions [m] and slopes dr/dx [-], in the plane (dim 2) or in space (dim 3).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rover_sim.physics.numerics.roots_and_splines import bracketed_root
from rover_sim.physics.tether.ancf import Array

_CLOSEST_ENDS = 1e-9  # distance of the ends over the length [-]; a closed shape has no direction


def straight_nodes(root: ArrayLike, tip: ArrayLike, elements: int, length: float) -> Array:
    """Straight from root to tip, uniformly stretched to the distance between them.

    Args:
        root: position of the first node [m].
        tip: position of the last node [m].
        elements: number n of elements.
        length: unstretched length [m].
    """
    start, chord = _ends(root, tip)
    fraction = np.linspace(0.0, 1.0, elements + 1)[:, None]
    return np.stack(
        [start + fraction * chord, np.broadcast_to(chord / length, (elements + 1, start.size))],
        axis=1,
    )


def arc_nodes(
    root: ArrayLike, tip: ArrayLike, elements: int, length: float, gravity: ArrayLike
) -> Array:
    """Circular arc of a given length that bulges in the direction of gravity.

    Args:
        root: position of the first node [m].
        tip: position of the last node [m], closer to the root than `length`.
        elements: number n of elements.
        length: length of the arc [m].
        gravity: vector of the direction in which the arc bulges [any unit].

    Raises:
        ValueError: the ends nearly coincide, or are not closer than the length.
    """
    start, chord = _ends(root, tip)
    distance = _slack_distance(chord, length)
    along = chord / distance
    bulge = _across(along, np.asarray(gravity, dtype=np.float64))
    # distance/length = sin(phi)/phi, with phi half the angle that the arc subtends
    ratio = distance / length
    half = bracketed_root(lambda phi: math.sin(phi) - ratio * phi, 1e-9, math.pi, xtol=1e-15)
    radius = length / (2.0 * half)
    angle = np.linspace(-half, half, elements + 1)[:, None]
    positions = (
        start
        + radius * (np.sin(angle) + math.sin(half)) * along
        + radius * (np.cos(angle) - math.cos(half)) * bulge
    )
    slopes = np.cos(angle) * along - np.sin(angle) * bulge
    positions[0], positions[-1] = start, start + chord
    return np.stack([positions, slopes], axis=1)


@dataclass(frozen=True)
class Catenary:
    """Catenary of an inextensible, perfectly flexible chain between two points.

    With s the arc length from the root, u = (s - s0)/a and the span's direction e_h and
    up direction e_v: horizontal force H = w a, vertical force w (s - s0), tension
    H sqrt(1 + u^2) (any textbook of statics).

    Attributes:
        root: position of the root [m], (dim,).
        across: unit vector e_h, horizontal, towards the tip.
        up: unit vector e_v, against gravity.
        parameter: a [m].
        lowest: s0 [m], arc length at the lowest point; outside 0..length if the lowest
            point of the curve is not on the tether.
        length: [m].
    """

    root: Array
    across: Array
    up: Array
    parameter: float
    lowest: float
    length: float

    @classmethod
    def between(
        cls, root: ArrayLike, tip: ArrayLike, length: float, gravity: ArrayLike
    ) -> "Catenary":
        """Catenary of a given length [m] from root to tip [m] under gravity.

        Raises:
            ValueError: no such catenary: no gravity, ends not closer than the length, or
                one straight above the other.
        """
        start, chord = _ends(root, tip)
        _slack_distance(chord, length)
        pull = np.asarray(gravity, dtype=np.float64)
        strength = float(np.linalg.norm(pull))
        if strength == 0.0:
            raise ValueError("a catenary needs gravity; it is zero")
        up = -pull / strength
        rise = float(chord @ up)
        level = chord - rise * up
        span = float(np.linalg.norm(level))
        if span < 1e-9 * length:
            raise ValueError(
                f"horizontal distance {span:g} m between the ends: a catenary needs one above 0"
            )
        # sqrt(L^2 - h^2) = 2 a sinh(d/2a); with z = d/2a: sinh(z)/z = ratio > 1
        ratio = math.sqrt(length**2 - rise**2) / span
        upper = 1.0
        while math.sinh(upper) < ratio * upper:
            upper *= 1.5
        z = bracketed_root(lambda x: math.sinh(x) - ratio * x, 1e-9, upper, xtol=1e-15, rtol=1e-14)
        parameter = span / (2.0 * z)
        middle = math.atanh(rise / length)
        return cls(
            root=start,
            across=level / span,
            up=up,
            parameter=parameter,
            lowest=parameter * math.sinh(z - middle),
            length=length,
        )

    def position(self, arc_length: ArrayLike) -> Array:
        """Position [m] at the arc lengths s [m] from the root; shape s.shape + (dim,)."""
        u, u_root = self._scaled(arc_length), -self.lowest / self.parameter
        horizontal = self.parameter * (np.arcsinh(u) - math.asinh(u_root))
        vertical = self.parameter * (np.hypot(1.0, u) - math.hypot(1.0, u_root))
        return np.asarray(
            self.root + horizontal[..., None] * self.across + vertical[..., None] * self.up
        )

    def tangent(self, arc_length: ArrayLike) -> Array:
        """Unit tangent [-] at the arc lengths s [m]; shape s.shape + (dim,)."""
        u = self._scaled(arc_length)
        return np.asarray((self.across + u[..., None] * self.up) / np.hypot(1.0, u)[..., None])

    def nodes(self, elements: int) -> Array:
        """Nodes (n + 1, 2, dim) at equal arc lengths, with unit tangents."""
        arc_length = np.linspace(0.0, self.length, elements + 1)
        return np.stack([self.position(arc_length), self.tangent(arc_length)], axis=1)

    def _scaled(self, arc_length: ArrayLike) -> Array:
        s = np.asarray(arc_length, dtype=np.float64)
        return np.asarray((s - self.lowest) / self.parameter)


def _ends(root: ArrayLike, tip: ArrayLike) -> tuple[Array, Array]:
    start = np.array(root, dtype=np.float64)
    chord = np.asarray(tip, dtype=np.float64) - start
    if start.shape not in {(2,), (3,)} or chord.shape != start.shape:
        raise ValueError(
            f"root {root!r} and tip {tip!r}: must both be points of the plane or of space"
        )
    if not np.all(np.isfinite(chord)):
        raise ValueError(f"root {root!r} and tip {tip!r}: must be finite")
    return start, chord


def _slack_distance(chord: Array, length: float) -> float:
    distance = float(np.linalg.norm(chord))
    least = _CLOSEST_ENDS * length
    if not least < distance < length:
        raise ValueError(
            f"distance {distance:g} m between root and tip: must be above {least:g} m and below the"
            f" tether's length {length:g} m"
        )
    return distance


def _across(along: Array, towards: Array) -> Array:
    """Unit vector perpendicular to `along` and closest to `towards`."""
    for candidate in (towards, *np.eye(along.size)):
        across = candidate - (candidate @ along) * along
        size = float(np.linalg.norm(across))
        if size > 1e-6 * max(float(np.linalg.norm(candidate)), 1e-300):
            return np.asarray(across / size)
    raise AssertionError("one of the axes is not along the chord")
