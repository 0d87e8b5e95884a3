"""Which interface a plant has."""

from __future__ import annotations

from typing import Any

from rover_sim.interface import PlantInterface
from rover_sim.planar_interface import PlanarInterface
from rover_sim.planar_plant import PlanarPlant
from rover_sim.plant import Plant


def build_interface(plant: Plant[Any], seed: int) -> PlantInterface[Any]:
    """The outside of a plant.

    Args:
        plant: from `build_plant`.
        seed: of the sensors' errors.
    """
    if isinstance(plant, PlanarPlant):
        return PlanarInterface(plant)
    raise TypeError(f"{type(plant).__name__} has no interface (seed {seed})")
