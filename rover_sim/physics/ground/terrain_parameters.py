"""Parameters of a terrain, with presets of known lunar pits.

The world's origin is the fairlead; z points up. `rover_sim.physics.ground.terrain` builds the
terrain.
"""

import math
from dataclasses import dataclass

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.ground.boulders import BoulderParameters


@dataclass(frozen=True)
class ReliefParameters(Configuration):
    """Random relief of the floor within the patch: octaves of smoothed random heights.

    The wavelengths go from 4 spacings up, each twice the previous.
    """

    rms: float = quantity("m", "root mean square height", 0.03, minimum=0.0)
    spacing: float = quantity("m", "distance of the nodes", 0.5, above=0.0)
    octaves: int = quantity("-", "number of octaves", 4, kind=int, minimum=1, maximum=8)
    roughness: float = quantity(
        "-", "ratio of the amplitudes of successive octaves", 0.5, above=0.0, maximum=1.0
    )


@dataclass(frozen=True)
class HoleParameters:
    """A vertical hole with an axis of symmetry.

    Raises:
        ConfigurationError: a value is not finite or out of its range.
    """

    diameter: float  # of the opening, below the rim's rounding [m], > 0
    depth: float  # from the surrounding ground to the floor [m], > 0
    # (depth below the ground, radius there minus the opening's radius) [m]; interpolated with zero
    # slope at each entry
    profile: tuple[tuple[float, float], ...] = ()
    wall_distance: float = 3.0  # of the fairlead's plumb line at the narrowest radius [m], > 0
    fairlead_height: float = 1.0  # of the fairlead above the ground [m], > 0
    rim_radius: float = 1.0  # rounding of the rim [m], > 0

    def __post_init__(self) -> None:
        for name in ("diameter", "depth", "wall_distance", "fairlead_height", "rim_radius"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigurationError(name, value, "should be finite and above 0 m")
        if not self.rim_radius < self.depth:
            raise ConfigurationError(
                "rim_radius", self.rim_radius, f"should be below the depth of {self.depth:g} m"
            )
        last = self.rim_radius
        for depth, widening in self.profile:
            if not (math.isfinite(depth) and depth > last):
                raise ConfigurationError(
                    "profile depth", depth, f"should be above {last:g} m: depths increase"
                )
            if not (math.isfinite(widening) and self.diameter / 2.0 + widening > 0.0):
                raise ConfigurationError("profile widening", widening, "leaves no hole")
            last = depth
        if self.wall_distance > self.narrowest:
            raise ConfigurationError(
                "wall_distance",
                self.wall_distance,
                f"should be at most the hole's smallest radius of {self.narrowest:g} m",
            )

    @property
    def narrowest(self) -> float:
        """Smallest radius [m]."""
        return self.diameter / 2.0 + min(0.0, *(widening for _, widening in self.profile), 0.0)


@dataclass(frozen=True)
class TerrainParameters:
    """A terrain: a floor, or with `hole` also the wall, the rim and the surrounding ground.

    With a hole the floor's height follows from the hole's depth, and `floor_height` is ignored.

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    floor_height: float = -5.0  # z of the floor below the fairlead [m]
    slope_x: float = 0.0  # dz/dx of the floor [-]
    slope_y: float = 0.0  # dz/dy [-]
    floor_is_rock: bool = False
    patch_centre: tuple[float, float] = (0.0, 0.0)  # of the square with relief and boulders [m]
    patch_half_width: float = 15.0  # [m], > 0
    relief: ReliefParameters | None = None
    boulders: BoulderParameters | None = None
    hole: HoleParameters | None = None

    def __post_init__(self) -> None:
        for name in ("floor_height", "slope_x", "slope_y"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)}: must be finite")
        if not all(math.isfinite(value) for value in self.patch_centre):
            raise ValueError(f"patch_centre = {self.patch_centre}: must be finite")
        if not (math.isfinite(self.patch_half_width) and self.patch_half_width > 0.0):
            raise ValueError(f"patch_half_width = {self.patch_half_width}: must be above 0")


# Haruyama et al. 2009 (Geophys. Res. Lett. 36, L21206), Robinson et al. 2012 (Planet. Space Sci.
# 69) and Wagner and Robinson 2014 (Icarus 237) give the widths and depths; of the walls Wagner and
# Robinson 2019 (GSA Annual Meeting, 340349) report a floor that extends 10 m under Tranquillitatis'
# east rim, with a recess of over 8 m from 40 m down, and 15 m under the rim of Ingenii. The pits
# are oval: the opening has the long width, the neck the short one. The wall's profile between them,
# Marius Hills' overhang and Ingenii's depth are our choice.
MARIUS_HILLS = HoleParameters(
    diameter=65.0, depth=50.0, profile=((12.0, -3.5), (24.0, -3.5), (36.0, 4.0))
)
MARE_TRANQUILLITATIS = HoleParameters(
    diameter=100.0, depth=105.0, profile=((20.0, -6.0), (40.0, -6.0), (52.0, 4.0), (75.0, 10.0))
)
MARE_INGENII = HoleParameters(
    diameter=130.0, depth=60.0, profile=((15.0, -3.0), (25.0, -3.0), (40.0, 12.0))
)
