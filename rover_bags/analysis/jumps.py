"""Find the jumps in a bag and compute their metrics.

In planar runs a jump is a flight of Body 1 by the recorded phase or the contact switch or, in bags
without both, a rise from rest and the fall back. In spatial runs it is a flight from the ground, as
found by the timeline. Metrics are computed from the recorded motion, with instants between samples
by Taylor expansion from the nearest sample in flight. Angles are the planar model's theta:
counter-clockwise seen with x to the right and z up, so minus the rotation about y (REP-103).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from msg_schemas import machine, topics
from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_bags.analysis.entries import TimelineEntry
from rover_bags.analysis.geometry import forward_distance, inside, rotations, tilts, turned_about
from rover_bags.analysis.signals import run_starts
from rover_bags.analysis.timeline import Activity, ActivityInterval, Timeline, TimelineEventKind
from rover_bags.reading.read import Bag, Floats, Stamps, TimeSeries
from rover_bags.reading.time_series import LARGEST

FLIGHT = PlantPhase.FLIGHT
_STANDING: Final = (PlantPhase.HELD, PlantPhase.LANDED)
_AT_REST: Final = 1e-3
"""Speed [m/s] and rate [rad/s] below which a body is at rest."""
_MIN_RISE: Final = 5e-3
"""Smallest rise [m] of a jump in bags without phase and contact switch."""
_REPORTED_NEAR: Final = 0.1
"""Largest time between an event and the start or end of its flight [s]."""


@dataclass(frozen=True)
class RecordedJump:
    """One jump, in simulated time.

    Attributes:
        take_off_s, apex_s, touchdown_s: Instants [s]; touchdown is None if the bag ends in flight
            (the metrics are then of the recorded part).
        log_ns: Reception of the last sample before take-off [ns since 1970].
        start_height_m: z of Body 1 in the world at take-off [m].
        jump_height_m: Largest rise of Body 1 above its start, H [m].
        attitude_variation_rad: theta at touchdown minus theta at take-off [rad]. In space: the
            component of the rotation about minus the body's y axis, nose up positive.
        range_m: Horizontal distance from take-off to touchdown [m].
        rotation_rad: Angle of Body 1's total rotation in flight [rad].
        tilt_rad: Angle of Body 1 from the vertical at touchdown [rad].
        landing_speed_m_s: Speed of Body 1 at the last sample in flight [m/s].
        travel_m: Horizontal displacement of Body 1 in flight, forward positive [m].
        flight_time_s: Time from take-off to touchdown [s].
        slack: dh/df of the tether's end points before take-off [-].
        peak_tension_N: Largest tension along the tether [N].
        energy_drift_J: Residual of the plant's energy balance over the flight [J].
        missing_samples: Number of samples of Body 1 missing during the flight.
        reported: Values in the plant's own events of this jump, by name.
    """

    take_off_s: float
    apex_s: float
    touchdown_s: float | None
    log_ns: int
    start_height_m: float
    jump_height_m: float
    attitude_variation_rad: float
    range_m: float
    rotation_rad: float
    tilt_rad: float
    landing_speed_m_s: float
    travel_m: float
    flight_time_s: float
    slack: float | None
    peak_tension_N: float | None
    energy_drift_J: float | None
    missing_samples: int
    reported: Mapping[str, float]


@dataclass(frozen=True)
class MotionSeries:
    """Motion of a body in world axes.

    Attributes:
        time: Simulated time [s], shape (N,).
        log_ns: Time of reception [ns since 1970], shape (N,).
        position: Position of its centre [m], shape (N, 3).
        velocity: Velocity of its centre [m/s], shape (N, 3).
        theta: Unwrapped angle in the plane of x and z [rad], shape (N,).
        theta_rate: Rate of theta [rad/s], shape (N,).
    """

    time: Floats
    log_ns: Stamps
    position: Floats
    velocity: Floats
    theta: Floats
    theta_rate: Floats


def motion(series: TimeSeries) -> MotionSeries:
    """Return the world motion from a body's odometry, whose twist is in the body frame."""
    turned = rotations(series)
    velocity = np.einsum("nij,nj->ni", turned, series.vector("linear"))
    # The body's x axis against the horizontal, in the plane of x and z.
    theta = np.unwrap(np.arctan2(turned[:, 2, 0], turned[:, 0, 0]))
    return MotionSeries(
        series.time,
        series.log_ns,
        series.vector("position"),
        velocity,
        theta,
        -series.columns["angular.y"],
    )


def is_spatial(bag: Bag) -> bool:
    """Return whether the run is spatial: the rover may hang as well as stand."""
    model = bag.scenario.get("model")
    if model is not None:
        return bool(model == "spatial")
    phase = bag.series(topics.TRUTH_PHASE)
    words = set(phase.texts) if phase is not None else set()
    return bool(words & {"hanging", "grounded"}) or bag.series(topics.ROVER_LOAD_CELL) is not None


def jumps_of(
    bag: Bag, events: Iterable[TimelineEntry], timeline: Timeline
) -> Iterable[RecordedJump]:
    """Return the metrics of every jump."""
    series = bag.series(topics.TRUTH_BODY1)
    if series is None or len(series) < 3:
        return
    body = motion(series)
    if is_spatial(bag):
        for interval, ended in jumped(timeline):
            part = inside(
                series, interval.begin_s, interval.end_s, (interval.log_begin, interval.log_end)
            )
            if len(part) > 2:
                yield _spatial_jump(bag, body, part, ended=ended, events=events)
        return
    for first, last, ended in flights(bag, body):
        yield _jump(bag, body, first, last, ended=ended, events=events)


def jumped(timeline: Timeline) -> Iterable[tuple[ActivityInterval, bool]]:
    """Yield flights that begin on the ground, and whether they end in the bag."""
    starts = {m.log_ns for m in timeline.events if m.kind is TimelineEventKind.TAKE_OFF}
    followed = {interval.log_begin for interval in timeline.intervals}
    for interval in timeline.intervals:
        if interval.activity is Activity.FLIGHT and interval.log_begin in starts:
            yield interval, interval.log_end in followed


def _spatial_jump(
    bag: Bag,
    body: MotionSeries,
    part: NDArray[np.intp],
    *,
    ended: bool,
    events: Iterable[TimelineEntry],
) -> RecordedJump:
    """Metrics of a flight over rough ground, which ends at the first contact."""
    first, last = int(part[0]), int(part[-1])
    events = _events_near(events, body, first, last)
    near = _REPORTED_NEAR
    took_off = _reported(
        events, PlantEvent.TAKE_OFF, body.time[first] - near, body.time[first] + near
    )
    landed = _reported(events, PlantEvent.TOUCHDOWN, body.time[last] - near, body.time[last] + near)
    take_off = took_off.time_s if took_off is not None else float(body.time[first])
    end = landed.time_s if landed is not None else float(body.time[last])
    # The jump starts at the last sample before the rover leaves the ground.
    first = latest(body, first, take_off)
    last = max(first + 1, latest(body, last, end))
    z0 = float(np.interp(take_off, body.time[first : last + 1], body.position[first : last + 1, 2]))
    apex, top = _apex(body, first, last)
    displacement = body.position[last] - body.position[first]
    window = JumpWindow.of(body, first, last)
    series = bag.time_series[topics.TRUTH_BODY1]
    peaks = [
        entry for entry in events if entry.name == PlantEvent.APEX and take_off < entry.time_s < end
    ]
    values: dict[str, str] = {}
    for entry in (took_off, *peaks, landed):
        values.update(entry.values if entry is not None else {})
    return RecordedJump(
        take_off_s=take_off,
        apex_s=apex,
        touchdown_s=end if ended else None,
        log_ns=int(body.log_ns[first]),
        start_height_m=z0,
        jump_height_m=top - z0,
        attitude_variation_rad=-turned_about(series, first, last)[1],
        range_m=float(np.hypot(displacement[0], displacement[1])),
        rotation_rad=float(np.linalg.norm(turned_about(series, first, last))),
        tilt_rad=float(tilts(series)[last]),
        landing_speed_m_s=float(np.linalg.norm(body.velocity[last])),
        travel_m=forward_distance(series, first, displacement),
        flight_time_s=end - take_off,
        slack=_slack(bag, window),
        peak_tension_N=_peak_tension(bag, window),
        energy_drift_J=_drift(bag, window),
        missing_samples=_missing(body.time[first : last + 1]),
        reported=_numbers(values),
    )


def latest(body: MotionSeries, near: int, time: float) -> int:
    """Return the last sample at or before a time [s], searched from a sample within its run."""
    while near > 0 and body.time[near] > time and body.time[near - 1] <= body.time[near]:
        near -= 1
    while near + 1 < len(body.time) and body.time[near] <= body.time[near + 1] <= time:
        near += 1
    return near


def flights(bag: Bag, body: MotionSeries) -> list[tuple[int, int, bool]]:
    """Return flights: first and last sample in the air, and whether the flight ended."""
    aloft = _aloft_by_phase(bag, body)
    if aloft is None:
        aloft = _aloft_by_contact(bag, body)
    if aloft is None:
        aloft = _aloft_by_motion(body)
    restarts = run_starts(bag, body.time, body.log_ns) - 1
    changes = np.diff(aloft.astype(np.int8))
    found = []
    for first in (np.flatnonzero(changes == 1) + 1).tolist():
        after = np.flatnonzero(changes[first:] == -1)
        last = first + int(after[0]) if len(after) else len(aloft) - 1
        # A reset ends a flight without a landing.
        cut = restarts[(restarts >= first) & (restarts <= last)]
        ended = bool(len(after)) and not len(cut)
        last = int(cut[0]) if len(cut) else last
        # Below its starting height the body has landed, even if the plant lets it fall on.
        height = body.position[first : last + 1, 2] - body.position[max(first - 1, 0), 2]
        below = np.flatnonzero((height < 0.0) & (body.velocity[first : last + 1, 2] < 0.0))
        if len(below):
            last, ended = int(first + below[0]) - 1, True
        if last > first:
            found.append((first, last, ended))
    return found


def _aloft_by_phase(bag: Bag, body: MotionSeries) -> Any:
    """Samples in flight by the recorded phase; near a phase change the motion decides."""
    series = bag.series(topics.TRUTH_PHASE)
    if series is None or not set(series.texts) & {FLIGHT, *_STANDING}:
        return None
    index = np.searchsorted(series.log_ns, body.log_ns, side="right") - 1
    words = np.array([*series.texts, series.texts[0]])
    aloft = words[index] == FLIGHT
    # Phase and motion are separate topics: near a change their order of reception is arbitrary.
    near = np.zeros(len(aloft), dtype=bool)
    for change in series.log_ns:
        near |= np.abs(body.log_ns - change) < 200_000_000
    near &= np.isin(words[index], [FLIGHT, *_STANDING])
    moving = ~_resting(body)
    flown = FLIGHT in series.texts
    return np.where(near, moving & flown, aloft)


def _aloft_by_contact(bag: Bag, body: MotionSeries) -> Any:
    series = bag.series(topics.CONTACT)
    if series is None:
        return None
    closed = series.columns[f"{machine.FLOOR_SWITCH}.position"]
    if not (closed > 0.5).any():
        return None
    index = np.clip(np.searchsorted(series.time, body.time, side="right") - 1, 0, len(series) - 1)
    return closed[index] < 0.5


def _aloft_by_motion(body: MotionSeries) -> Any:
    """Samples above the last position at rest, if the rise exceeds 5 mm."""
    resting = _resting(body)
    aloft = np.zeros(len(resting), dtype=bool)
    start = None
    for index in range(len(resting)):
        if resting[index]:
            start = index
        elif start is not None:
            height = body.position[index, 2] - body.position[start, 2]
            falling = body.velocity[index, 2] < 0.0
            if height > 0.0 or not falling:
                aloft[index] = True
            else:
                start = None
    for first in np.flatnonzero(np.diff(aloft.astype(np.int8)) == 1) + 1:
        last = first
        while last < len(aloft) and aloft[last]:
            last += 1
        rise = body.position[first:last, 2].max() - body.position[first - 1, 2]
        if rise < _MIN_RISE:
            aloft[first:last] = False
    return aloft


def _resting(body: MotionSeries) -> Any:
    """Samples at rest together with a neighbour: at the apex a body is slow in one sample only."""
    speed = np.linalg.norm(body.velocity, axis=1)
    slow = (speed < _AT_REST) & (np.abs(body.theta_rate) < _AT_REST)
    beside = np.zeros(len(slow), dtype=bool)
    beside[1:] |= slow[:-1]
    beside[:-1] |= slow[1:]
    return slow & beside


def _jump(
    bag: Bag,
    body: MotionSeries,
    first: int,
    last: int,
    *,
    ended: bool,
    events: Iterable[TimelineEntry],
) -> RecordedJump:
    start = max(first - 1, 0)
    events = _events_near(events, body, start, last)
    z0 = float(body.position[start, 2])
    reported_start = _reported(events, PlantEvent.TAKE_OFF, body.time[start], body.time[first])
    take_off = (
        reported_start.time_s
        if reported_start is not None
        else body.time[first] - _since_level(body, first, z0, back=True)
    )
    touchdown, landing, theta = _landing(body, last, z0, ended=ended)
    reported_end = (
        _reported(
            events,
            PlantEvent.TOUCHDOWN,
            body.time[last],
            body.time[min(last + 1, len(body.time) - 1)],
        )
        if ended
        else None
    )
    if reported_end is not None:
        touchdown = reported_end.time_s
    apex, top = _apex(body, first, last)
    displacement = landing - body.position[start]
    travel = math.copysign(math.hypot(displacement[0], displacement[1]), displacement[0])
    end = touchdown if ended else float(body.time[last])
    values = reported_end.values if reported_end is not None else {}
    window = JumpWindow.of(body, start, min(last + 1, len(body.time) - 1))
    return RecordedJump(
        take_off_s=float(take_off),
        apex_s=apex,
        touchdown_s=float(touchdown) if ended else None,
        log_ns=int(body.log_ns[start]),
        start_height_m=z0,
        jump_height_m=top - z0,
        attitude_variation_rad=float(theta - body.theta[start]),
        range_m=math.hypot(displacement[0], displacement[1]),
        rotation_rad=abs(float(theta - body.theta[start])),
        tilt_rad=abs(math.remainder(float(theta), math.tau)),
        landing_speed_m_s=float(np.linalg.norm(body.velocity[last])),
        travel_m=travel,
        flight_time_s=float(end - take_off),
        slack=_slack(bag, window),
        peak_tension_N=_peak_tension(bag, window),
        energy_drift_J=_drift(bag, window),
        missing_samples=_missing(body.time[first : last + 1]),
        reported=_numbers(values),
    )


def _landing(
    body: MotionSeries, last: int, z0: float, *, ended: bool
) -> tuple[float, Floats, float]:
    """Time [s], position [m] and theta [rad] at which Body 1 is back at its starting height."""
    if ended and last + 1 < len(body.time):
        beyond = last + 1
        step = _since_level(body, last, z0, back=False)
        step = min(step, float(body.time[beyond] - body.time[last]))
        time = float(body.time[last]) + step
        if _resting(body)[beyond]:
            # The plant holds the landed body: the first sample at rest is the landing.
            return time, body.position[beyond], float(body.theta[beyond])
        share = 0.5 * step**2 / float(body.time[beyond] - body.time[last])
        velocity, rate = body.velocity, body.theta_rate
        place = body.position[last] + velocity[last] * step
        place = place + (velocity[beyond] - velocity[last]) * share
        theta = body.theta[last] + rate[last] * step + (rate[beyond] - rate[last]) * share
        return time, place, float(theta)
    return float(body.time[last]), body.position[last], float(body.theta[last])


def _since_level(body: MotionSeries, index: int, z0: float, *, back: bool) -> float:
    """Time [s] between a sample in flight and the nearest passage of the height z0."""
    other = index + 1 if back else index - 1
    height = float(body.position[index, 2]) - z0
    speed = float(body.velocity[index, 2])
    span = float(body.time[other] - body.time[index])
    gain = float(body.velocity[other, 2] - speed) / span if span else 0.0
    # height + speed t + gain t^2 / 2 = 0, take the root nearest to t = 0 on the requested side.
    roots = np.roots([0.5 * gain, speed, height])  # linear if gain is 0
    real = roots[np.isreal(roots)].real
    fitting = -real[real <= 0.0] if back else real[real >= 0.0]
    return float(fitting.min()) if len(fitting) else 0.0


def _apex(body: MotionSeries, first: int, last: int) -> tuple[float, float]:
    """Time [s] and height [m] of the apex, by cubic Hermite interpolation."""
    z, v, t = body.position[:, 2], body.velocity[:, 2], body.time
    best = max(range(first, last + 1), key=lambda index: float(z[index]))
    time, top = float(t[best]), float(z[best])
    for left in (best - 1, best):
        if left < first or left + 1 > last:
            continue
        if t[left + 1] <= t[left]:
            continue
        ends = slice(left, left + 2)
        height = CubicHermiteSpline(t[ends], z[ends], v[ends])
        for root in height.derivative().roots(extrapolate=False):
            if height(root) > top:
                time, top = float(root), float(height(root))
    return time, top


class JumpWindow(NamedTuple):
    """A window of simulated time [s] and, as a reset may repeat that, of log time [ns]."""

    begin: float
    end: float
    log_begin: int
    log_end: int

    @classmethod
    def of(cls, body: MotionSeries, first: int, last: int) -> "JumpWindow":
        """Return the window between two samples of a body."""
        margin = 1_000_000_000
        return cls(
            float(body.time[first]) - 1e-9,
            float(body.time[last]) + 1e-9,
            int(body.log_ns[first]) - margin,
            int(body.log_ns[last]) + margin,
        )

    def indices(self, series: TimeSeries) -> NDArray[np.intp]:
        """Return indices of a series' messages in the window."""
        in_time = (series.time >= self.begin) & (series.time <= self.end)
        in_log = (series.log_ns >= self.log_begin) & (series.log_ns <= self.log_end)
        return np.flatnonzero(in_time & in_log)

    def before(self, series: TimeSeries) -> int:
        """Return the index of the last message of a series up to the window's start."""
        near = (series.log_ns <= self.log_end) & (series.time <= self.begin + 2e-9)
        found = np.flatnonzero(near)
        return int(found[-1]) if len(found) else 0


def _slack(bag: Bag, window: JumpWindow) -> float | None:
    """dh/df of the tether's end points in the last shape before take-off."""
    series = bag.series(topics.TRUTH_TETHER)
    if series is None or not series.shapes:
        return None
    nodes = series.shapes[window.before(series)]
    span = nodes[-1, :3] - nodes[0, :3]
    horizontal = math.hypot(span[0], span[1])
    return float(abs(span[2]) / horizontal) if horizontal > 0.0 else None


def _peak_tension(bag: Bag, window: JumpWindow) -> float | None:
    """Largest recorded tension [N] during a flight, along the tether and at the load cell."""
    peaks = []
    series = bag.series(topics.TRUTH_TETHER)
    if series is not None and LARGEST in series.columns:
        peaks += series.highest(LARGEST)[window.indices(series)].tolist()
    load = bag.series(topics.LOAD_CELL)
    if load is not None:
        peaks += load.largest("force")[window.indices(load)].tolist()
    return max(peaks) if peaks else None


def _drift(bag: Bag, window: JumpWindow) -> float | None:
    """Change of the energy balance's residual over a flight [J]."""
    series = bag.series(topics.TRUTH_ENERGY)
    if series is None:
        return None
    inside = window.indices(series)
    if len(inside) < 2:
        return None
    drift = series.columns["drift.position"]
    return float(drift[inside[-1]] - drift[inside[0]])


def _missing(time: Floats) -> int:
    """Number of missing samples, judged by the median step."""
    steps = np.diff(time)
    if not len(steps):
        return 0
    typical = float(np.median(steps))
    return int(np.maximum(np.round(steps / typical) - 1, 0).sum()) if typical > 0.0 else 0


def _events_near(
    events: Iterable[TimelineEntry], body: MotionSeries, first: int, last: int
) -> list[TimelineEntry]:
    """Events received between two samples of a body."""
    window = JumpWindow.of(body, first, last)
    return [entry for entry in events if window.log_begin <= entry.log_ns <= window.log_end]


def _reported(
    events: Iterable[TimelineEntry], name: str, begin: float, end: float
) -> TimelineEntry | None:
    near = [e for e in events if e.name == name and begin - 1e-6 <= e.time_s <= end + 1e-6]
    return near[0] if near else None


def _numbers(values: Mapping[str, str]) -> dict[str, float]:
    """The values that are finite numbers."""
    found = {}
    for name, text in values.items():
        try:
            value = float(text)
        except ValueError:
            continue
        if math.isfinite(value):
            found[name] = value
    return found
