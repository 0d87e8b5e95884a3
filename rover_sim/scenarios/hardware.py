# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Scenario sections of the hardware: the rover with its drives, and the winch.

Axes: base_link, REP-103; origin in Body 1's centre of mass, x forward, y left along the wheels'
axle, z up along the slider. The inertias exclude the spin of the rotors (flywheel about x, wheels
about y), whose angular momenta the drives hold.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.ground.wheel_soil import Wheel
from rover_sim.physics.mechanisms.drum import DrumParameters
from rover_sim.physics.mechanisms.jump_drive import JumpDriveParameters
from rover_sim.physics.mechanisms.slider import SliderParameters
from rover_sim.physics.mechanisms.wheel_drive import WheelDriveParameters
from rover_sim.physics.tether.ancf import Array
from rover_sim.scenarios.scenario_parts import read_table

Vector: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class WinchSettings(DrumParameters):
    """The winch; the tether's max_length limits the payout."""

    min_length: float = quantity("m", "payout when fully reeled in", 1.0, minimum=0.0)


@dataclass(frozen=True)
class Wheels(Wheel):
    """Two equal wheels on one axle."""

    radius: float = quantity("m", "of the rim", 0.15, above=0.0, maximum=0.3)
    track_width: float = quantity("m", "between the wheels' middles", 0.44, above=0.0)
    axle_x: float = quantity("m", "x of the axle", 0.08)
    axle_z: float = quantity("m", "z of the axle", 0.0)

    @property
    def tip_radius(self) -> float:
        """Radius to the tips of the grousers [m]."""
        return self.radius + self.grouser_height

    @property
    def left(self) -> Vector:
        """Centre of the left wheel in base_link [m]."""
        return self.axle_x, 0.5 * self.track_width, self.axle_z

    @property
    def right(self) -> Vector:
        """Centre of the right wheel in base_link [m]."""
        return self.axle_x, -0.5 * self.track_width, self.axle_z


def _read_momenta(value: object, path: str) -> tuple[tuple[float, ...], ...]:
    """Rows of a rotor's table: time [s] and momentum [N m s]."""
    return read_table(value, path, ("time_s", "momentum_N_m_s"))


@dataclass(frozen=True)
class RotorSettings(Configuration):
    """A rotor of Body 1 with a prescribed angular momentum, such as a gyroscope.

    Its mass and its inertia without spin are part of Body 1.
    """

    axis: Vector = quantity("-", "of the rotor in base_link, any length", length=3)
    momentum: float = quantity("N m s", "constant angular momentum about the axis", 0.0)
    rows: tuple[tuple[float, ...], ...] = configuration.read_by(
        _read_momenta,
        (tuple,),
        "rows of [time_s, momentum_N_m_s] in place of a constant momentum, linear between them",
        (),
    )

    def check(self) -> None:
        """Refuse an axis without a direction, and two momenta."""
        if not any(self.axis):
            raise ConfigurationError("axis", list(self.axis), "should have a direction")
        if self.rows and self.momentum != 0.0:
            raise ConfigurationError("momentum", self.momentum, "should be 0 with rows")

    @property
    def unit_axis(self) -> Array:
        """Its direction, (3,)."""
        axis = np.array(self.axis)
        return np.asarray(axis / np.linalg.norm(axis))


@dataclass(frozen=True)
class RoverSettings(Configuration):
    """Body 1 with wheels, motors and tether, and Body 2, which slides on it."""

    m1: float = quantity("kg", "mass of Body 1 with wheels and rotors", 6.0, above=0.0, maximum=1e5)
    m2: float = quantity(
        "kg", "mass of Body 2; 0: a single body, which cannot jump", 4.0, minimum=0.0, maximum=1e5
    )
    inertia1: Vector = quantity(
        "kg m^2",
        "principal moments of Body 1 about base_link's axes, without the spin of the rotors",
        (0.078, 0.055, 0.115),
        above=0.0,
        length=3,
    )
    inertia2: Vector = quantity(
        "kg m^2", "of Body 2 about its centre", (0.021, 0.021, 0.038), above=0.0, length=3
    )
    body1_size: Vector = quantity(
        "m", "length, width and height of Body 1's box", (0.30, 0.24, 0.15), above=0.0, length=3
    )
    body1_centre: Vector = quantity(
        "m", "centre of that box in base_link", (-0.01, 0.0, 0.0), length=3
    )
    body2_size: Vector = quantity(
        "m", "of Body 2's box, centred on it", (0.24, 0.24, 0.08), above=0.0, length=3
    )
    tail: Vector | None = quantity(
        "m",
        "contact point of the tail skid in base_link, or null",
        (-0.24, 0.0, -0.16),
        length=3,
        optional=True,
    )
    attachment: Vector = quantity(
        "m", "tether's attachment p in base_link", (0.0, 0.0, 0.28), length=3
    )
    slider_offset: tuple[float, float] = quantity(
        "m",
        "x and y in base_link of the slider's axis, along z, on which Body 2's centre moves",
        (0.0, 0.0),
        length=2,
    )
    meshes: str = configuration.text(
        "folder with meshes for viewers, named as the links: base_link.dae, body2.stl ...; "
        "empty: boxes and cylinders",
        "",
    )
    rotors: tuple[RotorSettings, ...] = configuration.sections(
        RotorSettings, "rotors of Body 1 with a prescribed momentum", ()
    )
    slider: SliderParameters = configuration.section(
        SliderParameters, "spring and slider", SliderParameters()
    )
    jump_drive: JumpDriveParameters = configuration.section(
        JumpDriveParameters, "the jump drive", JumpDriveParameters()
    )
    wheels: Wheels = configuration.section(Wheels, "the wheels", Wheels())
    wheel_drive: WheelDriveParameters = configuration.section(
        WheelDriveParameters, "the wheel drive", WheelDriveParameters()
    )

    def check(self) -> None:
        """Refuse impossible inertias, and a stroke beyond the slider's lower stop."""
        for name in ("inertia1", "inertia2"):
            moments = sorted(getattr(self, name))
            # Body 1's moments exclude the rotors' spin and may violate the triangle inequality.
            if name == "inertia2" and moments[2] > moments[0] + moments[1] + 1e-12:
                raise ConfigurationError(
                    name,
                    list(getattr(self, name)),
                    "each moment of inertia should be at most the sum of the other two",
                )
        if self.is_single_body and any(self.slider_offset):
            raise ConfigurationError(
                "slider_offset",
                list(self.slider_offset),
                "should be [0, 0] for a rover of a single body (m2 = 0)",
            )
        if self.jump_drive.stroke >= self.slider.lower_stop:
            raise ConfigurationError(
                "slider.lower_stop",
                self.slider.lower_stop,
                f"should be above the jump drive's stroke of {self.jump_drive.stroke:g} m",
            )

    @property
    def is_single_body(self) -> bool:
        """Whether there is no Body 2: the slider moves nothing."""
        return self.m2 == 0.0

    @property
    def mass(self) -> float:
        """m1 + m2 [kg]."""
        return self.m1 + self.m2

    @property
    def inertia(self) -> Vector:
        """Sum of both bodies' moments of inertia about their centres, without rotors [kg m^2]."""
        a, b = self.inertia1, self.inertia2
        if self.is_single_body:
            return a
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]

    def centre_of_mass(self, slide: float) -> Array:
        """Return the rover's centre of mass in base_link [m], (3,), at the slide s [m]."""
        return np.asarray(self.m2 / self.mass * self.body2_place(slide))

    def body2_place(self, slide: float) -> Array:
        """Return Body 2's centre of mass in base_link [m], (3,), at the slide s [m]."""
        return np.array([*self.slider_offset, slide])

    @property
    def corners(self) -> tuple[Array, int]:
        """Contact points of both bodies [m], (c, 3), and the index of Body 2's first.

        Body 1's eight corners, then the tail, are in base_link; Body 2's eight are there at the
        slide s = 0.
        """
        first = _box(self.body1_size) + np.array(self.body1_centre)
        if self.tail is not None:
            first = np.vstack([first, self.tail])
        if self.is_single_body:
            return first, len(first)
        return np.vstack([first, _box(self.body2_size) + self.body2_place(0.0)]), len(first)


BOX_CORNERS = 8
"""Number of corners of a body."""


def _box(size: Vector) -> Array:
    """Return the corners of a box about its centre, (BOX_CORNERS, 3)."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return np.asarray(signs * np.array(size))


def rest_slide(rover: RoverSettings, weight: float) -> float:
    """Return the slide s [m] at which the spring carries Body 2's weight component along z [N].

    A positive weight compresses; beyond the spring's travel the end stops carry the rest.
    """
    spring, pads = rover.slider.spring_rate, rover.slider.pad_stiffness
    compression = weight / spring
    stop = rover.slider.lower_stop
    if compression < 0.0:
        compression = weight / (spring + pads)
    elif compression > stop:
        compression = (weight + pads * stop) / (spring + pads)
    return rover.slider.free_length - compression


def jump_height(rover: RoverSettings, gravity: float, compression: float) -> float:
    """Return the height of a lossless jump from the given compression [m].

    The spring's energy minus Body 2's potential energy accelerates Body 2, which takes Body 1 along
    in a plastic impact at the upper stop: the share m2/(m1 + m2) of the energy becomes height.
    """
    if not (gravity > 0.0 and compression >= 0.0):
        raise ValueError(f"gravity = {gravity}, compression = {compression}: must be above 0")
    energy = 0.5 * rover.slider.spring_rate * compression**2
    energy -= rover.m2 * gravity * compression
    return max(0.0, rover.m2 / rover.mass * energy / (rover.mass * gravity))
