# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Spatial scenarios: place, tether, winch, rover, sensors and start, typed, frozen and checked.

Axes are those of REP-103: map has its origin at the fairlead, x forward and z up; base_link
(module `machine`) has x forward, y left along the wheels' axle and z up along the slider.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, choice, quantity, text
from rover_sim.environment import Environment, TetherContact
from rover_sim.hardware import Rover, Vector, Winch
from rover_sim.physics.drum import DrumParameters
from rover_sim.scenario_parts import CrossSection, Integration, ScenarioError
from rover_sim.sensors import Sensors

Model: TypeAlias = Literal["spatial"]
StartKind: TypeAlias = Literal["hanging", "grounded", "straight"]

# Undeformed length of the element at the fairlead over the nominal one, smallest and largest.
SHORTEST_EXIT, LONGEST_EXIT = 0.5, 1.5


@dataclass(frozen=True, kw_only=True)
class SpatialTether(CrossSection):
    """An ANCF cable between fairlead and rover, of elements of one nominal length."""

    length: float = quantity("m", "paid out at the start, unstretched", above=0.0, maximum=1e3)
    max_length: float | None = quantity(
        "m", "all there is, with a winch; null: the length", None, above=0.0, maximum=1e3,
        optional=True,
    )  # fmt: skip
    elements: int | None = quantity(
        "-", "number for the length at the start", None, kind=int, minimum=1, maximum=2000,
        optional=True,
    )  # fmt: skip
    element_length: float | None = quantity(
        "m", "nominal length of an element, instead", None, above=0.0, optional=True
    )
    contact: TetherContact | None = configuration.section(
        TetherContact, "with the ground; null: it falls through", TetherContact(), optional=True
    )
    twist_stiffness: float = quantity("N m^2", "GJ", 0.0, minimum=0.0)
    swivel_friction: float = quantity(
        "N m", "of the swivel at the rover; 0 free, .inf clamped", 0.0, minimum=0.0, infinite=True
    )

    def check(self) -> None:
        """Refuse a mesh that is given in no way or in two."""
        super().check()
        if (self.elements is None) == (self.element_length is None):
            raise ScenarioError(
                "elements",
                self.elements,
                "should be given exactly one of elements and element_length (that is"
                f" {configuration.shown(self.element_length)})",
            )
        if self.max_length is not None and self.max_length < self.length:
            raise ScenarioError(
                "max_length", self.max_length, f"should be at least the length {self.length:g} m"
            )

    @property
    def nominal_length(self) -> float:
        """l_nom [m]."""
        if self.elements is not None:
            return self.length / self.elements
        assert self.element_length is not None
        return self.element_length

    @property
    def whole_length(self) -> float:
        """All the tether there is [m]."""
        return self.length if self.max_length is None else self.max_length


@dataclass(frozen=True)
class Tip(Configuration):
    """What hangs at the tether instead of a rover."""

    mass: float = quantity("kg", "point mass, 0 for a free end", 0.0, minimum=0.0)


@dataclass(frozen=True)
class Start(Configuration):
    """How tether and rover are at the start.

    ``hanging``
        in equilibrium under gravity, then turned as a whole about the fairlead by `swing_angle`
        towards `swing_heading` and moving as a whole with `swing_rate` (in that vertical plane)
        and `cone_rate` (about the vertical). base_link's x points to `heading`; `tilt` turns the
        rover further and `body_rate` is added to its angular velocity. The tether is twisted by
        `twist`, and already being paid out at `payout_rate`, the brake open.
    ``standing``
        on the floor at `position`, facing `heading`, the tether slack: from the fairlead down and
        along the floor. Rover and tether are settled by simulating them for up to `settling`;
        what moves faster than `creep` then is refused.
    ``straight``
        straight and unstretched along `direction`, the tip moving with `tip_velocity` and the
        rest linearly with arc length; `attitude` is the rover's rotation vector, body to map, and
        `angular_velocity` its rate in map.
    """

    kind: StartKind = choice(get_args(StartKind), "which of the three")
    swing_angle: float = quantity("deg", "from the vertical", 0.0, minimum=-180.0, maximum=180.0)
    swing_heading: float = quantity("deg", "from x towards y", 0.0, minimum=-360.0, maximum=360.0)
    swing_rate: float = quantity("deg/s", "rate of the swing angle", 0.0)
    cone_rate: float = quantity("deg/s", "about the vertical", 0.0)
    heading: float = quantity(
        "deg", "of base_link's x, from x towards y", 0.0, minimum=-360.0, maximum=360.0
    )
    tilt: Vector = quantity(
        "deg", "rotation vector in base_link, on top", (0.0, 0.0, 0.0), length=3
    )
    body_rate: Vector = quantity(
        "deg/s", "angular velocity in base_link, on top", (0.0, 0.0, 0.0), length=3
    )
    twist: float = quantity("deg", "of the tether, rover against fairlead", 0.0)
    position: tuple[float, float] = quantity("m", "x and y of base_link", (0.0, 0.0), length=2)
    settling_time: float = quantity(
        "s", "longest simulated time of settling", 60.0, above=0.0, maximum=600.0
    )
    residual_speed: float = quantity(
        "m/s", "speed of rover and tether that is borne when that is over, as of wheels that roll "
        "down a slope", 1.0e-6, above=0.0, maximum=0.1,
    )  # fmt: skip
    direction: Vector | None = quantity(
        "-", "of the straight tether, any length", None, length=3, optional=True
    )
    tip_velocity: Vector = quantity("m/s", "of the attachment", (0.0, 0.0, 0.0), length=3)
    attitude: Vector = quantity(
        "rad", "rotation vector, base_link to map", (0.0, 0.0, 0.0), length=3
    )
    angular_velocity: Vector = quantity("rad/s", "in map", (0.0, 0.0, 0.0), length=3)
    payout_rate: float = quantity(
        "m/s", "of the winch, that turns already; > 0 lengthens", 0.0, minimum=-10.0, maximum=10.0
    )

    def check(self) -> None:
        """Refuse what would silently be left unused, and a direction that is none."""
        used = _USED_BY[self.kind]
        for item in dataclasses.fields(self):
            if item.name not in used and getattr(self, item.name) != item.default:
                raise ScenarioError(
                    item.name,
                    getattr(self, item.name),
                    f"is of no use to a {self.kind} start, which takes {', '.join(sorted(used))}",
                )
        if self.kind == "straight" and (self.direction is None or not any(self.direction)):
            raise ScenarioError("direction", self.direction, "a straight start needs a direction")


_USED_BY: dict[str, set[str]] = {
    "hanging": {
        "kind", "swing_angle", "swing_heading", "swing_rate", "cone_rate", "heading", "tilt",
        "body_rate", "twist", "payout_rate",
    },
    "grounded": {"kind", "position", "heading", "settling_time", "residual_speed"},
    "straight": {"kind", "direction", "tip_velocity", "attitude", "angular_velocity"},
}  # fmt: skip


@dataclass(frozen=True)
class SpatialScenario(Configuration):
    """Everything that a simulation in space starts from."""

    name: str = text("short name, the file's name without .yaml")
    environment: Environment = configuration.section(Environment, "gravity and ground")
    tether: SpatialTether = configuration.section(SpatialTether, "the tether")
    start: Start = configuration.section(Start, "how all is at the start")
    about: str = text("what it is and where its numbers come from", "")
    model: Model = choice(get_args(Model), "the plant that integrates it", "spatial")
    winch: Winch | None = configuration.section(
        Winch, "the winch; null: a root that is pinned", None, optional=True
    )
    rover: Rover | None = configuration.section(Rover, "the rover", None, optional=True)
    tip: Tip | None = configuration.section(
        Tip, "what ends a tether without a rover", None, optional=True
    )
    sensors: Sensors = configuration.section(Sensors, "what measures", Sensors())
    integration: Integration = configuration.section(
        Integration, "how the motion is integrated", Integration()
    )

    def check(self) -> None:
        """Refuse parts that do not fit one another."""
        if self.rover is not None and self.tip is not None:
            raise ScenarioError("tip", "given", "should be null, as the rover is at the tip")
        self._check_winch()
        if self.start.kind == "grounded":
            self._check_standing()

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
                f"should be at least {least:g} m, {LONGEST_EXIT:g} elements, so that one is left",
            )
        configuration_of_drum(winch, tether.whole_length)

    def _check_standing(self) -> None:
        if self.rover is None:
            raise ScenarioError("rover", None, "a standing start needs a rover")
        if self.environment.floor is None:
            raise ScenarioError("environment.floor", None, "a standing start needs a floor")
        reach = math.hypot(*self.start.position, self._attachment_height(self.rover))
        if reach >= self.tether.length:
            raise ScenarioError(
                "tether.length",
                self.tether.length,
                f"should be above {reach:.4g} m, or the tether does not reach the rover",
            )

    def _attachment_height(self, rover: Rover) -> float:
        """Of a rover that stands level on the floor, in map [m]."""
        above_floor = rover.attachment[2] - rover.wheels.axle_z + rover.wheels.tip_radius
        return self.environment.floor_height + above_floor

    @classmethod
    def from_mapping(cls, mapping: object) -> SpatialScenario:
        """Build a scenario from nested plain values.

        Raises:
            ScenarioError: Naming the dotted path, the value and what would be right.
        """
        return configuration.read(cls, mapping)

    def to_mapping(self) -> dict[str, Any]:
        """Every value, plain and JSON-ready; `from_mapping` gives the scenario back."""
        return configuration.to_mapping(self)

    def with_overrides(self, overrides: Mapping[str, object]) -> SpatialScenario:
        """Copy with values replaced by dotted path, e.g. ``{"tether.length": 20.0}``."""
        return SpatialScenario.from_mapping(
            configuration.with_overrides(self.to_mapping(), overrides)
        )

    @property
    def gravity(self) -> float:
        """Strength of gravity [m/s^2]."""
        return self.environment.gravity

    @property
    def tip_mass(self) -> float:
        """What hangs at the tether [kg]."""
        if self.rover is not None:
            return self.rover.mass
        return self.tip.mass if self.tip is not None else 0.0

    @property
    def chain(self) -> tuple[int, float]:
        """Elements of nominal length at the start, and the length of the one at the fairlead [m].

        Without a winch there is no such element, and its length is 0.
        """
        tether = self.tether
        count = round(tether.length / tether.nominal_length)
        if self.winch is None:
            return count, 0.0
        chain = max(1, count - 1)
        return chain, tether.length - chain * tether.nominal_length

    @property
    def most_elements(self) -> int:
        """Elements of nominal length that there can be at most."""
        if self.winch is None:
            return self.chain[0]
        tether = self.tether
        return max(1, math.ceil(tether.whole_length / tether.nominal_length))


def configuration_of_drum(winch: Winch, max_length: float) -> DrumParameters:
    """The drum's parameters, with what the tether's length makes of them.

    Raises:
        ScenarioError: the physics refuses them.
    """
    try:
        return winch.parameters(max_length=max_length)  # type: ignore[no-any-return]
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError("winch", str(error).partition(":")[0], str(error)) from None


def _whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-9 * max(1.0, number)
