"""A cable between two driven ends: the plant's tether where both of its ends are held and moved.

Mass enters the motion only as a factor of every force, so that all quantities are per mass: the
tether has 1 kg/m, its stiffness is EI/(rho A), its drag c/(rho A).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.integrators.driven_cable import DrivenCable, make_driven_cable, march
from rover_sim.physics.numerics.roots_and_splines import cubic_spline
from rover_sim.physics.tether.air_drag import AirDrag
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.natural_curvature import make_natural_curvature, make_relaxation
from rover_sim.physics.tether.point_masses import PointMasses
from rover_sim.physics.tether.tether import make_tether, row_width
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.plants.end_motion import EndMotion, carried_directors

_TOLERANCE: Final = 3.0e-6
"""Newton increment that ends a step [m]."""
_AXIAL_STIFFNESS: Final = 600.0
"""EA per mass [m2/s2]: 1 m of cable stretches by 1 % under half of its weight at most."""
_AXIAL_DAMPING_TIME: Final = 2.0e-4
"""Takes the ring out of the first steps, whose strain is the error of the first frames [s]."""


@dataclass(frozen=True)
class CableLaws:
    """Laws of a cable, per mass per length.

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    bending_stiffness: float  # EI/(rho A) [m4/s2], > 0
    bending_damping_time: float  # [s], >= 0
    drag: float  # c_n/(rho A) [1/m], >= 0
    marker_mass: float  # of each marker, as a length of cable [m], >= 0
    twist_ratio: float  # GJ/EI [-], > 0
    axial_drag: float = 0.02  # c_t/c_n [-], >= 0
    relaxation_ratio: float = 0.0  # B1/B: stiffness that relaxes over that which stays, EI, >= 0
    relaxation_time: float = 3.0  # [s], > 0

    def __post_init__(self) -> None:
        for name in ("bending_stiffness", "twist_ratio", "relaxation_time"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: must be finite and above 0")
        for name in (
            "bending_damping_time", "drag", "marker_mass", "axial_drag", "relaxation_ratio",
        ):  # fmt: skip
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: must be finite and not below 0")

    def section(self, line_density: float = 1.0) -> TetherSection:
        """Cross-section of a cable of this mass per length [kg/m], before anything relaxes."""
        return TetherSection(
            axial_stiffness=_AXIAL_STIFFNESS * line_density,
            bending_stiffness=self.bending_stiffness * line_density,
            line_density=line_density,
            axial_damping_time=_AXIAL_DAMPING_TIME,
            bending_damping_time=self.bending_damping_time,
        ).stiffened(self.relaxation_ratio)


@dataclass(frozen=True)
class HeldMotion:
    """What is given of a motion: both ends, and the state in which it begins.

    Attributes:
        rates: of position and slope of both ends at the steps' ends, (steps + 1, 2, 6).
        position: of the nodes at the start [m], (n + 1, 3).
        slope: unit slopes there, (n + 1, 3).
        velocity: [m/s], (n + 1, 3).
        slope_rate: [1/s], (n + 1, 3).
        director: first directions of the material frames there, (n + 1, 3).
        step: [s].
        stride: steps from one frame to the next.
        frames: their number, the initial state included.
    """

    rates: Array
    position: Array
    slope: Array
    velocity: Array
    slope_rate: Array
    director: Array
    step: float
    stride: int
    frames: int


@dataclass(frozen=True)
class HeldCable:
    """Geometry of a cable between its driven ends.

    Attributes:
        places: of the markers along the cable [m], ascending, from 0 (root) to the tip.
        elements: number of elements.
        gravity: [m/s2], along -z.
    """

    places: Array
    elements: int
    gravity: float = 9.81

    @property
    def length(self) -> float:
        """Length between the driven ends [m]."""
        return float(self.places[-1])

    @property
    def nodes(self) -> Array:
        """Places of the nodes along the cable [m]."""
        return np.linspace(0.0, self.length, self.elements + 1)

    def motion(
        self,
        first: Array,
        second: Array,
        ends: tuple[EndMotion, EndMotion],
        times: Array,
        longest_step: float,
        tilts: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0)),
        tip_roll: float | None = None,
    ) -> HeldMotion:
        """Begin a motion from the markers' positions in two frames.

        Args:
            first: positions of the markers at `places` in the first frame [m], (markers, 3).
            second: the same in the second frame.
            ends: motion of root and tip.
            times: of the frames [s], evenly spaced.
            longest_step: [s].
            tilts: of the cable against the axes of its holders at root and tip [-].
            tip_roll: of the tip's frame about the cable, against its holder's axes [rad]; None: the
                cable begins without twist.
        """
        period = float((times[-1] - times[0]) / (len(times) - 1))
        stride = math.ceil(period / longest_step - 1.0e-9)
        steps = times[0] + period / stride * np.arange(stride * (len(times) - 1) + 1)
        pairs = list(zip(ends, tilts, strict=True))
        rates = np.stack([end.rates(steps, tilt) for end, tilt in pairs], axis=1)
        state = [end.state(times[:1], tilt)[0] for end, tilt in pairs]
        positions, velocities = first.copy(), (second - first) / period
        for place, own, rate in zip((0, -1), state, rates[0], strict=True):
            positions[place], velocities[place] = own[:3], rate[:3]
        shape = cubic_spline(self.places, positions, ((1, state[0][3:]), (1, state[1][3:])))
        moving = cubic_spline(self.places, velocities, ((1, rates[0, 0, 3:]), (1, rates[0, 1, 3:])))
        slope = shape(self.nodes, 1)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        director = carried_directors(slope, ends[0].across[0](times[0]))
        if tip_roll is not None:
            director = _twisted(director, slope, ends[1].across[0](times[0]), tip_roll)
        return HeldMotion(
            np.ascontiguousarray(rates),
            shape(self.nodes),
            slope,
            moving(self.nodes),
            moving(self.nodes, 1),
            director,
            period / stride,
            stride,
            len(times),
        )

    def simulate(self, laws: CableLaws, curvature: Array, motion: HeldMotion) -> tuple[Array, int]:
        """Simulate a motion.

        Args:
            laws: of the cable.
            curvature: natural curvature at the nodes [1/m], (2, n + 1), in the frame whose first
                direction at the start is the world's x axis, made normal to the root and carried
                along the cable without twist.
            motion: what is given.

        Returns:
            Positions of the markers between the ends [m], (frames, markers - 2, 3), and the number
            of frames reached; the rest repeats the last one.
        """
        cable = self._cable(laws, curvature, motion)
        places = self._points()
        positions = np.zeros((motion.frames, len(self.places) - 2, 3))
        reached = march(cable, motion.rates, motion.step, motion.stride, *places, positions)
        positions[reached:] = positions[reached - 1]
        return positions, reached

    def _points(self) -> tuple[NDArray[np.int64], Array]:
        """Element of each free marker, and its place in it."""
        places = self.places[1:-1] * (self.elements / self.length)
        element = np.minimum(places.astype(np.int64), self.elements - 1)
        return element, places - element

    def _cable(self, laws: CableLaws, curvature: Array, motion: HeldMotion) -> DrivenCable:
        n = self.elements
        tether = make_tether(laws.section(), self.length, n, (0.0, 0.0, -self.gravity))
        natural = make_natural_curvature(
            row_width(n, 3),
            laws.twist_ratio * laws.bending_stiffness,
            curvature[:, ::-1],
            guided=False,
            relaxation=make_relaxation(laws.relaxation_ratio, laws.relaxation_time),
        )
        natural.director[:, : n + 1] = motion.director.T
        element, xi = self._points()
        cable = make_driven_cable(
            tether,
            AirDrag(laws.drag, laws.axial_drag * laws.drag, (0.0, 0.0, 0.0)),
            natural,
            PointMasses(element, xi, np.full(len(xi), laws.marker_mass)),
            _TOLERANCE,
        )
        for rows, values, slopes in (
            (cable.q, motion.position, motion.slope),
            (cable.v, motion.velocity, motion.slope_rate),
        ):
            rows[:3, : n + 1] = values.T
            rows[3:, : n + 1] = slopes.T
        return cable


def _twisted(directors: Array, slopes: Array, tip: Array, roll: float) -> Array:
    """Turn directors about unit slopes so that the last has a roll against the direction `tip`."""
    second = np.cross(slopes, directors)
    angle = math.atan2(float(tip @ second[-1]), float(tip @ directors[-1])) + roll
    angle -= 2.0 * math.pi * round(angle / (2.0 * math.pi))
    turns = np.linspace(0.0, angle, len(directors))[:, None]
    return np.asarray(np.cos(turns) * directors + np.sin(turns) * second)


def natural_curvature_of(shape: Array, arcs: Array, places: Array) -> Array:
    """Curvature of a cable at rest, in a twist-free frame carried along it [1/m], (2, places).

    Args:
        shape: positions of its markers [m], (markers, 3), free of load but for a table along z.
        arcs: places of the markers along the cable [m], (markers,).
        places: where the curvature is returned [m].
    """
    spline = cubic_spline(arcs, shape)
    fine = np.linspace(arcs[0], arcs[-1], 400)
    slopes = spline(fine, 1)
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    bends = spline(fine, 2)
    directors = carried_directors(slopes)
    first = np.sum(bends * directors, axis=1)
    second = np.sum(bends * np.cross(slopes, directors), axis=1)
    return np.stack([np.interp(places, fine, each) for each in (first, second)])
