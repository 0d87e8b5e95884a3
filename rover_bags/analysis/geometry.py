"""Where bodies are and how they turn, from what a bag recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rover_bags.read import Bag, Floats, TimeSeries


def rotations(track: TimeSeries) -> Floats:
    """Rotation matrices of a body, body to world, shape (N, 3, 3)."""
    turned = Rotation.from_quat(track.vector("orientation", "xyzw"))
    return np.asarray(turned.as_matrix(), dtype=np.float64)


def headings(track: TimeSeries) -> Floats:
    """Heading of a body's x axis about the vertical [rad], unwrapped, shape (N,)."""
    forward = rotations(track)[:, :, 0]
    return np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))


def tilts(track: TimeSeries) -> Floats:
    """Angle of a body's z axis from the vertical [rad], shape (N,)."""
    up = rotations(track)[:, 2, 2]
    return np.arccos(np.clip(up, -1.0, 1.0))


def turned_about(track: TimeSeries, first: int, last: int) -> Floats:
    """How a body has turned from one sample to another: rotation vector [rad] in its first axes."""
    both = Rotation.from_quat(track.vector("orientation", "xyzw")[[first, last]])
    return np.asarray((both[0].inv() * both[1]).as_rotvec(), dtype=np.float64)


def inside(track: TimeSeries, begin: float, end: float, log: tuple[int, int]) -> NDArray[np.intp]:
    """Messages of a stretch of simulated time [s] that arrived within, or nearly, of log times."""
    margin = 1_000_000_000
    near = (track.log_ns >= log[0] - margin) & (track.log_ns <= log[1] + margin)
    return np.flatnonzero(near & (track.time >= begin - 1e-9) & (track.time <= end + 1e-9))


def gravity_of(bag: Bag) -> float | None:
    """Of the simulated environment [m/s^2], None where no configuration tells."""
    environment = bag.scenario.get("environment")
    value = (
        environment.get("gravity")
        if isinstance(environment, Mapping)
        else bag.scenario.get("gravity")
    )
    return float(value) if isinstance(value, float | int) else None


def setting(bag: Bag, *path: str) -> Any:
    """A value of the scenario by its path, None where it is not configured."""
    found: Any = bag.scenario
    for name in path:
        if not isinstance(found, Mapping) or name not in found:
            return None
        found = found[name]
    return found
