# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Spatial scenarios: environment, tether, winch, rover, sensors and start, as frozen typed data.

Axes are REP-103: map has its origin at the fairlead, x forward and z up; base_link
(module `hardware`) has x forward, y left along the wheels' axle and z up along the slider.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, choice, flag, quantity, text
from rover_sim.physics.ground.tether_contact import TetherContactParameters
from rover_sim.physics.tether.natural_curvature import BendingRelaxation, make_relaxation
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.scenarios.environment import Environment
from rover_sim.scenarios.hardware import RoverSettings, Vector, WinchSettings
from rover_sim.scenarios.scenario_parts import CrossSection, Integration, ScenarioError, read_table
from rover_sim.scenarios.sensor_sections import SensorSettings

Model: TypeAlias = Literal["spatial"]
StartKind: TypeAlias = Literal["hanging", "grounded", "straight"]

# Smallest and largest undeformed length of the element at the fairlead, over the nominal length.
SHORTEST_EXIT, LONGEST_EXIT = 0.5, 1.5
# Largest number of elements of nominal length of the whole tether.
MOST_ELEMENTS = 2000
# Largest angle by which an element of nominal length is bent naturally [rad].
MOST_BENT = 0.5
# Largest bandwidth of a motor's rate servo times the time step. The servo advances in steps of h:
# at 1 its error halves in a step, above 2 it alternates, against the limit of the torque.
LARGEST_SERVO_STEP = 1.0


@dataclass(frozen=True)
class PointMassSettings(Configuration):
    """A mass at a point of the tether, for example a marker or a float's ballast."""

    position: float = quantity("m", "along the tether from its root, unstretched", minimum=0.0)
    mass: float = quantity("kg", "of the point", minimum=0.0)


MOTION_COLUMNS = ("time_s", "x_m", "y_m", "z_m")


def _read_rows(value: object, path: str) -> tuple[tuple[float, ...], ...]:
    """Rows of a table of an end's motion: time [s] and position [m]."""
    rows = read_table(value, path, MOTION_COLUMNS, fewest=2)
    if rows[0][0] < 0.0:
        raise ScenarioError(
            f"{path}[0]",
            list(rows[0]),
            f"its {MOTION_COLUMNS[0]} should not be below 0, the start of the simulation",
        )
    return rows


@dataclass(frozen=True)
class DrivenEndSettings(Configuration):
    """Motion of an end of the tether: a smooth curve through the rows of a table.

    The end is at rest before the first row, not before the time 0, and after the last. Positions
    count relative to the first row, where the end is at its place at the start. In a file, `file`
    names a CSV file with the columns time_s, x_m, y_m, z_m in place of the rows.
    """

    rows: tuple[tuple[float, ...], ...] = configuration.read_by(
        _read_rows, (tuple,), "rows of [time_s, x_m, y_m, z_m]"
    )


CURVATURE_COLUMNS = ("position_m", "curvature_1_per_m", "curvature_2_per_m")


def _read_curvature(value: object, path: str) -> tuple[tuple[float, ...], ...]:
    """Rows of a table along the tether: place [m] and natural curvature [1/m]."""
    return read_table(value, path, CURVATURE_COLUMNS, fewest=1)


@dataclass(frozen=True)
class NaturalCurvatureSettings(Configuration):
    """Natural curvature along the tether, in the two directions of its material frame.

    Linear between the rows, and constant before the first and after the last, so that one row is a
    uniform curvature. Places are measured along the unstretched tether from its root, with a winch
    from its end on the drum. In a file, `file` names a CSV file with the columns position_m,
    curvature_1_per_m, curvature_2_per_m in place of the rows.
    """

    rows: tuple[tuple[float, ...], ...] = configuration.read_by(
        _read_curvature, (tuple,), f"rows of [{', '.join(CURVATURE_COLUMNS)}]"
    )

    @property
    def largest(self) -> float:
        """Largest size of the curvature [1/m]."""
        return max(math.hypot(*row[1:]) for row in self.rows)

    def at(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Curvature at places along the tether [m], (2, places) [1/m]."""
        position, *components = np.array(self.rows).T
        return np.stack([np.interp(places, position, each) for each in components])


@dataclass(frozen=True, kw_only=True)
class SpatialTether(CrossSection):
    """An ANCF cable between fairlead and rover, with elements of one nominal length."""

    length: float = quantity("m", "payout at the start, unstretched", above=0.0, maximum=1e3)
    max_length: float | None = quantity(
        "m", "total length, with a winch; null: length", None, above=0.0, maximum=1e3,
        optional=True,
    )  # fmt: skip
    elements: int | None = quantity(
        "-", "number of elements at the start", None, kind=int, minimum=1, maximum=MOST_ELEMENTS,
        optional=True,
    )  # fmt: skip
    element_length: float | None = quantity(
        "m", "nominal length of an element, in place of elements", None, above=0.0, optional=True
    )
    contact: TetherContactParameters | None = configuration.section(
        TetherContactParameters,
        "contact with the ground; null: none",
        TetherContactParameters(),
        optional=True,
    )
    masses: tuple[PointMassSettings, ...] = configuration.sections(
        PointMassSettings, "point masses; only without a winch", ()
    )
    buckling: bool = flag(
        "elements buckle in compression; false: they carry any, as the planar model's", True
    )
    natural_curvature: NaturalCurvatureSettings | None = configuration.section(
        NaturalCurvatureSettings, "of a coiled tether; null: it is straight", None, optional=True
    )
    bending_relaxation_ratio: float = quantity(
        "-",
        "stiffness that relaxes, over EI, which stays; only without a winch; 0: none",
        0.0,
        minimum=0.0,
        maximum=100.0,
    )
    bending_relaxation_time: float = quantity(
        "s", "relaxation time of that part's moment", 3.0, minimum=1e-3, maximum=1e9
    )
    twist_stiffness: float = quantity("N m^2", "GJ", 0.0, minimum=0.0)
    swivel_friction: float = quantity(
        "N m", "of the swivel at the rover; 0: free, .inf: clamped", 0.0, minimum=0.0, infinite=True
    )

    def check(self) -> None:
        """Require exactly one of elements and element_length."""
        super().check()
        if (self.elements is None) == (self.element_length is None):
            raise ScenarioError(
                "elements",
                self.elements,
                "exactly one of elements and element_length should be given (element_length is"
                f" {configuration.shown(self.element_length)})",
            )
        if self.nominal_length * MOST_ELEMENTS < max(self.length, self.whole_length):
            raise ScenarioError(
                "element_length" if self.elements is None else "elements",
                self.element_length if self.elements is None else self.elements,
                f"makes elements of {self.nominal_length:.3g} m; should make at most"
                f" {MOST_ELEMENTS} of the whole length {self.whole_length:g} m",
            )
        if self.has_frames and self.twist_stiffness == 0.0:
            raise ScenarioError(
                "twist_stiffness",
                self.twist_stiffness,
                "should be above 0 with a natural_curvature or a bending_relaxation_ratio, which"
                " twist the tether",
            )
        if self.natural_curvature is not None:
            self._check_coil(self.natural_curvature)
        for number, each in enumerate(self.masses):
            if each.position > self.length:
                raise ScenarioError(
                    f"masses[{number}].position",
                    each.position,
                    f"should be at most the length {self.length:g} m",
                )
        if self.max_length is not None and self.max_length < self.length:
            raise ScenarioError(
                "max_length", self.max_length, f"should be at least the length {self.length:g} m"
            )

    def _check_coil(self, coil: NaturalCurvatureSettings) -> None:
        first, last = coil.rows[0][0], coil.rows[-1][0]
        if first < 0.0 or last > self.whole_length * (1.0 + 1e-9):
            raise ScenarioError(
                "natural_curvature.rows",
                first if first < 0.0 else last,
                f"its {CURVATURE_COLUMNS[0]} should lie between 0 and the whole length"
                f" {self.whole_length:g} m",
            )
        bent = coil.largest * self.nominal_length
        if bent > MOST_BENT:
            raise ScenarioError(
                "natural_curvature.rows",
                coil.largest,
                f"bends an element of {self.nominal_length:g} m by {bent:.3g} rad; should be at"
                f" most {MOST_BENT:g} rad, with shorter elements or a smaller curvature",
            )

    @property
    def has_frames(self) -> bool:
        """Whether material frames are carried along: the tether is coiled, or its bending relaxes.

        Either is bent where no force acts.
        """
        coil = self.natural_curvature
        return self.bending_relaxation_ratio > 0.0 or (coil is not None and coil.largest > 0.0)

    @property
    def relaxation(self) -> BendingRelaxation:
        """The part of the bending stiffness that relaxes."""
        return make_relaxation(self.bending_relaxation_ratio, self.bending_relaxation_time)

    def curvature_from_tip(self, count: int) -> NDArray[np.float64]:
        """Natural curvature at places one element apart from the tip on, (2, count) [1/m]."""
        if self.natural_curvature is None:
            return np.zeros((2, count))
        return self.natural_curvature.at(
            self.whole_length - self.nominal_length * np.arange(count, dtype=float)
        )

    @cached_property
    def section(self) -> TetherSection:
        """Stiffness, mass, damping and strength of the cross-section, and whether it buckles.

        The bending stiffness is that before anything relaxes.
        """
        section = dataclasses.replace(super().section, buckles=self.buckling)
        return section.stiffened(self.bending_relaxation_ratio)

    @property
    def nominal_length(self) -> float:
        """l_nom [m]."""
        if self.elements is not None:
            return self.length / self.elements
        assert self.element_length is not None
        return self.element_length

    @property
    def whole_length(self) -> float:
        """Total length of the tether [m]."""
        return self.length if self.max_length is None else self.max_length


@dataclass(frozen=True)
class SpatialTipSettings(Configuration):
    """Tip of a tether without a rover."""

    mass: float = quantity("kg", "point mass, 0 for a free end", 0.0, minimum=0.0)
    motion: DrivenEndSettings | None = configuration.section(
        DrivenEndSettings, "motion of a driven tip; null: it moves freely", None, optional=True
    )

    def check(self) -> None:
        """Refuse a mass of a driven tip, which has no effect."""
        if self.motion is not None and self.mass != 0.0:
            raise ScenarioError("mass", self.mass, "should be 0, as the tip is driven")


@dataclass(frozen=True)
class SpatialStartSettings(Configuration):
    """Tether and rover at the start.

    ``hanging``
        in equilibrium under gravity, then rotated about the fairlead by `swing_angle` towards
        `swing_heading`, and moving with `swing_rate` (in that vertical plane) and `cone_rate`
        (about the vertical). base_link's x points to `heading`; `tilt` is an additional rotation
        of the rover and `body_rate` an additional angular velocity. The tether has the twist
        `twist` and is paid out at `payout_rate`, with the brake open. A tether with natural
        curvature or relaxation starts at rest, settled as a grounded one.
    ``grounded``
        on the floor at `position`, facing `heading`, with a slack tether from the fairlead down
        and along the floor. Rover and tether are settled by a simulation of up to
        `settling_time`; a larger speed than `residual_speed` at its end is refused. With a
        `compression` the rover is then ready to jump, rotated by `tilt` about Body 1's centre: a
        disturbance of its stance, by which its supports are as much deeper in the ground or above.
    ``straight``
        straight and unstretched along `direction`, with the velocity `tip_velocity` at the tip,
        proportional to arc length; `attitude` is the rover's rotation vector, body to map, and
        `angular_velocity` its angular velocity in map. A tether with natural curvature is let go
        at the start.
    """

    kind: StartKind = choice(get_args(StartKind), "kind of start")
    swing_angle: float = quantity("deg", "from the vertical", 0.0, minimum=-180.0, maximum=180.0)
    swing_heading: float = quantity("deg", "from x towards y", 0.0, minimum=-360.0, maximum=360.0)
    swing_rate: float = quantity("deg/s", "rate of the swing angle", 0.0)
    cone_rate: float = quantity("deg/s", "angular velocity about the vertical", 0.0)
    heading: float = quantity(
        "deg", "of base_link's x, from x towards y", 0.0, minimum=-360.0, maximum=360.0
    )
    tilt: Vector = quantity(
        "deg", "additional rotation vector in base_link", (0.0, 0.0, 0.0), length=3
    )
    body_rate: Vector = quantity(
        "deg/s", "additional angular velocity in base_link", (0.0, 0.0, 0.0), length=3
    )
    twist: float = quantity("deg", "of the tether, rover against fairlead", 0.0)
    position: tuple[float, float] = quantity("m", "x and y of base_link", (0.0, 0.0), length=2)
    settling_time: float = quantity(
        "s", "longest simulated time to settle", 60.0, above=0.0, maximum=600.0
    )
    residual_speed: float = quantity(
        "m/s", "largest speed of rover and tether after settling; wheels may roll down a slope",
        1.0e-6, above=0.0, maximum=0.1,
    )  # fmt: skip
    compression: float = quantity(
        "m", "of the jump spring, held by nut and latch; 0: as at rest", 0.0, minimum=0.0
    )
    direction: Vector | None = quantity(
        "-", "of the straight tether, any length", None, length=3, optional=True
    )
    tip_velocity: Vector = quantity("m/s", "of the attachment", (0.0, 0.0, 0.0), length=3)
    attitude: Vector = quantity(
        "rad", "rotation vector, base_link to map", (0.0, 0.0, 0.0), length=3
    )
    angular_velocity: Vector = quantity("rad/s", "in map", (0.0, 0.0, 0.0), length=3)
    payout_rate: float = quantity(
        "m/s", "payout rate of the winch; > 0 lengthens", 0.0, minimum=-10.0, maximum=10.0
    )

    @property
    def at_rest(self) -> SpatialStartSettings:
        """A grounded start before the rover is made ready to jump."""
        return dataclasses.replace(self, compression=0.0, tilt=(0.0, 0.0, 0.0))

    def check(self) -> None:
        """Refuse values that the kind of start would ignore, and a missing direction."""
        used = _USED_BY[self.kind]
        for item in dataclasses.fields(self):
            if item.name not in used and getattr(self, item.name) != item.default:
                raise ScenarioError(
                    item.name,
                    getattr(self, item.name),
                    f"has no effect on a {self.kind} start, which uses {', '.join(sorted(used))}",
                )
        if self.kind == "straight" and (self.direction is None or not any(self.direction)):
            raise ScenarioError("direction", self.direction, "a straight start needs a direction")


_USED_BY: dict[str, set[str]] = {
    "hanging": {
        "kind", "swing_angle", "swing_heading", "swing_rate", "cone_rate", "heading", "tilt",
        "body_rate", "twist", "payout_rate", "settling_time", "residual_speed",
    },
    "grounded": {
        "kind", "position", "heading", "settling_time", "residual_speed", "compression", "tilt",
    },
    "straight": {"kind", "direction", "tip_velocity", "attitude", "angular_velocity"},
}  # fmt: skip


@dataclass(frozen=True)
class SpatialScenario(Configuration):
    """All inputs of a spatial simulation."""

    name: str = text("short name, the file's name without .yaml")
    environment: Environment = configuration.section(Environment, "gravity and ground")
    tether: SpatialTether = configuration.section(SpatialTether, "the tether")
    start: SpatialStartSettings = configuration.section(
        SpatialStartSettings, "tether and rover at the start"
    )
    about: str = text("what is simulated, and sources of the values", "")
    model: Model = choice(get_args(Model), "the plant that integrates it", "spatial")
    winch: WinchSettings | None = configuration.section(
        WinchSettings, "the winch; null: a pinned root", None, optional=True
    )
    rover: RoverSettings | None = configuration.section(
        RoverSettings, "the rover", None, optional=True
    )
    tip: SpatialTipSettings | None = configuration.section(
        SpatialTipSettings, "tip of a tether without a rover", None, optional=True
    )
    root: DrivenEndSettings | None = configuration.section(
        DrivenEndSettings,
        "motion of the root, or of the fairlead with the winch; null: it rests",
        None,
        optional=True,
    )
    sensors: SensorSettings = configuration.section(SensorSettings, "the sensors", SensorSettings())
    integration: Integration = configuration.section(
        Integration, "the integrator's settings", Integration()
    )

    def check(self) -> None:
        """Refuse inconsistent sections."""
        if self.rover is not None and self.tip is not None:
            raise ScenarioError("tip", "given", "should be null, as the rover is at the tip")
        self._check_winch()
        self._check_driven()
        self._check_servos()
        if self.start.kind == "grounded":
            self._check_standing()
        if self.start.kind == "hanging":
            self._check_hanging()

    def _check_winch(self) -> None:
        tether, winch = self.tether, self.winch
        nominal = tether.nominal_length
        if winch is None:
            if self.start.payout_rate != 0.0:
                raise ScenarioError(
                    "start.payout_rate", self.start.payout_rate, "should be 0 without a winch"
                )
            if tether.max_length is not None:
                raise ScenarioError(
                    "tether.max_length", tether.max_length, "should be null without a winch"
                )
            if tether.elements is None and not _whole(tether.length / nominal):
                raise ScenarioError(
                    "tether.element_length",
                    nominal,
                    f"should divide the length {tether.length:g} m without a rest",
                )
            return
        if not winch.min_length <= tether.length <= tether.whole_length:
            raise ScenarioError(
                "tether.length",
                tether.length,
                f"should be between the winch's min_length {winch.min_length:g} m and max_length"
                f" {tether.whole_length:g} m",
            )
        least = LONGEST_EXIT * nominal
        if winch.min_length < least:
            raise ScenarioError(
                "winch.min_length",
                winch.min_length,
                f"should be at least {least:g} m, {LONGEST_EXIT:g} nominal element lengths",
            )
        if winch.min_length >= tether.whole_length:
            raise ScenarioError(
                "winch.min_length",
                winch.min_length,
                f"should be below the tether's whole length {tether.whole_length:g} m",
            )

    def _check_driven(self) -> None:
        if self.winch is not None and self.tether.masses:
            raise ScenarioError("tether.masses", "given", "should be empty with a winch")
        if self.winch is not None and self.tether.bending_relaxation_ratio > 0.0:
            raise ScenarioError(
                "tether.bending_relaxation_ratio",
                self.tether.bending_relaxation_ratio,
                "should be 0 with a winch",
            )
        if self.start.kind == "grounded" and self.root is not None:
            raise ScenarioError(
                "root", "given", "should be null for a grounded start, which settles at rest"
            )

    def _check_servos(self) -> None:
        motors = {}
        if self.winch is not None:
            motors["winch.motor"] = self.winch.motor
        if self.rover is not None:
            motors["rover.jump_drive.motor"] = self.rover.jump_drive.motor
            motors["rover.wheel_drive.motor"] = self.rover.wheel_drive.motor
        h = self.integration.h
        for name, motor in motors.items():
            bandwidth = motor.servo_bandwidth
            if bandwidth * h > LARGEST_SERVO_STEP * (1.0 + 1e-9):
                raise ScenarioError(
                    "integration.h",
                    h,
                    f"should be at most {LARGEST_SERVO_STEP / bandwidth:g} s for"
                    f" {name}.servo_bandwidth of {bandwidth:g} rad/s, or that bandwidth at most"
                    f" {LARGEST_SERVO_STEP / h:g} rad/s",
                )

    def _check_hanging(self) -> None:
        start, settles = self.start, self.tether.has_frames
        for name in _MOTIONS if settles else _SETTLING:
            item = SpatialStartSettings.__dataclass_fields__[name]
            if getattr(start, name) != item.default:
                raise ScenarioError(
                    f"start.{name}",
                    getattr(start, name),
                    "should be 0: a hanging start with tether.natural_curvature or"
                    " tether.bending_relaxation_ratio settles at rest; a straight start may move"
                    if settles
                    else "has no effect on a hanging start without tether.natural_curvature or"
                    " tether.bending_relaxation_ratio",
                )

    def _check_standing(self) -> None:
        if self.rover is None:
            raise ScenarioError("rover", None, "a grounded start needs a rover")
        if self.environment.floor is None:
            raise ScenarioError("environment.floor", None, "a grounded start needs a floor")
        reach = math.hypot(*self.start.position, self._attachment_height(self.rover))
        if reach >= self.tether.length:
            raise ScenarioError(
                "tether.length",
                self.tether.length,
                f"should be above {reach:.4g} m, or the tether does not reach the rover",
            )
        compression, stroke = self.start.compression, self.rover.jump_drive.stroke
        if compression > 0.0 and self.rover.is_single_body:
            raise ScenarioError(
                "start.compression",
                compression,
                "should be 0 m for a rover of a single body (rover.m2 = 0), which cannot jump",
            )
        if compression > stroke:
            raise ScenarioError(
                "start.compression",
                compression,
                f"should be at most the jump drive's stroke of {stroke:g} m",
            )
        if compression == 0.0 and any(self.start.tilt):
            raise ScenarioError(
                "start.tilt",
                self.start.tilt,
                "should be 0 for a grounded start without a start.compression",
            )

    def _attachment_height(self, rover: RoverSettings) -> float:
        """Return the height of the attachment of a level rover on the floor, in map [m]."""
        above_floor = rover.attachment[2] - rover.wheels.axle_z + rover.wheels.tip_radius
        return self.environment.floor_height + above_floor

    @classmethod
    def from_mapping(cls, mapping: object) -> SpatialScenario:
        """Build a scenario from nested plain values.

        Raises:
            ScenarioError: a value is invalid; names the dotted path and what is expected.
        """
        return configuration.read(cls, mapping)

    def to_mapping(self) -> dict[str, Any]:
        """Return all values as JSON-compatible types, the inverse of `from_mapping`."""
        return configuration.to_mapping(self)

    def with_overrides(self, overrides: Mapping[str, object]) -> SpatialScenario:
        """Return a copy with values replaced by dotted path, e.g. ``{"tether.length": 20.0}``."""
        return configuration.overridden(self, overrides)

    @property
    def gravity(self) -> float:
        """Gravitational acceleration [m/s^2]."""
        return self.environment.gravity

    @property
    def tip_mass(self) -> float:
        """Mass at the tether's tip [kg]."""
        if self.rover is not None:
            return self.rover.mass
        return self.tip.mass if self.tip is not None else 0.0

    @property
    def chain(self) -> tuple[int, float]:
        """Number of elements of nominal length at the start, and length of the first element [m].

        The first element is the one at the fairlead; without a winch its length is 0.
        """
        tether = self.tether
        count = round(tether.length / tether.nominal_length)
        if self.winch is None:
            return count, 0.0
        chain = max(1, count - 1)
        return chain, tether.length - chain * tether.nominal_length

    @property
    def most_elements(self) -> int:
        """Largest number of elements of nominal length."""
        if self.winch is None:
            return self.chain[0]
        tether = self.tether
        return max(1, math.ceil(tether.whole_length / tether.nominal_length))


# Of a hanging start: what moves it, and what it uses to settle.
_MOTIONS = (
    "swing_angle", "swing_rate", "cone_rate", "tilt", "body_rate", "payout_rate",
)  # fmt: skip
_SETTLING = ("settling_time", "residual_speed")


def _whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-9 * max(1.0, number)
