"""Attitudes of recorded bodies, and values of the recorded scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from msg_schemas.fields import FieldRule, read_or_none
from rover_bags.reading.read import Bag, Floats, TimeSeries

_VERTICAL = 1e-9
"""Horizontal part of a unit vector up to which it counts as vertical."""


def rotations(series: TimeSeries) -> Floats:
    """Return rotation matrices from body to world axes, shape (N, 3, 3)."""
    turned = Rotation.from_quat(series.vector("orientation", "xyzw"))
    return np.asarray(turned.as_matrix(), dtype=np.float64)


def headings(series: TimeSeries) -> Floats:
    """Return the unwrapped heading of a body's x axis about the vertical [rad], shape (N,)."""
    forward = rotations(series)[:, :, 0]
    return np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))


def forward_distance(series: TimeSeries, index: int, displacement: Floats) -> float:
    """Return the horizontal part [m] of a displacement along a body's heading in one sample.

    It is 0 if the body's x axis is vertical, so that there is no heading.
    """
    heading = rotations(series)[index, :2, 0]
    length = float(np.linalg.norm(heading))
    return float(heading @ displacement[:2]) / length if length > _VERTICAL else 0.0


def tilts(series: TimeSeries) -> Floats:
    """Return the angle of a body's z axis from the vertical [rad], shape (N,)."""
    up = rotations(series)[:, 2, 2]
    return np.arccos(np.clip(up, -1.0, 1.0))


def turned_about(series: TimeSeries, first: int, last: int) -> Floats:
    """Return the rotation vector [rad] between two samples, in the body axes of the first."""
    both = Rotation.from_quat(series.vector("orientation", "xyzw")[[first, last]])
    return np.asarray((both[0].inv() * both[1]).as_rotvec(), dtype=np.float64)


def inside(series: TimeSeries, begin: float, end: float, log: tuple[int, int]) -> NDArray[np.intp]:
    """Return indices of messages from `begin` to `end` [s], received near log times [ns]."""
    margin = 1_000_000_000
    near = (series.log_ns >= log[0] - margin) & (series.log_ns <= log[1] + margin)
    return np.flatnonzero(near & (series.time >= begin - 1e-9) & (series.time <= end + 1e-9))


def gravity_of(bag: Bag) -> float | None:
    """Return the configured gravity [m/s^2], or None if no configuration is recorded."""
    is_spatial = isinstance(bag.scenario.get("environment"), Mapping)
    return number_setting(bag, *(("environment",) if is_spatial else ()), "gravity")


def masses_of(bag: Bag) -> tuple[float, float] | None:
    """Return the masses of both bodies [kg], Body 2's 0 if there is none; None: not configured."""
    first, second = (number_setting(bag, "rover", name) for name in ("m1", "m2"))
    if first is None or second is None or first <= 0.0 or second < 0.0:
        return None
    return first, second


def number_setting(bag: Bag, *path: str) -> float | None:
    """Return a number of the scenario by its path, or None if it is no finite number."""
    number: float | None = read_or_none(FieldRule(kind=float), _setting(bag, *path))
    return number


def vector_setting(bag: Bag, length: int, *path: str) -> tuple[float, ...] | None:
    """Return a list of so many finite numbers of the scenario by its path, or None."""
    rule = FieldRule(kind=float, length=length)
    vector: tuple[float, ...] | None = read_or_none(rule, _setting(bag, *path))
    return vector


def _setting(bag: Bag, *path: str) -> Any:
    found: Any = bag.scenario
    for name in path:
        if not isinstance(found, Mapping) or name not in found:
            return None
        found = found[name]
    return found
