"""Area of the wall covered by a descent's images, over depth and heading.

The footprint of an image is a rectangle: the camera's field of view projected onto the wall at the
range finder's distance. Depth is the tether length at the drum, heading the rover's integrated gyro
heading since the start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine
from rover_bags.reading.read import Floats, TimeSeries

VIEW_WIDTH: Final = 0.5
"""Width of the camera's field of view [rad]: 1000 pixels of 0.5 mrad."""
VIEW_HEIGHT: Final = 0.375
"""Height of the field of view [rad]: 750 pixels."""
ASSUMED_DISTANCE: Final = 3.0
"""Distance of the wall if none was measured [m]."""
_TURN: Final = 2.0 * math.pi
_HEADING_STEP: Final = math.radians(0.5)
_DEPTH_STEPS: Final = 4000  # maximum number
_FINEST: Final = 0.01  # smallest depth step [m]
_SAME_STOP: Final = 0.25  # images within this depth belong to one stop [m]


class Observations(NamedTuple):
    """Observations of the wall, shape (N,) each; NaN if unknown."""

    time: Floats  # [s]
    depth: Floats  # [m]
    heading: Floats  # [rad]
    camera_rate: Floats  # [rad/s]
    smear: Floats  # [px]
    wall_distance: Floats  # [m]


@dataclass(frozen=True)
class Coverage:
    """Coverage of the wall by images; NaN for values without any image.

    Attributes:
        images: Number of images.
        sharp, smeared, unknown: Number of sharp images, smeared images, and images of unknown
            smear.
        stops: Number of groups of images at one depth.
        depth_first, depth_last: Smallest and largest depth of an image [m].
        headings: Angle of headings covered by sharp images, at most 2 pi [rad].
        area: Wall area covered by sharp images [m^2].
        share: That area over the area of the full circumference between the upper edge of the first
            image and the lower edge of the last.
        smear_median, smear_worst: Median and largest smear [px].
        rate_worst: Largest estimated angular rate of the camera [rad/s].
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
        """Return the coverage in one sentence."""
        if not self.images:
            return "no images of the wall"
        parts = [f"{self.sharp} sharp"]
        parts += [f"{self.smeared} smeared"] if self.smeared else []
        parts += [f"{self.unknown} of unknown smear"] if self.unknown else []
        return (
            f"{self.images} images at {self.stops} stops from {self.depth_first:.1f} to "
            f"{self.depth_last:.1f} m, {', '.join(parts)}: {self.area:.2f} m² of the wall, "
            f"{100.0 * self.share:.1f} % of the circumference between their edges"
        )


def observations_of(series: TimeSeries) -> Observations:
    """Return the observations in a bag's series of logged images."""
    nothing = np.full(len(series), np.nan)

    def column(joint: str, part: str = "position") -> Floats:
        return series.columns.get(f"{joint}.{part}", nothing)

    return Observations(
        series.time,
        column(machine.DEPTH),
        column(machine.HEADING),
        column(machine.CAMERA_RATE, "velocity"),
        column(machine.SMEAR),
        column(machine.WALL_DISTANCE),
    )


def measure_coverage(seen: Observations) -> Coverage:
    """Compute the coverage of observations."""
    known = np.isfinite(seen.smear)
    sharp = known & (np.nan_to_num(seen.smear) <= machine.SHARP_SMEAR)
    count = len(seen.depth)
    depths = np.sort(seen.depth)
    stops = int(count > 0) + int(np.sum(np.diff(depths) > _SAME_STOP))
    area, whole, headings = _area(seen, sharp)
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


def wall_distances(seen: Observations) -> Floats:
    """Return distances of the wall [m], shape (N,): measured, or else assumed."""
    measured = np.isfinite(seen.wall_distance) & (seen.wall_distance < machine.NO_WALL)
    return np.where(measured, seen.wall_distance, ASSUMED_DISTANCE)


def _area(seen: Observations, sharp: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Covered and whole area [m^2], and covered headings [rad], on a grid of cells."""
    if not len(seen.depth):
        return 0.0, 0.0, 0.0
    distance = wall_distances(seen)
    half = distance * math.tan(0.5 * VIEW_HEIGHT)
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
        covered |= inside[:, None] & (away <= 0.5 * VIEW_WIDTH)[None, :]
    radius = float(np.median(distance))
    cell = step * _HEADING_STEP * radius
    whole = (bottom - top) * _TURN * radius
    return float(covered.sum()) * cell, whole, float(covered.any(axis=0).sum()) * _HEADING_STEP
