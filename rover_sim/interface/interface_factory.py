"""Build the interface of a plant."""

from __future__ import annotations

from typing import Any

from rover_sim.interface.planar_interface import PlanarInterface
from rover_sim.interface.plant_interface import PlantInterface
from rover_sim.interface.spatial_interface import SpatialInterface
from rover_sim.plants.planar_plant import PlanarPlant
from rover_sim.plants.spatial_plant import SpatialPlant


def build_interface(plant: PlanarPlant | SpatialPlant, seed: int) -> PlantInterface[Any]:
    """Build the interface of a plant.

    Args:
        plant: from `build_plant`.
        seed: of the sensors' errors; unused by the planar plant.
    """
    if isinstance(plant, SpatialPlant):
        return SpatialInterface(plant, seed)
    return PlanarInterface(plant)
