"""Boulder field of a floor: random ones from a power law and a seed, and others at given places.

The random diameters follow the cumulative power law N(>= D) ~ D^-b, cut at a smallest and a largest
diameter. On the Moon b is 2.1 to 2.65 at the mare sites of Surveyors I, III, V and VI and 1.82 on
the blocky ejecta of Tycho at Surveyor VII, for fragments up to metres (Shoemaker and Morris 1970,
Radio Science 5(2); Cintala and McBride 1995, NASA TM-104804, extend the counts to larger blocks);
around young craters blocks of metres and above fall off faster, b = 3 to 5 (Bart and Melosh 2010,
Icarus 209). No count of decimetre blocks on a pit's floor exists; the default is a mare's b = 2.5,
and a density well above a mare's, for a floor that carries the debris of a collapse.

A boulder is a spherical cap of base diameter D and height `height_ratio` D, half a sphere at 1/2.
A seed gives the same field on every machine and under every version of numpy: the uniform numbers
are made from raw bits of PCG64, and diameters are rounded to a micrometre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, ConfigurationError, quantity

Array = NDArray[np.float64]

DIAMETER_QUANTUM = 1.0e-6  # [m]


@dataclass(frozen=True)
class BoulderPlace(Configuration):
    """A boulder at a given place of the patch, also within `clear_radius`."""

    x: float = quantity("m", "position of its centre")
    y: float = quantity("m", "position of its centre")
    diameter: float = quantity("m", "diameter of its base", above=0.0)


@dataclass(frozen=True)
class BoulderParameters(Configuration):
    """Boulders on the patch: random ones, with a power law of their diameters, and placed ones."""

    density: float = quantity(
        "1/m^2", "number of boulders per area", 0.5, minimum=0.0, maximum=20.0
    )
    smallest: float = quantity("m", "smallest diameter", 0.1, minimum=1e-3)
    largest: float = quantity("m", "largest diameter", 3.0, above=0.0, maximum=1e3)
    exponent: float = quantity("-", "b of N(>= D) ~ D^-b", 2.5, above=0.0, maximum=10.0)
    height_ratio: float = quantity("-", "height over diameter", 0.5, above=0.0, maximum=0.5)
    clear_radius: float = quantity(
        "m", "radius around the plumb line without random boulders", 0.0, minimum=0.0
    )
    placed: tuple[BoulderPlace, ...] = configuration.sections(
        BoulderPlace, "boulders at given places, besides the random ones", ()
    )

    def check(self) -> None:
        """Refuse a largest diameter below the smallest."""
        if self.largest < self.smallest:
            raise ConfigurationError(
                "largest", self.largest, f"should be at least smallest, {self.smallest:g} m"
            )


def uniform(bits: np.random.PCG64, count: int) -> Array:
    """Uniform numbers in [0, 1) from 53 raw bits each, (count,)."""
    raw = np.asarray(bits.random_raw(count), dtype=np.uint64)
    return np.asarray((raw >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def diameter_at(parameters: BoulderParameters, share: float) -> float:
    """Quantile of the diameters [m]: the given share of the boulders, in [0, 1), is smaller."""
    b = parameters.exponent
    few = (parameters.largest / parameters.smallest) ** -b
    diameter = parameters.smallest * (1.0 - share * (1.0 - few)) ** (-1.0 / b)
    return round(diameter / DIAMETER_QUANTUM) * DIAMETER_QUANTUM


def scatter(
    parameters: BoulderParameters, seed: int, centre: tuple[float, float], half_width: float
) -> Array:
    """Boulders on a square, (n, 3): x, y of the centre and diameter [m], the largest first.

    Args:
        parameters: the field.
        seed: a whole number, not negative.
        centre: x and y of the square's centre [m].
        half_width: half the square's side [m].
    """
    count = round(parameters.density * (2.0 * half_width) ** 2)
    numbers = uniform(np.random.PCG64(seed), 3 * count).reshape(count, 3)
    field = np.empty((count, 3))
    field[:, 0] = centre[0] + (2.0 * numbers[:, 0] - 1.0) * half_width
    field[:, 1] = centre[1] + (2.0 * numbers[:, 1] - 1.0) * half_width
    field[:, 2] = [diameter_at(parameters, share) for share in numbers[:, 2].tolist()]
    away = np.sqrt(field[:, 0] ** 2 + field[:, 1] ** 2) - 0.5 * field[:, 2]
    field = field[away >= parameters.clear_radius]
    placed = [(each.x, each.y, each.diameter) for each in parameters.placed]
    field = np.concatenate([field, np.array(placed).reshape(-1, 3)])
    return field[np.argsort(-field[:, 2], kind="stable")]


def cap_radius(diameter: Array, height_ratio: float) -> Array:
    """Radius [m] of the sphere whose cap has the base diameter D and the height ratio * D."""
    height = height_ratio * diameter
    return np.asarray((0.25 * diameter**2 + height**2) / (2.0 * height))
