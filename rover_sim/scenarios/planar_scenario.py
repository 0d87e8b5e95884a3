# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Planar scenarios: tether and rover in a vertical plane, as typed, frozen and checked data.

A scenario defines the tether, the rover or point mass at its tip, the start, the take-off and the
integration. Axes of the planar model: x horizontal, y up, angles counter-clockwise, the tether's
root (the fairlead) at the origin and the rover on the side of positive x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, choice, quantity, text
from rover_sim.scenarios.scenario_parts import CrossSection, Integration, ScenarioError, known

Model: TypeAlias = Literal["planar"]
Root: TypeAlias = Literal["pinned", "clamped"]
Geometry: TypeAlias = Literal["-H", "-K", "+K", "chord", "straight"]
Side: TypeAlias = Literal["below", "above"]
InitialShape: TypeAlias = Literal["static", "catenary", "arc", "straight"]
TetherRates: TypeAlias = Literal["tip", "linear"]
AfterLanding: TypeAlias = Literal["hold", "fly_on"]

Point: TypeAlias = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PlanarTetherSettings(CrossSection):
    """An ANCF cable of uniform cross-section, divided into equal elements."""

    length: float = quantity("m", "unstretched length", above=0.0, maximum=1e4)
    elements: int = quantity("-", "number of elements", kind=int, minimum=1, maximum=2000)
    root: Root = choice(get_args(Root), "slope at the root: free or fixed", "pinned")


@dataclass(frozen=True)
class PlanarRoverSettings(Configuration):
    """Body 1 (wheels, motors, tether) and Body 2, which slides on it and jumps.

    Both are uniform rectangles with their centres of mass in the middle.
    """

    m1: float = quantity("kg", "mass of Body 1", above=0.0, maximum=1e5)
    m2: float = quantity("kg", "mass of Body 2", above=0.0, maximum=1e5)
    body1_size: Point = quantity("m", "width and height of Body 1", above=0.0, length=2)
    body2_size: Point = quantity("m", "width and height of Body 2", above=0.0, length=2)
    attachment: Point = quantity(
        "m", "tether's attachment (a, b) from Body 1's centre, in its axes", length=2
    )
    spring_rate: float = quantity("N/m", "k of the jump spring", above=0.0)
    spring_free_length: float = quantity(
        "m", "l0, between the centres of mass", above=0.0, maximum=100.0
    )
    slider_damping: float = quantity("N s/m", "damper along the slider", 0.0, minimum=0.0)

    @property
    def mass(self) -> float:
        """m1 + m2 [kg]."""
        return self.m1 + self.m2

    @property
    def inertia1(self) -> float:
        """Moment of inertia of Body 1 about its centre [kg m^2]."""
        return _rectangle_inertia(self.m1, self.body1_size)

    @property
    def inertia2(self) -> float:
        """Moment of inertia of Body 2 about its centre [kg m^2]."""
        return _rectangle_inertia(self.m2, self.body2_size)


@dataclass(frozen=True)
class PlanarTipSettings(Configuration):
    """Tip of a tether without a rover: a point mass, or a free end."""

    mass: float = quantity("kg", "point mass at the tip, 0 for a free end", 0.0, minimum=0.0)


@dataclass(frozen=True)
class PlanarStartSettings(Configuration):
    """Position of the tether's tip and shape of the tether at the start.

    The slack evaluation value is dh/df, the vertical over the horizontal distance
    between root and tip. The geometries, tip at (x, y):

    ``-H``
        below the root by `drop`, at the horizontal distance drop/slack.
    ``-K``, ``+K``
        below or above the root, on a chord of `chord_ratio` times the tether's
        length at the angle atan(slack).
    ``chord``
        as -K and +K with a chord of `chord` metres, on the given `side`.
    ``straight``
        straight and unstretched along `direction`.
    """

    geometry: Geometry = choice(get_args(Geometry), "position of the tip")
    slack: float | None = quantity(
        "-", "slack evaluation value dh/df", None, minimum=0.0, maximum=1e6, optional=True
    )
    drop: float = quantity("m", "dh of geometry -H", 2.2, above=0.0, maximum=1e4)
    chord_ratio: float = quantity(
        "-", "chord over length of -K and +K", 0.99, above=0.0, maximum=0.99999
    )
    chord: float | None = quantity("m", "chord of geometry chord", None, above=0.0, optional=True)
    side: Side | None = choice(
        get_args(Side),
        "side of the root on which the tip of geometry chord is",
        None,
        optional=True,
    )
    direction: float | None = quantity(
        "deg",
        "direction of a straight tether and of a clamped root's slope; 0 level, -90 down",
        None,
        minimum=-360.0,
        maximum=360.0,
        optional=True,
    )
    initial_shape: InitialShape = choice(
        get_args(InitialShape),
        "static: equilibrium; unrelaxed: catenary (inextensible), arc (circular), straight",
        "static",
    )
    theta0: float = quantity("deg", "angle of the rover", 0.0, minimum=-180.0, maximum=180.0)

    def check(self) -> None:
        """Refuse values that the geometry lacks and values that it would ignore."""
        straight = self.geometry == "straight"
        if straight != (self.initial_shape == "straight"):
            right = "straight" if straight else "static, catenary or arc"
            raise ScenarioError(
                "initial_shape", self.initial_shape, f"geometry {self.geometry} requires {right}"
            )
        if straight:
            self._require("direction", "the tether's direction in degrees")
        else:
            self._require("slack", "the slack value dh/df")
        if self.geometry == "-H" and self.slack == 0.0:
            raise ScenarioError("slack", self.slack, "should be above 0 with geometry -H")
        for name in ("chord", "side"):
            if self.geometry == "chord":
                self._require(name, "the chord [m] and the side, below or above")
            elif getattr(self, name) is not None:
                raise ScenarioError(
                    name,
                    getattr(self, name),
                    f"should be null with geometry {self.geometry}; only geometry chord uses it",
                )

    def _require(self, name: str, what: str) -> None:
        if getattr(self, name) is None:
            raise ScenarioError(name, None, f"geometry {self.geometry} needs {what}")

    def tip_position(self, length: float) -> Point:
        """Position (x, y) [m] of the tip of a tether of the given length [m]."""
        if self.geometry == "straight":
            angle = math.radians(known(self.direction))
            return length * math.cos(angle), length * math.sin(angle)
        slack = known(self.slack)
        if self.geometry == "-H":
            return self.drop / slack, -self.drop
        chord = self.chord_ratio * length if self.chord is None else self.chord
        above = self.geometry == "+K" or self.side == "above"
        angle = math.atan(slack) if above else -math.atan(slack)
        return chord * math.cos(angle), chord * math.sin(angle)


@dataclass(frozen=True)
class TakeOff(Configuration):
    """Take-off by the jump spring, or with a given velocity.

    Both bodies start with the same velocity and the spring at its free length. A
    compression delta gives the speed delta sqrt(k/(m1 + m2)) along the slider.
    """

    compression: float | None = quantity(
        "m", "delta, compression of the spring", None, above=0.0, maximum=10.0, optional=True
    )
    velocity: Point | None = quantity(
        "m/s", "velocity (vx, vy) of both bodies", None, length=2, optional=True
    )
    tether_rates: TetherRates = choice(
        get_args(TetherRates),
        "initial velocity of the tether: tip: at the tip alone; linear: proportional to arc length",
        "tip",
    )

    def check(self) -> None:
        """Require exactly one of compression and velocity."""
        if (self.compression is None) == (self.velocity is None):
            raise ScenarioError(
                "compression",
                self.compression,
                f"should be given exactly one of compression and velocity (velocity is"
                f" {configuration.shown(self.velocity)})",
            )


@dataclass(frozen=True)
class Scenario(Configuration):
    """All inputs of a planar simulation."""

    name: str = text("short name, the file's name without .yaml")
    tether: PlanarTetherSettings = configuration.section(PlanarTetherSettings, "the tether")
    start: PlanarStartSettings = configuration.section(
        PlanarStartSettings, "tether and rover at the start"
    )
    gravity: float = quantity("m/s^2", "g, along -y", minimum=0.0, maximum=1e3)
    about: str = text("what is simulated, and sources of the values", "")
    model: Model = choice(get_args(Model), "the plant that integrates it", "planar")
    rover: PlanarRoverSettings | None = configuration.section(
        PlanarRoverSettings, "the rover", None, optional=True
    )
    tip: PlanarTipSettings | None = configuration.section(
        PlanarTipSettings, "tip of a tether without a rover", None, optional=True
    )
    take_off: TakeOff | None = configuration.section(
        TakeOff, "the rover's take-off", None, optional=True
    )
    after_landing: AfterLanding = choice(
        get_args(AfterLanding), "hold: the ground stops the rover where it lands", "hold"
    )
    integration: Integration = configuration.section(
        Integration, "the integrator's settings", Integration()
    )

    def check(self) -> None:
        """Refuse inconsistent sections."""
        if self.rover is not None:
            if self.tip is not None:
                raise ScenarioError("tip", self.tip, "should be null, as the rover is at the tip")
            if self.take_off is None:
                raise ScenarioError(
                    "take_off", None, "a rover needs a compression [m] or a velocity [m/s]"
                )
        elif self.take_off is not None:
            raise ScenarioError("take_off", self.take_off, "should be null without a rover")
        if self.tether.root == "clamped" and self.start.direction is None:
            raise ScenarioError(
                "start.direction", None, "a clamped root needs the direction of its slope [deg]"
            )
        if self.start.geometry != "straight":
            self._check_reach()

    def _check_reach(self) -> None:
        start, length = self.start, self.tether.length
        chord = math.hypot(*self.tip_position)
        if chord < length:
            return
        if start.geometry == "-H":
            if start.drop >= length:
                raise ScenarioError(
                    "start.drop", start.drop, f"should be below the tether's length {length:g} m"
                )
            least = start.drop / math.sqrt(length**2 - start.drop**2)
            raise ScenarioError(
                "start.slack",
                start.slack,
                f"puts the tip {chord:.4g} m from the root, out of reach of a tether of"
                f" {length:g} m; with a drop of {start.drop:g} m it should be above {least:.4g}",
            )
        raise ScenarioError(
            "start.chord", start.chord, f"should be below the tether's length {length:g} m"
        )

    @classmethod
    def from_mapping(cls, mapping: object) -> Scenario:
        """Build a scenario from nested plain values.

        Raises:
            ScenarioError: a value is invalid; names the dotted path and what is expected.
        """
        return configuration.read(cls, mapping)

    def to_mapping(self) -> dict[str, Any]:
        """Return all values as JSON-compatible types, the inverse of `from_mapping`."""
        return configuration.to_mapping(self)

    def with_overrides(self, overrides: Mapping[str, object]) -> Scenario:
        """Return a copy with values replaced by dotted path, e.g. ``{"start.slack": 2.0}``."""
        return configuration.overridden(self, overrides)

    @cached_property
    def tip_position(self) -> Point:
        """Position (x, y) [m] of the tether's tip at the start."""
        return self.start.tip_position(self.tether.length)

    @property
    def slack_value(self) -> float:
        """Slack evaluation value dh/df at the start; infinite straight up or down."""
        if self.start.geometry != "straight" and self.start.slack is not None:
            return self.start.slack
        x, y = self.tip_position
        return abs(y / x) if abs(x) > 1e-12 * self.tether.length else math.inf

    @property
    def theta0(self) -> float:
        """The rover's angle at the start [rad]."""
        return math.radians(self.start.theta0)

    @property
    def tip_mass(self) -> float:
        """Point mass at the tip of a tether without a rover [kg]."""
        return self.tip.mass if self.tip is not None else 0.0

    @property
    def take_off_velocity(self) -> Point:
        """Velocity (vx, vy) [m/s] of both bodies at take-off; zero without a rover."""
        if self.take_off is None or self.rover is None:
            return 0.0, 0.0
        if self.take_off.velocity is not None:
            return self.take_off.velocity
        delta = known(self.take_off.compression)
        speed = delta * math.sqrt(self.rover.spring_rate / self.rover.mass)
        return -speed * math.sin(self.theta0), speed * math.cos(self.theta0)

    @property
    def take_off_energy(self) -> float:
        """Kinetic energy of both bodies at take-off [J]."""
        vx, vy = self.take_off_velocity
        return 0.5 * self.rover.mass * (vx**2 + vy**2) if self.rover is not None else 0.0


def _rectangle_inertia(mass: float, size: Point) -> float:
    return mass * (size[0] ** 2 + size[1] ** 2) / 12.0
