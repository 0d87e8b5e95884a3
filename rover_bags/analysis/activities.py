"""Metrics of descents, drives and imaging stops, each over its interval of the timeline."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from rover_bags.analysis.geometry import headings, inside, number_setting
from rover_bags.analysis.timeline import Activity, ActivityInterval, Timeline
from rover_bags.reading.read import Bag, Floats, TimeSeries

_STEADY: Final = 0.05
"""Tolerance of steady payout, as a fraction of the median rate."""
_AT_ENDS: Final = 1.0
"""Time at each end of a motion that does not count as steady payout [s]."""
_MIN_IMAGES: Final = 3


@dataclass(frozen=True)
class DrumMotion:
    """One descent or ascent: a motion of the drum while the tether carries the rover.

    Attributes:
        begin_s, end_s: Simulated time.
        downward: Whether tether was paid out.
        from_m, to_m: Tether length at the drum.
        depth_from_m, depth_to_m: Depth of Body 1 below the fairlead; None without ground truth.
        rate_m_s: Mean magnitude of the drum's rate.
        rate_max_m_s: Largest magnitude of the drum's rate.
        tracking_error_m: Largest deviation of the drum's length from the winch's reference; None
            if no reference is recorded.
        tension_mean_N: Mean tension at the fairlead during steady payout.
        ripple: RMS of the detrended tension over its mean, during steady payout.
        peak_tension_N: Largest tension at the fairlead.
        swing_max_rad, swing_rms_rad: Angle from the vertical of the line from the fairlead to
            Body 1.
    """

    begin_s: float
    end_s: float
    downward: bool
    from_m: float
    to_m: float
    depth_from_m: float | None
    depth_to_m: float | None
    rate_m_s: float
    rate_max_m_s: float
    tracking_error_m: float | None
    tension_mean_N: float | None
    ripple: float | None
    peak_tension_N: float | None
    swing_max_rad: float | None
    swing_rms_rad: float | None


@dataclass(frozen=True)
class DrivenInterval:
    """One interval of driven wheels.

    Attributes:
        begin_s, end_s: Simulated time.
        turning: Whether the rover turned on the spot instead of driving straight.
        path_m: Path length of Body 1 over ground. This and the next two are None without ground
            truth.
        distance_m: Straight-line distance from start to end.
        heading_rad: Change of heading, left positive.
        rolled_m: Mean distance rolled by the two wheels; None without their radius.
        slip: 1 - path / rolled distance, for straight drives.
        odometry_error_m: Position error at the end of dead reckoning from encoders and gyro.
    """

    begin_s: float
    end_s: float
    turning: bool
    path_m: float | None
    distance_m: float | None
    heading_rad: float | None
    rolled_m: float | None
    slip: float | None
    odometry_error_m: float | None


@dataclass(frozen=True)
class Traverse:
    """All consecutive drives between two times off the floor.

    Attributes:
        begin_s, end_s: From the start of the first drive to the end of the last.
        drives: Number of drives.
        path_m: Path length over ground.
        closing_distance_m: Distance between start and end; the closing error of a round trip.
    """

    begin_s: float
    end_s: float
    drives: int
    path_m: float
    closing_distance_m: float


@dataclass(frozen=True)
class ImagingStop:
    """Images of the wall taken while the rover hangs at one depth.

    Attributes:
        begin_s, end_s: Simulated time.
        depth_m: Mean depth of Body 1, or mean tether length at the drum without ground truth.
        wall_m: Median distance to the wall.
        images: Number of images.
        sharp: Fraction with a smear of at most 1 px.
        smear_median_px, smear_max_px: Motion smear of the images.
    """

    begin_s: float
    end_s: float
    depth_m: float | None
    wall_m: float
    images: int
    sharp: float
    smear_median_px: float
    smear_max_px: float


def _part(series: TimeSeries, interval: ActivityInterval) -> NDArray[np.intp]:
    return inside(series, interval.begin_s, interval.end_s, (interval.log_begin, interval.log_end))


# --- descents -----------------------------------------------------------------------------------


def descents_of(bag: Bag, timeline: Timeline) -> tuple[DrumMotion, ...]:
    """Return the metrics of every descent and ascent."""
    found = []
    for interval in timeline.of(Activity.DESCENDING, Activity.ASCENDING):
        descent = _descent(bag, interval)
        if descent is not None:
            found.append(descent)
    return tuple(found)


def _descent(bag: Bag, interval: ActivityInterval) -> DrumMotion | None:
    drum = bag.series(topics.WINCH_STATE)
    if drum is None:
        return None
    part = _part(drum, interval)
    if len(part) < 3:
        return None
    length = drum.columns[f"{machine.WINCH_DRUM}.position"][part]
    rate = np.abs(drum.columns[f"{machine.WINCH_DRUM}.velocity"][part])
    tension, mean, ripple = _tension(bag, interval, drum.time[part], rate)
    depth, swing = _depth_and_swing(bag, interval)
    return DrumMotion(
        begin_s=interval.begin_s,
        end_s=interval.end_s,
        downward=interval.activity is Activity.DESCENDING,
        from_m=float(length[0]),
        to_m=float(length[-1]),
        depth_from_m=None if depth is None else float(depth[0]),
        depth_to_m=None if depth is None else float(depth[-1]),
        rate_m_s=float(abs(length[-1] - length[0])) / max(interval.duration_s, 1e-9),
        rate_max_m_s=float(rate.max()),
        tracking_error_m=_tracking_error(bag, drum.time[part], length, interval),
        tension_mean_N=mean,
        ripple=ripple,
        peak_tension_N=tension,
        swing_max_rad=None if swing is None else float(swing.max()),
        swing_rms_rad=None if swing is None else float(np.sqrt(np.mean(swing**2))),
    )


def _tension(
    bag: Bag, interval: ActivityInterval, time: Floats, rate: Floats
) -> tuple[float | None, float | None, float | None]:
    """Peak tension, and mean and relative ripple during steady payout."""
    cell = bag.series(topics.LOAD_CELL)
    if cell is None:
        return None, None, None
    part = _part(cell, interval)
    if not len(part):
        return None, None, None
    force = np.linalg.norm(cell.vector("force")[part], axis=1)
    peak = float(cell.largest("force")[part].max())
    typical = float(np.median(rate))
    speed = np.interp(cell.time[part], time, rate)
    inner = (cell.time[part] > interval.begin_s + _AT_ENDS) & (
        cell.time[part] < interval.end_s - _AT_ENDS
    )
    steady = inner & (np.abs(speed - typical) <= _STEADY * typical)
    if steady.sum() < 20:
        return peak, None, None
    trend = np.polynomial.Polynomial.fit(cell.time[part][steady], force[steady], 1)
    residual = force[steady] - trend(cell.time[part][steady])
    mean = float(force[steady].mean())
    ripple = float(np.sqrt(np.mean(residual**2)) / mean) if mean > 0.0 else None
    return peak, mean, ripple


def _tracking_error(
    bag: Bag, time: Floats, length: Floats, interval: ActivityInterval
) -> float | None:
    estimate = bag.series(topics.WINCH_ESTIMATE)
    if estimate is None:
        return None
    part = _part(estimate, interval)
    if len(part) < 2:
        return None
    reference = np.interp(
        time, estimate.time[part], estimate.columns[f"{machine.REFERENCE}.position"][part]
    )
    known = (time >= estimate.time[part][0]) & (time <= estimate.time[part][-1])
    return float(np.abs(length - reference)[known].max()) if known.any() else None


def _depth_and_swing(bag: Bag, interval: ActivityInterval) -> tuple[Floats | None, Floats | None]:
    body = bag.series(topics.TRUTH_BODY1)
    if body is None:
        return None, None
    place = body.vector("position")[_part(body, interval)]
    if len(place) < 2:
        return None, None
    depth = -place[:, 2]
    return depth, swing_angles(place)


def swing_angles(place: Floats) -> Floats:
    """Angle from the vertical [rad], shape (N,), of the lines from the fairlead to positions [m].

    Args:
        place: Positions in the world, origin at the fairlead, shape (N, 3).
    """
    return np.asarray(np.arctan2(np.hypot(place[:, 0], place[:, 1]), -place[:, 2]))


def hanging_swing(bag: Bag, timeline: Timeline) -> tuple[Floats, Floats] | None:
    """Return times [s] and swing angles [rad] of Body 1, or None if it never hangs.

    Angles are NaN while the rover stands: then the line to the fairlead shows where it has driven.
    """
    body = bag.series(topics.TRUTH_BODY1)
    hangs = timeline.of(Activity.HANGING, Activity.DESCENDING, Activity.ASCENDING)
    if body is None or not hangs:
        return None
    angles = swing_angles(body.vector("position"))
    found = np.full(len(body), np.nan)
    for interval in hangs:
        part = _part(body, interval)
        found[part] = angles[part]
    return body.time, found


# --- drives -------------------------------------------------------------------------------------


def drives_of(bag: Bag, timeline: Timeline) -> tuple[DrivenInterval, ...]:
    """Return the metrics of every interval of driven wheels."""
    return tuple(_drive(bag, p) for p in timeline.of(Activity.DRIVING, Activity.TURNING))


def _drive(bag: Bag, interval: ActivityInterval) -> DrivenInterval:
    turning = interval.activity is Activity.TURNING
    path = distance = heading = slip = error = None
    positions: Floats | None = None
    body = bag.series(topics.TRUTH_BODY1)
    if body is not None and len(part := _part(body, interval)) > 1:
        positions = body.vector("position")[part]
        path = path_length(body.time[part], positions)
        distance = float(np.linalg.norm(positions[-1, :2] - positions[0, :2]))
        turned = headings(body)[part]
        heading = float(turned[-1] - turned[0])
        error = _odometry_error(bag, interval, positions, float(turned[0]))
    rolled = _rolled(bag, interval)
    if path is not None and rolled is not None and rolled > 0.05 and not turning:
        slip = 1.0 - path / rolled
    return DrivenInterval(
        interval.begin_s, interval.end_s, turning, path, distance, heading, rolled, slip, error
    )


def path_length(time: Floats, positions: Floats) -> float:
    """Return the length of a path in space [m].

    The path is resampled every 0.1 s so that vibration does not lengthen it.

    Args:
        time: Time of each position [s], shape (N,).
        positions: Positions [m], shape (N, 3).
    """
    count = max(2, round((time[-1] - time[0]) / 0.1) + 1)
    at = np.linspace(time[0], time[-1], count)
    points = np.stack([np.interp(at, time, positions[:, axis]) for axis in range(3)], axis=1)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _wheels(bag: Bag, interval: ActivityInterval) -> tuple[Floats, Floats, Floats] | None:
    """Times [s] and distances that the left and the right wheel have rolled since the start [m]."""
    series, radius = (
        bag.series(topics.WHEEL_STATE),
        number_setting(bag, "rover", "wheels", "radius"),
    )
    if series is None or radius is None:
        return None
    part = _part(series, interval)
    if len(part) < 2:
        return None
    sides = [
        series.columns[f"{name}.position"][part]
        for name in (machine.WHEEL_LEFT, machine.WHEEL_RIGHT)
    ]
    left, right = (radius * (side - side[0]) for side in sides)
    return series.time[part], left, right


def _rolled(bag: Bag, interval: ActivityInterval) -> float | None:
    wheels = _wheels(bag, interval)
    if wheels is None:
        return None
    _, left, right = wheels
    return 0.5 * (abs(float(left[-1])) + abs(float(right[-1])))


def _odometry_error(
    bag: Bag, interval: ActivityInterval, positions: Floats, heading: float
) -> float | None:
    """Position error [m] at the end of dead reckoning from encoders and gyro."""
    wheels, imu = _wheels(bag, interval), bag.series(topics.IMU)
    if wheels is None or imu is None or len(part := _part(imu, interval)) < 2:
        return None
    time, left, right = wheels
    rate = np.interp(time, imu.time[part], imu.columns["angular_velocity.z"][part])
    course = heading + np.concatenate(
        [[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))]
    )
    # Approximation: the centre of the axle coincides with the body's centre.
    step = np.diff(0.5 * (left + right))
    middle = 0.5 * (course[1:] + course[:-1])
    odometry = np.array([np.sum(step * np.cos(middle)), np.sum(step * np.sin(middle))])
    return float(np.linalg.norm(odometry - (positions[-1, :2] - positions[0, :2])))


def traverses_of(bag: Bag, timeline: Timeline) -> tuple[Traverse, ...]:
    """Group drives that are separated only by standing, slack and jumps."""
    body = bag.series(topics.TRUTH_BODY1)
    if body is None:
        return ()
    groups: list[list[ActivityInterval]] = [[]]
    for interval in timeline.intervals:
        if interval.log_begin in timeline.run_starts:
            groups.append([])
        if interval.activity in {Activity.DRIVING, Activity.TURNING}:
            groups[-1].append(interval)
        elif interval.activity in {Activity.HANGING, Activity.DESCENDING, Activity.ASCENDING}:
            groups.append([])
    return tuple(_traverses(body, [group for group in groups if group]))


def _traverses(body: TimeSeries, groups: list[list[ActivityInterval]]) -> Iterator[Traverse]:
    for group in groups:
        parts = [part for interval in group if len(part := _part(body, interval)) > 1]
        if not parts:
            continue
        place = body.vector("position")
        lengths = [path_length(body.time[part], place[part]) for part in parts]
        closing = place[parts[-1][-1], :2] - place[parts[0][0], :2]
        yield Traverse(
            group[0].begin_s, group[-1].end_s, len(group), sum(lengths),
            float(np.linalg.norm(closing)),
        )  # fmt: skip


# --- imaging stops ------------------------------------------------------------------------------


def imaging_stops_of(bag: Bag, timeline: Timeline) -> tuple[ImagingStop, ...]:
    """Return the image metrics of each interval in which the hanging rover saw the wall."""
    camera = bag.series(topics.CAMERA)
    if camera is None:
        return ()
    found = []
    for interval in timeline.of(Activity.HANGING):
        part = _part(camera, interval)
        wall = camera.columns[f"{machine.WALL_DISTANCE}.position"][part]
        sees = wall < machine.NO_WALL
        if sees.sum() < _MIN_IMAGES:
            continue
        smear = camera.columns[f"{machine.SMEAR}.position"][part][sees]
        found.append(
            ImagingStop(
                begin_s=float(camera.time[part][sees][0]),
                end_s=float(camera.time[part][sees][-1]),
                depth_m=_depth(bag, interval),
                wall_m=float(np.median(wall[sees])),
                images=int(sees.sum()) * camera.stride,
                sharp=float(np.mean(smear <= machine.SHARP_SMEAR)),
                smear_median_px=float(np.median(smear)),
                smear_max_px=float(smear.max()),
            )
        )
    return tuple(found)


def _depth(bag: Bag, interval: ActivityInterval) -> float | None:
    body, drum = bag.series(topics.TRUTH_BODY1), bag.series(topics.WINCH_STATE)
    for series, path, sign in (
        (body, "position.z", -1.0),
        (drum, f"{machine.WINCH_DRUM}.position", 1.0),
    ):
        if series is not None and len(part := _part(series, interval)):
            value = sign * float(np.mean(series.columns[path][part]))
            return value if math.isfinite(value) else None
    return None
