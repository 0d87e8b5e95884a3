"""Side view of a spatial run, as a scene for the animation."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from msg_schemas import topics
from msg_schemas.samples import TETHER_COLUMNS
from rover_bags.analysis.geometry import number_setting, rotations, vector_setting
from rover_bags.reading.read import Bag, Floats, TimeSeries
from rover_bags.views.animation import MovingScene, tension_scale_max
from rover_sim import ScenarioError, scenario_from_mapping

_MAX_FRAMES: Final = 700
_POINTS: Final = 25
"""Points of the drawn tether."""
_CLOSE_UP: Final = 0.75
"""Half the width of the close-up view [m]."""
_MARGIN: Final = 0.6
_SIZES: Final = {"body1_size": (0.30, 0.24, 0.15), "body2_size": (0.24, 0.24, 0.08)}
_TENSION: Final = TETHER_COLUMNS.index("tension")


def spatial_scene(
    bag: Bag,
    begin: float = -math.inf,
    end: float = math.inf,
    *,
    since: float | None = None,
    level: float = 0.0,
) -> MovingScene | None:
    """Return the scene of a run or of a part of it; None if bodies or tether are not recorded.

    Args:
        bag: The bag, of one run.
        begin: Start of the part, in simulated time [s].
        end: End of the part [s].
        since: Take-off from which the scene's time counts [s]; None: simulated time.
        level: Height of Body 1 at that take-off [m].
    """
    first, second, tether = (
        bag.series(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2, topics.TRUTH_TETHER)
    )
    if first is None or second is None or tether is None or not tether.shapes:
        return None
    chosen = np.flatnonzero((tether.time >= begin) & (tether.time <= end))
    chosen = chosen[:: max(1, math.ceil(len(chosen) / _MAX_FRAMES))]
    if len(chosen) < 2:
        return None
    time = tether.time[chosen]
    sizes = {name: vector_setting(bag, 3, "rover", name) or usual for name, usual in _SIZES.items()}
    centre = vector_setting(bag, 3, "rover", "body1_centre") or (0.0, 0.0, 0.0)
    body1 = _side_view(first, time, sizes["body1_size"], centre)
    body2 = _side_view(second, time, sizes["body2_size"], (0.0, 0.0, 0.0))
    shapes = np.stack([_drawn(tether.shapes[index]) for index in chosen.tolist()])
    points = np.concatenate([shapes[:, :, :2].reshape(-1, 2), body1[:, :2], body2[:, :2]])
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    lines = _ground(bag, float(np.median(first.columns["position.y"])))
    lines = tuple(_near_by(line, low, high) for line in lines)
    height = _samples(first, time)[0][:, 2]
    return MovingScene(
        time=time - (0.0 if since is None else since),
        body1=body1,
        body2=body2,
        tether=shapes,
        element=1.0,
        sizes={name: (size[0], size[2]) for name, size in sizes.items()},
        ground=float(low[1]),
        low=(float(low[0]), float(low[1])),
        high=(float(high[0]), float(high[1])),
        close_up=((float(low[0]), float(low[1])), (float(high[0]), float(high[1]))),
        tension_max=tension_scale_max(shapes[:, :, -1]),
        ground_lines=tuple(line for line in lines if len(line) > 1),
        wheels=_wheels(bag, first, time),
        follow=_CLOSE_UP,
        is_run=since is None,
        readout=-height if since is None else height - level,
    )


def _samples(series: TimeSeries, time: Floats) -> tuple[Floats, Floats]:
    """Positions [m], shape (F, 3), and rotations, shape (F, 3, 3), at given times."""
    index = np.clip(np.searchsorted(series.time, time), 0, len(series) - 1)
    return series.vector("position")[index], rotations(series)[index]


def _side_view(
    series: TimeSeries, time: Floats, size: tuple[float, ...], centre: tuple[float, ...]
) -> Floats:
    """Side view of a box: x, z [m], tilt [rad] and projected width [m], shape (F, 4)."""
    place, turned = _samples(series, time)
    place = place + turned @ np.asarray(centre)
    up = turned[:, :, 2]
    tilt = np.arctan2(-up[:, 0], up[:, 2])
    width = np.abs(turned[:, 0, 0]) * size[0] + np.abs(turned[:, 0, 1]) * size[1]
    return np.stack([place[:, 0], place[:, 2], tilt, width], axis=1)


def _wheels(bag: Bag, series: TimeSeries, time: Floats) -> Floats | None:
    """Projected centres and half axes of both wheels [m], shape (F, 2, 4)."""
    names = ("radius", "width", "track_width", "axle_x", "axle_z")
    configured = [number_setting(bag, "rover", "wheels", name) for name in names]
    known = [value for value in configured if value is not None]
    if len(known) < len(names):
        return None
    radius, width, gauge, ahead, above = known
    place, turned = _samples(series, time)
    found = []
    for side in (0.5, -0.5):
        middle = place + turned @ np.array([ahead, side * gauge, above])
        wide = np.abs(turned[:, 0, 0]) * radius + np.abs(turned[:, 0, 1]) * 0.5 * width
        high = np.full(len(time), radius)
        found.append(np.stack([middle[:, 0], middle[:, 2], wide, high], axis=1))
    return np.stack(found, axis=1)


def _drawn(nodes: Floats) -> Floats:
    """x, z, their slopes per piece, and tension along the tether, shape (points, 5)."""
    steps = np.linalg.norm(np.diff(nodes[:, :3], axis=0), axis=1)
    nodes, steps = nodes[np.concatenate([[True], steps > 0.0])], steps[steps > 0.0]
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], _POINTS)
    # Slopes are per undeformed length; the chord length needs their direction only.
    slopes = nodes[:, 3:6] / np.linalg.norm(nodes[:, 3:6], axis=1)[:, None]
    curve = CubicHermiteSpline(along, nodes[:, [0, 2]], slopes[:, [0, 2]])
    tension = np.interp(at, along, nodes[:, _TENSION])
    return np.column_stack([curve(at), curve(at, 1) * along[-1] / (_POINTS - 1), tension])


def _ground(bag: Bag, y: float) -> tuple[Floats, ...]:
    """Outlines of ground and walls of the scenario."""
    if not bag.scenario:
        return ()
    try:
        environment = getattr(scenario_from_mapping(dict(bag.scenario)), "environment", None)
    except (ScenarioError, TypeError, KeyError):
        return ()  # a scenario of another version: draw no ground
    return () if environment is None else tuple(environment.outline(y))


def _near_by(line: Floats, low: Floats, high: Floats) -> Floats:
    """The part of a line that may come into view, with one point beyond each end."""
    reach = 2.0 + 0.7 * float((high - low).max())
    middle = 0.5 * (low + high)
    near = np.all(np.abs(line - middle) <= reach + 0.5 * (high - low), axis=1)
    # Include the neighbours of near points.
    kept = np.convolve(near, np.ones(3), "same") > 0.5
    return np.asarray(line[kept])
