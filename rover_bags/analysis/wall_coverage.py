"""Which part of the wall a descent's pictures cover, over depth and heading.

Each picture covers a rectangle of the wall: the camera's field of view about where it looks, on the
wall at the distance that the range finder told. Depths are lengths at the drum, headings those of
the rover since the start, by its gyro.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.machine import CAMERA_RATE, DEPTH, HEADING, SMEAR, WALL_DISTANCE
from rover_bags.read import Floats, TimeSeries

NO_WALL: Final = 999.0  # a distance from which on the range finder sees none [m]
_TURN: Final = 2.0 * math.pi
_HEADING_STEP: Final = math.radians(0.5)
_DEPTH_STEPS: Final = 4000  # at most
_FINEST: Final = 0.01  # of the depth steps [m]
_SAME_STOP: Final = 0.25  # pictures nearer to each other in depth are of one stop [m]


class Observations(NamedTuple):
    """Pictures of the wall, one value each, shape (N,); NaN where it is not known."""

    time: Floats  # [s]
    depth: Floats  # [m]
    heading: Floats  # [rad]
    camera_rate: Floats  # [rad/s]
    smear: Floats  # [px]
    wall_distance: Floats  # [m]


@dataclass(frozen=True)
class View:
    """The camera as far as coverage depends on it.

    Attributes:
        width, height: Field of view [rad]; by default 1000 by 750 pixels of 0.5 mrad.
        sharp: A picture that smears by no more is sharp [px]; 0.14 deg/s over 0.1 s.
        wall_distance: Where none was told [m].
    """

    width: float = 0.5
    height: float = 0.375
    sharp: float = 0.5
    wall_distance: float = 3.0


@dataclass(frozen=True)
class Coverage:
    """Figures of the wall that was seen.

    Attributes:
        images: How many.
        sharp, smeared, unknown: Of which these smear little, too much, or nobody knows how much.
        stops: Groups of pictures at one depth.
        depth_first, depth_last: Least and largest depth of a picture [m]; NaN without any.
        headings: Width of the headings that sharp pictures cover, of 2 pi [rad].
        area: Of the wall that sharp pictures cover, each part once [m^2].
        share: That area over the whole wall around between the upper edge of the first picture
            and the lower edge of the last; NaN without any.
        smear_median, smear_worst: [px]; NaN without any.
        rate_worst: Largest estimated rate of the camera [rad/s]; NaN without any.
    """

    images: int
    sharp: int
    smeared: int
    unknown: int
    stops: int
    depth_first: float
    depth_last: float
    headings: float
    area: float
    share: float
    smear_median: float
    smear_worst: float
    rate_worst: float

    @property
    def summary(self) -> str:
        """One sentence."""
        if not self.images:
            return "no pictures of the wall"
        parts = [f"{self.sharp} sharp"]
        parts += [f"{self.smeared} smeared"] if self.smeared else []
        parts += [f"{self.unknown} of unknown smear"] if self.unknown else []
        return (
            f"{self.images} pictures at {self.stops} stops from {self.depth_first:.1f} to "
            f"{self.depth_last:.1f} m, {', '.join(parts)}: {self.area:.2f} m² of the wall, "
            f"{100.0 * self.share:.1f} % of it between their edges"
        )


def observations_of(series: TimeSeries) -> Observations:
    """The pictures that a bag's series of observations tells of."""
    nothing = np.full(len(series), np.nan)

    def column(joint: str, part: str = "position") -> Floats:
        return series.columns.get(f"{joint}.{part}", nothing)

    return Observations(
        series.time,
        column(DEPTH),
        column(HEADING),
        column(CAMERA_RATE, "velocity"),
        column(SMEAR),
        column(WALL_DISTANCE),
    )


def measure_coverage(seen: Observations, view: View | None = None) -> Coverage:
    """Figures of what was seen."""
    view = view or View()
    known = np.isfinite(seen.smear)
    sharp = known & (np.nan_to_num(seen.smear) <= view.sharp)
    count = len(seen.depth)
    depths = np.sort(seen.depth)
    stops = int(count > 0) + int(np.sum(np.diff(depths) > _SAME_STOP))
    area, whole, headings = _area(seen, sharp, view)
    smear = seen.smear[known]
    return Coverage(
        images=count,
        sharp=int(sharp.sum()),
        smeared=int((known & ~sharp).sum()),
        unknown=int((~known).sum()),
        stops=stops,
        depth_first=float(depths[0]) if count else math.nan,
        depth_last=float(depths[-1]) if count else math.nan,
        headings=headings,
        area=area,
        share=area / whole if whole > 0.0 else math.nan,
        smear_median=float(np.median(smear)) if len(smear) else math.nan,
        smear_worst=float(np.max(smear)) if len(smear) else math.nan,
        rate_worst=float(np.nanmax(seen.camera_rate)) if count else math.nan,
    )


def wall_distances(seen: Observations, view: View) -> Floats:
    """Distances of the wall [m], shape (N,): as told, or the view's where none was."""
    measured = np.isfinite(seen.wall_distance) & (seen.wall_distance < NO_WALL)
    return np.where(measured, seen.wall_distance, view.wall_distance)


def _area(seen: Observations, sharp: NDArray[np.bool_], view: View) -> tuple[float, float, float]:
    """Covered and whole area [m^2], and covered headings [rad], on a grid of cells."""
    if not len(seen.depth):
        return 0.0, 0.0, 0.0
    distance = wall_distances(seen, view)
    half = distance * math.tan(0.5 * view.height)
    top, bottom = float(np.min(seen.depth - half)), float(np.max(seen.depth + half))
    rows = min(max(math.ceil((bottom - top) / _FINEST), 1), _DEPTH_STEPS)
    columns = round(_TURN / _HEADING_STEP)
    step = (bottom - top) / rows
    levels = top + step * (np.arange(rows) + 0.5)
    bearings = _HEADING_STEP * (np.arange(columns) + 0.5)
    covered = np.zeros((rows, columns), dtype=np.bool_)
    for at in np.flatnonzero(sharp):
        away = np.abs(np.remainder(bearings - seen.heading[at] + math.pi, _TURN) - math.pi)
        inside = np.abs(levels - seen.depth[at]) <= half[at]
        covered |= inside[:, None] & (away <= 0.5 * view.width)[None, :]
    radius = float(np.median(distance))
    cell = step * _HEADING_STEP * radius
    whole = (bottom - top) * _TURN * radius
    return float(covered.sum()) * cell, whole, float(covered.any(axis=0).sum()) * _HEADING_STEP
