# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Environment of a spatial scenario: gravity, floor, boulders, hole, and the ground's materials.

Axes: map, z up, the fairlead at the origin.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, ConfigurationError, choice, quantity
from rover_sim.physics.ground import contact, terrain_parameters
from rover_sim.physics.ground.boulders import BoulderParameters
from rover_sim.physics.ground.contact import ContactParameters
from rover_sim.physics.ground.terrain import (
    BouldersError,
    Terrain,
    boulder_reach,
    build_terrain,
    floor_heights,
    wall_profile,
)
from rover_sim.physics.ground.terrain_parameters import ReliefParameters
from rover_sim.physics.ground.wheel_contact import WheelLaw
from rover_sim.physics.ground.wheel_soil import Soil
from rover_sim.physics.numerics.named_parameters import from_parameters
from rover_sim.physics.tether.air_drag import NO_AIR, AirDrag
from rover_sim.physics.tether.ancf import Array

Material: TypeAlias = Literal["regolith", "rock"]

_TERRAIN = terrain_parameters.TerrainParameters()
_WHEEL_LAW: dict[str, float] = WheelLaw._field_defaults
_PRESETS = {
    "marius_hills": terrain_parameters.MARIUS_HILLS,
    "tranquillitatis": terrain_parameters.MARE_TRANQUILLITATIS,
    "ingenii": terrain_parameters.MARE_INGENII,
}
# Largest numbers of the relief's nodes along a side of the patch, and of its boulders.
MOST_RELIEF_NODES = 2000
MOST_BOULDERS = 100_000
_FAR_BELOW = 1.0e6  # depth of the floor without ground [m]; out of reach of any tether


@dataclass(frozen=True)
class Floor(Configuration):
    """A plane below the fairlead; in a hole, the hole's depth sets its height."""

    height: float = quantity(
        "m", "z of the floor below the fairlead", _TERRAIN.floor_height, maximum=0.0
    )
    slope: float = quantity("deg", "inclination", 0.0, minimum=0.0, maximum=60.0)
    downhill: float = quantity(
        "deg", "direction of descent, from x towards y", 0.0, minimum=-360.0, maximum=360.0
    )
    material: Material = choice(get_args(Material), "material of the floor", "regolith")

    @property
    def gradient(self) -> tuple[float, float]:
        """dz/dx and dz/dy [-]."""
        fall, heading = math.tan(math.radians(self.slope)), math.radians(self.downhill)
        return -fall * math.cos(heading), -fall * math.sin(heading)


@dataclass(frozen=True)
class Patch(Configuration):
    """The square of relief and boulders."""

    centre: tuple[float, float] = quantity("m", "x and y", _TERRAIN.patch_centre, length=2)
    half_width: float = quantity(
        "m", "half its side", _TERRAIN.patch_half_width, above=0.0, maximum=200.0
    )


@dataclass(frozen=True)
class Hole(Configuration):
    """A vertical hole: a preset of the Moon, or one by its dimensions.

    A hole by dimensions has a straight wall that widens by `overhang` below `overhang_depth`.
    """

    preset: str | None = choice(tuple(_PRESETS), "a hole of the Moon", None, optional=True)
    diameter: float | None = quantity("m", "of the opening", None, above=0.0, optional=True)
    depth: float | None = quantity(
        "m", "from ground to floor", None, above=0.0, maximum=1e3, optional=True
    )
    overhang: float | None = quantity(
        "m", "radius of the floor minus that of the opening", None, optional=True
    )
    overhang_depth: float | None = quantity(
        "m", "depth at which the wall begins to widen", None, above=0.0, optional=True
    )
    wall_distance: float = quantity("m", "from fairlead to wall, at the narrowest", 3.0, above=0.0)
    fairlead_height: float = quantity("m", "above the surrounding ground", 1.0, above=0.0)
    rim_radius: float = quantity("m", "rounding of the rim", 1.0, above=0.0)

    def check(self) -> None:
        """Require either a preset or dimensions."""
        dimensions = ("diameter", "depth")
        for name in (*dimensions, "overhang", "overhang_depth"):
            value = getattr(self, name)
            if self.preset is not None and value is not None:
                raise ConfigurationError(name, value, f"should be null, as preset is {self.preset}")
        for name in dimensions:
            if self.preset is None and getattr(self, name) is None:
                raise ConfigurationError(
                    name, None, f"needed, unless preset is one of {', '.join(_PRESETS)}"
                )
        if (self.overhang is None) != (self.overhang_depth is None):
            raise ConfigurationError(
                "overhang_depth", self.overhang_depth, "should be given together with overhang"
            )
        self.parameters()

    def parameters(self) -> terrain_parameters.HoleParameters:
        """Return the parameters of the terrain."""
        siting: dict[str, Any] = {
            "wall_distance": self.wall_distance,
            "fairlead_height": self.fairlead_height,
            "rim_radius": self.rim_radius,
        }
        if self.preset is not None:
            return dataclasses.replace(_PRESETS[self.preset], **siting)
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
            diameter=self.diameter, depth=self.depth, profile=profile, **siting
        )


@dataclass(frozen=True)
class WheelOnSoilSettings(Configuration):
    """Sinkage damping, lateral slip and parking of a wheel on regolith."""

    damping: float = quantity("s/m", "damping of the sinkage", _WHEEL_LAW["damping"], minimum=0.0)
    parking_speed: float = quantity(
        "m/s", "speed below which the parking anchor holds", _WHEEL_LAW["parking_speed"], above=0.0
    )
    slip_speed: float = quantity(
        "m/s", "of the friction's regularisation", _WHEEL_LAW["slip_speed"], above=0.0
    )
    anchor_stiffness: float = quantity(
        "N/m", "of the parking anchor", _WHEEL_LAW["anchor_stiffness"], minimum=0.0
    )


@dataclass(frozen=True)
class Air(Configuration):
    """Air about the tether: quadratic drag by the cross-flow principle.

    It acts on the tether beyond the element at the winch, which varies in length and moves little,
    and not on the rover.
    """

    diameter: float = quantity("m", "d of the tether", above=0.0, maximum=1.0)
    density: float = quantity("kg/m^3", "rho", 1.2, above=0.0, maximum=100.0)
    normal_coefficient: float = quantity("-", "C_n across the tether", 1.1, above=0.0, maximum=10.0)
    axial_coefficient: float = quantity(
        "-", "C_t along the tether", 0.02, minimum=0.0, maximum=10.0
    )
    wind: tuple[float, float, float] = quantity(
        "m/s", "velocity of the air", (0.0, 0.0, 0.0), length=3
    )

    def drag(self) -> AirDrag:
        """Coefficients per length of tether."""
        across = 0.5 * self.density * self.diameter
        return AirDrag(
            across * self.normal_coefficient, math.pi * across * self.axial_coefficient, self.wind
        )


@dataclass(frozen=True)
class Environment(Configuration):
    """Gravity, air and ground."""

    gravity: float = quantity("m/s^2", "g, along -z", minimum=0.0, maximum=1e3)
    seed: int = quantity("-", "of relief and boulders", 0, kind=int, minimum=0, maximum=2**31 - 1)
    floor: Floor | None = configuration.section(
        Floor, "the floor; null: no ground", Floor(), optional=True
    )
    patch: Patch = configuration.section(Patch, "the square of relief and boulders", Patch())
    relief: ReliefParameters | None = configuration.section(
        ReliefParameters, "random relief", None, optional=True
    )
    boulders: BoulderParameters | None = configuration.section(
        BoulderParameters, "boulders", None, optional=True
    )
    hole: Hole | None = configuration.section(Hole, "the surrounding hole", None, optional=True)
    rock: ContactParameters = configuration.section(
        ContactParameters, "contact with boulders, walls and bare rock", contact.ROCK
    )
    regolith: ContactParameters = configuration.section(
        ContactParameters, "contact of the rover's corners with regolith", contact.REGOLITH
    )
    soil: Soil = configuration.section(Soil, "regolith under a wheel", Soil())
    wheel: WheelOnSoilSettings = configuration.section(
        WheelOnSoilSettings, "wheels on regolith", WheelOnSoilSettings()
    )
    air: Air | None = configuration.section(
        Air, "air about the tether; null: none", None, optional=True
    )

    def check(self) -> None:
        """Refuse sections that have no effect together, and more ground than fits the memory."""
        self._check_extent()
        if self.floor is None:
            for name in ("relief", "boulders", "hole"):
                if getattr(self, name) is not None:
                    raise ConfigurationError(name, "given", "should be null without a floor")
        if self.hole is not None and self.floor is not None and self.floor.slope != 0.0:
            raise ConfigurationError("floor.slope", self.floor.slope, "should be 0 in a hole")
        if self.boulders is None:
            return
        xs = [each.x for each in self.boulders.placed]
        for index, each in enumerate(self.boulders.placed):
            if each.x in xs[:index]:
                # A wheel's contact with a boulder is followed by its x.
                right = "should differ from the x of the other placed boulders"
                raise ConfigurationError(f"boulders.placed[{index}].x", each.x, right)
            room = self.patch.half_width - float(boulder_reach(each.diameter))
            for name, middle in zip("xy", self.patch.centre, strict=True):
                if abs(getattr(each, name) - middle) >= room:
                    raise ConfigurationError(
                        f"boulders.placed[{index}].{name}",
                        getattr(each, name),
                        f"should be within {room:g} m of {middle:g} m, inside the patch",
                    )

    def _check_extent(self) -> None:
        width = 2.0 * self.patch.half_width
        if self.relief is not None and width / self.relief.spacing > MOST_RELIEF_NODES:
            raise ConfigurationError(
                "relief.spacing",
                self.relief.spacing,
                f"should be at least {width / MOST_RELIEF_NODES:g} m on a patch of {width:g} m,"
                f" which has at most {MOST_RELIEF_NODES} nodes along a side",
            )
        if self.boulders is not None and self.boulders.density * width**2 > MOST_BOULDERS:
            raise ConfigurationError(
                "boulders.density",
                self.boulders.density,
                f"should be at most {MOST_BOULDERS / width**2:.4g} 1/m^2 on a patch of {width:g} m,"
                f" which has at most {MOST_BOULDERS} boulders",
            )

    @property
    def parameters(self) -> terrain_parameters.TerrainParameters:
        """Parameters of the terrain; without a floor, a terrain out of reach."""
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
            relief=self.relief,
            boulders=self.boulders,
            hole=None if self.hole is None else self.hole.parameters(),
        )

    def drag(self) -> AirDrag:
        """Drag on the tether; zero without air."""
        return NO_AIR if self.air is None else self.air.drag()

    def build(self) -> Terrain:
        """Build the terrain.

        Raises:
            ConfigurationError: its boulders need too much memory.
        """
        try:
            return build_terrain(self.parameters, self.seed)
        except BouldersError as error:
            raise ConfigurationError(
                "environment.boulders.largest", self.boulders and self.boulders.largest, str(error)
            ) from None

    @property
    def floor_height(self) -> float:
        """Height z of the floor's plane below the fairlead [m]; -inf without a floor."""
        if self.floor is None:
            return -math.inf
        if self.hole is not None:
            hole = self.hole.parameters()
            return -hole.fairlead_height - hole.depth
        return self.floor.height

    def outline(self, y: float = 0.0) -> tuple[Array, ...]:
        """Return a section of the ground along x, for drawing: lines of x and z [m], (k, 2) each.

        Args:
            y: of the section [m]; the hole is always cut through its axis.
        """
        if self.floor is None:
            return ()
        terrain = self.build()
        if not terrain.has_hole:
            middle, half = self.patch.centre[0], self.patch.half_width
            x = np.linspace(middle - half, middle + half, 401)
            return (np.column_stack([x, floor_heights(terrain, x, y)]),)
        wall = wall_profile(terrain)
        right = wall * [1.0, 1.0] + [terrain.axis_x, 0.0]
        left = wall * [-1.0, 1.0] + [terrain.axis_x, 0.0]
        x = np.linspace(left[-1, 0], right[-1, 0], 401)
        floor = np.column_stack([x, floor_heights(terrain, x, y)])
        return (left, floor, right)

    def wheel_law(self, table: Any) -> WheelLaw:
        """Return the contact law of a wheel on this soil from the table of its stresses."""
        return from_parameters(WheelLaw, self.wheel, table=table)
