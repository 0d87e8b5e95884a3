"""Figures of descents, drives and exposures, each over its stretch of the timeline."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.table import (
    REFERENCE,
    SMEAR,
    WALL_DISTANCE,
    WHEEL_LEFT,
    WHEEL_RIGHT,
    WINCH_DRUM,
)
from rover_bags.analysis.geometry import headings, inside, setting
from rover_bags.analysis.timeline import Activity, Phase, Timeline
from rover_bags.analysis.wall_coverage import NO_WALL
from rover_bags.read import Bag, Floats, TimeSeries

SMEAR_LIMIT: Final = 1.0
"""A picture that smears by no more is sharp [px]."""
_STEADY: Final = 0.05
"""Of the usual rate: a drum within so much of it pays out steadily."""
_AT_ENDS: Final = 1.0
"""Of a motion that are no steady payout [s]."""
_LEAST_PICTURES: Final = 3


@dataclass(frozen=True)
class Descent:
    """One motion of the drum with the rover on the tether, down or up.

    Attributes:
        begin_s, end_s: When, in simulated time.
        downward: Whether tether was paid out.
        from_m, to_m: Length at the drum.
        depth_from_m, depth_to_m: Of Body 1 below the fairlead; None without its true motion.
        rate_m_s: Mean rate of the drum, without sign.
        fastest_m_s: Largest rate.
        deviation_m: Largest distance of the drum's length from the winch's reference; None where
            no reference is recorded.
        tension_mean_N: Mean at the fairlead, in steady payout.
        ripple: RMS of the tension about its slow rise, over its mean, in steady payout.
        peak_tension_N: Largest at the fairlead.
        swing_max_rad, swing_rms_rad: Of the line from the fairlead to Body 1 from the vertical.
    """

    begin_s: float
    end_s: float
    downward: bool
    from_m: float
    to_m: float
    depth_from_m: float | None
    depth_to_m: float | None
    rate_m_s: float
    fastest_m_s: float
    deviation_m: float | None
    tension_mean_N: float | None
    ripple: float | None
    peak_tension_N: float | None
    swing_max_rad: float | None
    swing_rms_rad: float | None


@dataclass(frozen=True)
class Drive:
    """One stretch of driven wheels.

    Attributes:
        begin_s, end_s: When, in simulated time.
        turning: Whether it turned on the spot rather than drove.
        path_m: Way of Body 1 over ground; None without its true motion, as the next ones.
        distance_m: From begin to end in a straight line.
        heading_rad: Change of heading, left positive.
        rolled_m: What the wheels rolled, mean of both; None without their radius.
        slip: 1 - path over rolled, of straight drives.
        odometry_error_m: How far wheels and gyro alone put the rover from where it is at the end.
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
class Travel:
    """All drives between two absences from the floor.

    Attributes:
        begin_s, end_s: From the first drive's begin to the last one's end.
        drives: How many.
        path_m: Way over ground.
        closing_m: From where it began to where it ended: the closing error of a round trip.
    """

    begin_s: float
    end_s: float
    drives: int
    path_m: float
    closing_m: float


@dataclass(frozen=True)
class Exposure:
    """Pictures of the wall taken while the rover hangs at one place.

    Attributes:
        begin_s, end_s: When, in simulated time.
        depth_m: Of Body 1, or of the drum's length, in the mean.
        wall_m: Distance of the wall, median.
        pictures: How many.
        sharp: Share that smears by no more than 1 px.
        smear_median_px, smear_max_px: Of the pictures.
    """

    begin_s: float
    end_s: float
    depth_m: float | None
    wall_m: float
    pictures: int
    sharp: float
    smear_median_px: float
    smear_max_px: float


def _part(track: TimeSeries, phase: Phase) -> NDArray[np.intp]:
    return inside(track, phase.begin_s, phase.end_s, (phase.log_begin, phase.log_end))


# --- descents -----------------------------------------------------------------------------------


def descents_of(bag: Bag, timeline: Timeline) -> tuple[Descent, ...]:
    """Every descent and ascent."""
    found = []
    for phase in timeline.of(Activity.DESCENDING, Activity.ASCENDING):
        descent = _descent(bag, phase)
        if descent is not None:
            found.append(descent)
    return tuple(found)


def _descent(bag: Bag, phase: Phase) -> Descent | None:
    drum = bag.track(topics.WINCH_STATE)
    if drum is None:
        return None
    part = _part(drum, phase)
    if len(part) < 3:
        return None
    length = drum.columns[f"{WINCH_DRUM}.position"][part]
    rate = np.abs(drum.columns[f"{WINCH_DRUM}.velocity"][part])
    tension, mean, ripple = _tension(bag, phase, drum.time[part], rate)
    depth, swing = _depth_and_swing(bag, phase)
    return Descent(
        begin_s=phase.begin_s,
        end_s=phase.end_s,
        downward=phase.what is Activity.DESCENDING,
        from_m=float(length[0]),
        to_m=float(length[-1]),
        depth_from_m=None if depth is None else float(depth[0]),
        depth_to_m=None if depth is None else float(depth[-1]),
        rate_m_s=float(abs(length[-1] - length[0])) / max(phase.duration_s, 1e-9),
        fastest_m_s=float(rate.max()),
        deviation_m=_deviation(bag, drum.time[part], length, phase),
        tension_mean_N=mean,
        ripple=ripple,
        peak_tension_N=tension,
        swing_max_rad=None if swing is None else float(swing.max()),
        swing_rms_rad=None if swing is None else float(np.sqrt(np.mean(swing**2))),
    )


def _tension(
    bag: Bag, phase: Phase, time: Floats, rate: Floats
) -> tuple[float | None, float | None, float | None]:
    """Peak, and mean and relative ripple in steady payout."""
    cell = bag.track(topics.LOAD_CELL)
    if cell is None:
        return None, None, None
    part = _part(cell, phase)
    if not len(part):
        return None, None, None
    force = np.linalg.norm(cell.vector("force")[part], axis=1)
    peak = float(cell.largest("force")[part].max())
    usual = float(np.median(rate))
    speed = np.interp(cell.time[part], time, rate)
    inner = (cell.time[part] > phase.begin_s + _AT_ENDS) & (
        cell.time[part] < phase.end_s - _AT_ENDS
    )
    steady = inner & (np.abs(speed - usual) <= _STEADY * usual)
    if steady.sum() < 20:
        return peak, None, None
    line = np.polynomial.Polynomial.fit(cell.time[part][steady], force[steady], 1)
    rest = force[steady] - line(cell.time[part][steady])
    mean = float(force[steady].mean())
    ripple = float(np.sqrt(np.mean(rest**2)) / mean) if mean > 0.0 else None
    return peak, mean, ripple


def _deviation(bag: Bag, time: Floats, length: Floats, phase: Phase) -> float | None:
    estimate = bag.track(topics.WINCH_ESTIMATE)
    if estimate is None:
        return None
    part = _part(estimate, phase)
    if len(part) < 2:
        return None
    aimed = np.interp(time, estimate.time[part], estimate.columns[f"{REFERENCE}.position"][part])
    known = (time >= estimate.time[part][0]) & (time <= estimate.time[part][-1])
    return float(np.abs(length - aimed)[known].max()) if known.any() else None


def _depth_and_swing(bag: Bag, phase: Phase) -> tuple[Floats | None, Floats | None]:
    body = bag.track(topics.TRUTH_BODY1)
    if body is None:
        return None, None
    place = body.vector("position")[_part(body, phase)]
    if len(place) < 2:
        return None, None
    depth = -place[:, 2]
    return depth, swing_angles(place)


def swing_angles(place: Floats) -> Floats:
    """Angle from the vertical [rad] of the line from the fairlead to places, shape (N, 3)."""
    return np.asarray(np.arctan2(np.hypot(place[:, 0], place[:, 1]), -place[:, 2]))


def hanging_swing(bag: Bag, timeline: Timeline) -> tuple[Floats, Floats] | None:
    """Times [s] and swing angles [rad] of Body 1, NaN while it stands; None if it never hangs.

    Of a rover that stands the line to the fairlead tells where it has driven, not how it swings.
    """
    body = bag.track(topics.TRUTH_BODY1)
    hangs = timeline.of(Activity.HANGING, Activity.DESCENDING, Activity.ASCENDING)
    if body is None or not hangs:
        return None
    angles = swing_angles(body.vector("position"))
    found = np.full(len(body), np.nan)
    for phase in hangs:
        part = _part(body, phase)
        found[part] = angles[part]
    return body.time, found


# --- drives -------------------------------------------------------------------------------------


def drives_of(bag: Bag, timeline: Timeline) -> tuple[Drive, ...]:
    """Every stretch of driven wheels."""
    return tuple(_drive(bag, p) for p in timeline.of(Activity.DRIVING, Activity.TURNING))


def _drive(bag: Bag, phase: Phase) -> Drive:
    turning = phase.what is Activity.TURNING
    path = distance = heading = slip = error = None
    way: Floats | None = None
    body = bag.track(topics.TRUTH_BODY1)
    if body is not None and len(part := _part(body, phase)) > 1:
        way = body.vector("position")[part]
        path = way_length(body.time[part], way)
        distance = float(np.linalg.norm(way[-1, :2] - way[0, :2]))
        turned = headings(body)[part]
        heading = float(turned[-1] - turned[0])
        error = _odometry_error(bag, phase, way, float(turned[0]))
    rolled = _rolled(bag, phase)
    if path is not None and rolled is not None and rolled > 0.05 and not turning:
        slip = 1.0 - path / rolled
    return Drive(phase.begin_s, phase.end_s, turning, path, distance, heading, rolled, slip, error)


def way_length(time: Floats, way: Floats) -> float:
    """Length of a way over ground [m], up and down included.

    It is that through points 0.1 s apart: shaking makes no way.

    Args:
        time: Of each place [s], shape (N,).
        way: The places [m], shape (N, 3).
    """
    count = max(2, round((time[-1] - time[0]) / 0.1) + 1)
    at = np.linspace(time[0], time[-1], count)
    points = np.stack([np.interp(at, time, way[:, axis]) for axis in range(3)], axis=1)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _wheels(bag: Bag, phase: Phase) -> tuple[Floats, Floats, Floats] | None:
    """Time, and what both wheels have rolled since the begin [m]."""
    track, radius = bag.track(topics.WHEEL_STATE), setting(bag, "rover", "wheels", "radius")
    if track is None or not isinstance(radius, float | int):
        return None
    part = _part(track, phase)
    if len(part) < 2:
        return None
    sides = [track.columns[f"{name}.position"][part] for name in (WHEEL_LEFT, WHEEL_RIGHT)]
    left, right = (float(radius) * (side - side[0]) for side in sides)
    return track.time[part], left, right


def _rolled(bag: Bag, phase: Phase) -> float | None:
    wheels = _wheels(bag, phase)
    if wheels is None:
        return None
    _, left, right = wheels
    return 0.5 * (abs(float(left[-1])) + abs(float(right[-1])))


def _odometry_error(bag: Bag, phase: Phase, way: Floats, heading: float) -> float | None:
    """Distance at the end between the true place and that by encoders and gyro."""
    wheels, imu = _wheels(bag, phase), bag.track(topics.IMU)
    if wheels is None or imu is None or len(part := _part(imu, phase)) < 2:
        return None
    time, left, right = wheels
    rate = np.interp(time, imu.time[part], imu.columns["angular_velocity.z"][part])
    course = heading + np.concatenate(
        [[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))]
    )
    # The axle's middle is taken for the body's centre.
    step = np.diff(0.5 * (left + right))
    middle = 0.5 * (course[1:] + course[:-1])
    told = np.array([np.sum(step * np.cos(middle)), np.sum(step * np.sin(middle))])
    return float(np.linalg.norm(told - (way[-1, :2] - way[0, :2])))


def travels_of(bag: Bag, timeline: Timeline) -> tuple[Travel, ...]:
    """Drives that belong together: nothing but standing, slack and jumps lies between them."""
    body = bag.track(topics.TRUTH_BODY1)
    if body is None:
        return ()
    groups: list[list[Phase]] = [[]]
    until = -math.inf
    for phase in timeline.phases:
        if phase.begin_s < until:  # the clock was put back: another run
            groups.append([])
        until = phase.end_s
        if phase.what in {Activity.DRIVING, Activity.TURNING}:
            groups[-1].append(phase)
        elif phase.what in {Activity.HANGING, Activity.DESCENDING, Activity.ASCENDING}:
            groups.append([])
    return tuple(_travels(body, [group for group in groups if group]))


def _travels(body: TimeSeries, groups: list[list[Phase]]) -> Iterator[Travel]:
    for group in groups:
        parts = [part for phase in group if len(part := _part(body, phase)) > 1]
        if not parts:
            continue
        place = body.vector("position")
        ways = [way_length(body.time[part], place[part]) for part in parts]
        closing = place[parts[-1][-1], :2] - place[parts[0][0], :2]
        yield Travel(
            group[0].begin_s, group[-1].end_s, len(group), sum(ways),
            float(np.linalg.norm(closing)),
        )  # fmt: skip


# --- exposures ----------------------------------------------------------------------------------


def exposures_of(bag: Bag, timeline: Timeline) -> tuple[Exposure, ...]:
    """Pictures at each place where the rover hung and its camera saw the wall."""
    camera = bag.track(topics.CAMERA)
    if camera is None:
        return ()
    found = []
    for phase in timeline.of(Activity.HANGING):
        part = _part(camera, phase)
        wall = camera.columns[f"{WALL_DISTANCE}.position"][part]
        sees = wall < NO_WALL
        if sees.sum() < _LEAST_PICTURES:
            continue
        smear = camera.columns[f"{SMEAR}.position"][part][sees]
        found.append(
            Exposure(
                begin_s=float(camera.time[part][sees][0]),
                end_s=float(camera.time[part][sees][-1]),
                depth_m=_depth(bag, phase),
                wall_m=float(np.median(wall[sees])),
                pictures=int(sees.sum()) * camera.stride,
                sharp=float(np.mean(smear <= SMEAR_LIMIT)),
                smear_median_px=float(np.median(smear)),
                smear_max_px=float(smear.max()),
            )
        )
    return tuple(found)


def _depth(bag: Bag, phase: Phase) -> float | None:
    body, drum = bag.track(topics.TRUTH_BODY1), bag.track(topics.WINCH_STATE)
    for track, path, sign in (
        (body, "position.z", -1.0),
        (drum, f"{WINCH_DRUM}.position", 1.0),
    ):
        if track is not None and len(part := _part(track, phase)):
            value = sign * float(np.mean(track.columns[path][part]))
            return value if math.isfinite(value) else None
    return None
