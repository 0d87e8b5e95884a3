# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""The place in space: gravity, floor, boulders, hole and what the ground is made of.

Axes: map, z up, the fairlead at the origin.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias, get_args

import numpy as np

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, ConfigurationError, choice, quantity
from rover_sim.physics import boulders, contact, terrain_parameters, tether_contact, wheel_soil
from rover_sim.physics.ancf import Array
from rover_sim.physics.terrain import Terrain, build_terrain, floor_heights, wall_profile
from rover_sim.physics.wheel_contact import WheelLaw
from rover_sim.physics_section import PhysicsSection, refuse_what_is_refused_by

Material: TypeAlias = Literal["regolith", "rock"]

_BOULDERS = boulders.BoulderParameters()
_RELIEF = terrain_parameters.ReliefParameters()
_TERRAIN = terrain_parameters.TerrainParameters()
_SOIL = wheel_soil.Soil()
_TETHER = tether_contact.TetherContactParameters()
_WHEEL_LAW: dict[str, float] = WheelLaw._field_defaults
_KNOWN_HOLES = {
    "marius_hills": terrain_parameters.MARIUS_HILLS,
    "tranquillitatis": terrain_parameters.MARE_TRANQUILLITATIS,
    "ingenii": terrain_parameters.MARE_INGENII,
}
_FAR_BELOW = 1.0e6  # floor of a place without one [m]; farther than any tether reaches


@dataclass(frozen=True)
class Floor(Configuration):
    """A plane below the fairlead; with a hole its height follows from the hole's depth."""

    height: float = quantity(
        "m", "z of the floor below the fairlead", _TERRAIN.floor_height, maximum=0.0
    )
    slope: float = quantity("deg", "inclination", 0.0, minimum=0.0, maximum=60.0)
    downhill: float = quantity(
        "deg", "where the slope falls to, from x towards y", 0.0, minimum=-360.0, maximum=360.0
    )
    material: Material = choice(get_args(Material), "what it is", "regolith")

    @property
    def gradient(self) -> tuple[float, float]:
        """dz/dx and dz/dy [-]."""
        fall, heading = math.tan(math.radians(self.slope)), math.radians(self.downhill)
        return -fall * math.cos(heading), -fall * math.sin(heading)


@dataclass(frozen=True)
class Relief(PhysicsSection):
    """Gentle ups and downs of the floor on the patch."""

    KIND = terrain_parameters.ReliefParameters

    rms: float = quantity("m", "root mean square height", _RELIEF.rms, minimum=0.0)
    spacing: float = quantity("m", "of the nodes", _RELIEF.spacing, above=0.0)
    octaves: int = quantity("-", "of wavelengths", _RELIEF.octaves, kind=int, minimum=1, maximum=8)
    roughness: float = quantity(
        "-", "amplitude of an octave over the next", _RELIEF.roughness, above=0.0, maximum=1.0
    )


@dataclass(frozen=True)
class Boulders(PhysicsSection):
    """Boulders strewn over the patch by a power law."""

    KIND = boulders.BoulderParameters

    density: float = quantity(
        "1/m^2", "boulders of all sizes per area", _BOULDERS.density, minimum=0.0, maximum=20.0
    )
    smallest: float = quantity("m", "diameter", _BOULDERS.smallest, above=0.0)
    largest: float = quantity("m", "diameter", _BOULDERS.largest, above=0.0)
    exponent: float = quantity("-", "b of N(>= D) ~ D^-b", _BOULDERS.exponent, above=0.0)
    height_ratio: float = quantity(
        "-", "height over diameter", _BOULDERS.height_ratio, above=0.0, maximum=0.5
    )
    clear_radius: float = quantity(
        "m", "free of boulders around the plumb line", _BOULDERS.clear_radius, minimum=0.0
    )


@dataclass(frozen=True)
class Patch(Configuration):
    """The square that relief and boulders cover."""

    centre: tuple[float, float] = quantity("m", "x and y", _TERRAIN.patch_centre, length=2)
    half_width: float = quantity(
        "m", "half its side", _TERRAIN.patch_half_width, above=0.0, maximum=200.0
    )


@dataclass(frozen=True)
class Hole(Configuration):
    """A vertical hole: a known one, or one by its numbers.

    A hole by numbers has a straight wall that widens by `overhang` below `overhang_depth`.
    """

    preset: str | None = choice(tuple(_KNOWN_HOLES), "a hole of the Moon", None, optional=True)
    diameter: float | None = quantity("m", "of the mouth", None, above=0.0, optional=True)
    depth: float | None = quantity("m", "from ground to floor", None, above=0.0, optional=True)
    overhang: float | None = quantity(
        "m", "radius of the floor beyond the mouth's, of a hole by numbers", None, optional=True
    )
    overhang_depth: float | None = quantity(
        "m", "depth at which the wall begins to widen", None, above=0.0, optional=True
    )
    wall_distance: float = quantity("m", "fairlead's, at the narrowest", 3.0, above=0.0)
    fairlead_height: float = quantity("m", "above the ground around", 1.0, above=0.0)
    rim_radius: float = quantity("m", "rounding of the rim", 1.0, above=0.0)

    def check(self) -> None:
        """Refuse a hole that is given in no way or in two."""
        numbers = ("diameter", "depth")
        for name in (*numbers, "overhang", "overhang_depth"):
            value = getattr(self, name)
            if self.preset is not None and value is not None:
                raise ConfigurationError(name, value, f"should be null, as preset is {self.preset}")
        for name in numbers:
            if self.preset is None and getattr(self, name) is None:
                raise ConfigurationError(
                    name, None, f"needed, unless preset is one of {', '.join(_KNOWN_HOLES)}"
                )
        if (self.overhang is None) != (self.overhang_depth is None):
            raise ConfigurationError(
                "overhang_depth", self.overhang_depth, "should be given together with overhang"
            )
        refuse_what_is_refused_by(self.parameters)

    def parameters(self) -> terrain_parameters.HoleParameters:
        """What the terrain is built from."""
        place: dict[str, Any] = {
            "wall_distance": self.wall_distance,
            "fairlead_height": self.fairlead_height,
            "rim_radius": self.rim_radius,
        }
        if self.preset is not None:
            return dataclasses.replace(_KNOWN_HOLES[self.preset], **place)
        assert self.diameter is not None
        assert self.depth is not None
        profile: tuple[tuple[float, float], ...] = ()
        if self.overhang is not None and self.overhang_depth is not None:
            if not self.overhang_depth < self.depth:
                raise ConfigurationError(
                    "overhang_depth", self.overhang_depth, f"should be below {self.depth:g} m"
                )
            profile = ((self.overhang_depth, 0.0), (self.depth, self.overhang))
        return terrain_parameters.HoleParameters(
            diameter=self.diameter, depth=self.depth, profile=profile, **place
        )


@dataclass(frozen=True)
class Contact(PhysicsSection):
    """Law of contact between the rover's corners, or its wheels, and a ground."""

    KIND: ClassVar[type] = contact.ContactParameters

    stiffness: float = quantity("N/m^1.5", "k of k d^1.5", above=0.0)
    damping: float = quantity("s/m", "c of 1 + 1.5 c d'", 0.5, minimum=0.0)
    static_friction: float = quantity("-", "mu at rest", 0.6, minimum=0.0, maximum=5.0)
    kinetic_friction: float = quantity("-", "mu sliding", 0.5, minimum=0.0, maximum=5.0)
    stribeck_speed: float = quantity("m/s", "over which mu falls", 0.05, above=0.0)
    slip_speed: float = quantity("m/s", "of the regularisation", 0.002, above=0.0)
    anchor_stiffness: float = quantity("N/m", "of the parking anchor", 1.0e5, minimum=0.0)


@dataclass(frozen=True)
class TetherContact(PhysicsSection):
    """Law of contact between a metre of tether and the ground."""

    KIND = tether_contact.TetherContactParameters

    rock_stiffness: float = quantity("N/m^1.5/m", "k on rock", _TETHER.rock_stiffness, above=0.0)
    regolith_stiffness: float = quantity(
        "N/m^1.5/m", "k on regolith", _TETHER.regolith_stiffness, above=0.0
    )
    damping: float = quantity("s/m", "c of 1 + 1.5 c d'", _TETHER.damping, minimum=0.0)
    rock_static_friction: float = quantity(
        "-", "mu at rest on rock", _TETHER.rock_static_friction, minimum=0.0, maximum=5.0
    )
    rock_kinetic_friction: float = quantity(
        "-", "mu sliding on rock", _TETHER.rock_kinetic_friction, minimum=0.0, maximum=5.0
    )
    regolith_static_friction: float = quantity(
        "-", "mu at rest", _TETHER.regolith_static_friction, minimum=0.0, maximum=5.0
    )
    regolith_kinetic_friction: float = quantity(
        "-", "mu sliding", _TETHER.regolith_kinetic_friction, minimum=0.0, maximum=5.0
    )
    stribeck_speed: float = quantity(
        "m/s", "over which mu falls", _TETHER.stribeck_speed, above=0.0
    )
    slip_speed: float = quantity("m/s", "of the regularisation", _TETHER.slip_speed, above=0.0)
    anchor_stiffness: float = quantity(
        "N/m/m", "of the parking anchor", _TETHER.anchor_stiffness, minimum=0.0
    )


@dataclass(frozen=True)
class Soil(PhysicsSection):
    """Strength of the regolith under a wheel."""

    KIND = wheel_soil.Soil

    cohesive_modulus: float = quantity("N/m^(n+1)", "k_c", _SOIL.cohesive_modulus, minimum=0.0)
    frictional_modulus: float = quantity("N/m^(n+2)", "k_phi", _SOIL.frictional_modulus, above=0.0)
    exponent: float = quantity("-", "n", _SOIL.exponent, minimum=0.3, maximum=2.0)
    cohesion: float = quantity("Pa", "c", _SOIL.cohesion, minimum=0.0)
    friction_angle: float = quantity("deg", "phi", _SOIL.friction_angle, above=0.0, maximum=60.0)
    shear_modulus: float = quantity("m", "K", _SOIL.shear_modulus, above=0.0)
    peak_offset: float = quantity("-", "c1", _SOIL.peak_offset, minimum=0.0, maximum=1.0)
    peak_slope: float = quantity("-", "c2", _SOIL.peak_slope, minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class WheelOnSoil(Configuration):
    """How a wheel sinks, slips sideways and parks."""

    damping: float = quantity("s/m", "of sinking", _WHEEL_LAW["damping"], minimum=0.0)
    parking_speed: float = quantity(
        "m/s", "below which it parks", _WHEEL_LAW["parking_speed"], above=0.0
    )
    slip_speed: float = quantity(
        "m/s", "of the regularisation", _WHEEL_LAW["slip_speed"], above=0.0
    )
    anchor_stiffness: float = quantity(
        "N/m", "of the parking anchor", _WHEEL_LAW["anchor_stiffness"], minimum=0.0
    )


@dataclass(frozen=True)
class Environment(Configuration):
    """Where it all happens."""

    gravity: float = quantity("m/s^2", "g, along -z", minimum=0.0, maximum=1e3)
    seed: int = quantity("-", "of relief and boulders", 0, kind=int, minimum=0, maximum=2**31 - 1)
    floor: Floor | None = configuration.section(
        Floor, "the floor; null: nothing to touch", Floor(), optional=True
    )
    patch: Patch = configuration.section(Patch, "where relief and boulders are", Patch())
    relief: Relief | None = configuration.section(Relief, "ups and downs", None, optional=True)
    boulders: Boulders | None = configuration.section(Boulders, "boulders", None, optional=True)
    hole: Hole | None = configuration.section(Hole, "a hole around all", None, optional=True)
    rock: Contact = configuration.section(
        Contact, "boulders, walls and bare rock", Contact.like(contact.ROCK)
    )
    regolith: Contact = configuration.section(
        Contact, "regolith, for the rover's corners", Contact.like(contact.REGOLITH)
    )
    soil: Soil = configuration.section(Soil, "regolith under a wheel", Soil())
    wheel: WheelOnSoil = configuration.section(WheelOnSoil, "wheels on regolith", WheelOnSoil())

    def check(self) -> None:
        """Refuse parts that nothing would show."""
        if self.floor is None:
            for name in ("relief", "boulders", "hole"):
                if getattr(self, name) is not None:
                    raise ConfigurationError(
                        name, "given", "should be null without a floor to carry it"
                    )
        if self.hole is not None and self.floor is not None and self.floor.slope != 0.0:
            raise ConfigurationError("floor.slope", self.floor.slope, "should be 0 in a hole")

    @property
    def parameters(self) -> terrain_parameters.TerrainParameters:
        """What the terrain is built from; without a floor, one that nothing reaches."""
        floor = self.floor
        if floor is None:
            return terrain_parameters.TerrainParameters(floor_height=-_FAR_BELOW)
        slope_x, slope_y = floor.gradient
        return terrain_parameters.TerrainParameters(
            floor_height=floor.height,
            slope_x=slope_x,
            slope_y=slope_y,
            floor_is_rock=floor.material == "rock",
            patch_centre=self.patch.centre,
            patch_half_width=self.patch.half_width,
            relief=None if self.relief is None else self.relief.parameters(),
            boulders=None if self.boulders is None else self.boulders.parameters(),
            hole=None if self.hole is None else self.hole.parameters(),
        )

    def build(self) -> Terrain:
        """The terrain."""
        return build_terrain(self.parameters, self.seed)

    @property
    def floor_height(self) -> float:
        """Height of the floor's plane below the fairlead [m]; -inf without one."""
        if self.floor is None:
            return -math.inf
        if self.hole is not None:
            hole = self.hole.parameters()
            return -hole.fairlead_height - hole.depth
        return self.floor.height

    def outline(self, y: float = 0.0) -> tuple[Array, ...]:
        """What a cut along the x axis shows, for drawing: lines of x and z [m], (k, 2) each.

        Args:
            y: where it is cut [m]; the hole is always cut through its axis.
        """
        if self.floor is None:
            return ()
        terrain = self.build()
        if not terrain.has_hole:
            middle, half = self.patch.centre[0], self.patch.half_width
            x = np.linspace(middle - half, middle + half, 401)
            return (np.column_stack([x, floor_heights(terrain, x, np.array([y]))[0]]),)
        wall = wall_profile(terrain)
        right = wall * [1.0, 1.0] + [terrain.axis_x, 0.0]
        left = wall * [-1.0, 1.0] + [terrain.axis_x, 0.0]
        x = np.linspace(left[-1, 0], right[-1, 0], 401)
        floor = np.column_stack([x, floor_heights(terrain, x, np.array([y]))[0]])
        return (left, floor, right)

    def wheel_law(self, table: Any) -> WheelLaw:
        """Law of a wheel on this soil, from the table of its stresses."""
        values = {
            item.name: getattr(self.wheel, item.name) for item in dataclasses.fields(self.wheel)
        }
        return WheelLaw(table, **values)
