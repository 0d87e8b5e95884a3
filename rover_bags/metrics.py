"""Finds jumps in a bag and says what they amount to, and how well the topics were recorded.

Jumps are found from the recorded motion of Body 1: where the recorded phase or the contact switch
says flight, or, in bags without both, where the body rises from rest and comes down again. Their
figures come from the motion itself: instants between samples by Taylor expansion from the nearest
sample in flight. Angles are the planar model's theta: counter-clockwise seen with x to the right
and z up, so minus the rotation about y (REP-103).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.samples import TETHER_COLUMNS, Level, Status, StatusSample
from msg_schemas.table import FLOOR_SWITCH, TOPICS, Intent
from rover_bags.read import Bag, Floats, Stamps, Track

FLIGHT = "flight"
_STANDING: Final = ("held", "landed")
_TENSION: Final = TETHER_COLUMNS.index("tension")
_AT_REST: Final = 1e-3
"""Speed [m/s] and rate [rad/s] below which a body counts as standing."""
_LEAST_RISE: Final = 5e-3
"""Rise [m] from which a motion without phase or contact counts as a jump."""
GAP: Final = 1.75
"""A pause longer than so many periods is a gap."""


@dataclass(frozen=True)
class Jump:
    """One jump, in simulated time.

    Attributes:
        take_off_s, apex_s, touchdown_s: Instants [s]; touchdown None for a flight that the bag
            does not see end (the figures then end with the last sample).
        jump_height_m: Largest rise of Body 1 over its start, H [m].
        attitude_variation_rad: theta at touchdown minus theta at take-off [rad].
        travel_m: Way of Body 1 over ground from take-off to touchdown, forwards positive [m].
        flight_time_s: From take-off to touchdown [s].
        slack: dh/df of the tether's end points before take-off [-].
        peak_tension_N: Largest tension anywhere in the tether [N].
        energy_drift_J: What the plant's energy balance missed from take-off to touchdown [J].
        drop_samples: Samples of Body 1 missing during the flight.
        reported: What the plant's own events say of this jump, by their names.
    """

    take_off_s: float
    apex_s: float
    touchdown_s: float | None
    jump_height_m: float
    attitude_variation_rad: float
    travel_m: float
    flight_time_s: float
    slack: float | None
    peak_tension_N: float | None
    energy_drift_J: float | None
    drop_samples: int
    reported: Mapping[str, float]


@dataclass(frozen=True)
class TopicFigures:
    """How one topic was recorded.

    Rates and gaps are by the clock that paces the topic: simulated time, or the machine's for
    what nodes say of their health.

    Attributes:
        topic: Name in the contract, or the full name of a topic outside it.
        type: Message type.
        count: Messages.
        expected_hz: Rate that the contract promises; None where it promises none.
        rate_hz: Messages per second between the first and the last.
        wall_rate_hz: The same by the machine's clock.
        max_gap_s: Longest pause between messages.
        max_gap_at_s: When it began, in simulated time.
        gaps: Pauses of more than 1.75 promised periods.
        latency_p50_ms, latency_p99_ms, latency_max_ms: From sending to reception, machine's
            clock; without messages sent before the recorder was listening, and None for latched
            topics, which may be received long after they were sent.
        dropped: Messages that the recorder could not keep.
        missed: Messages lost before they reached the recorder.
        rejected: Messages that break the contract.
        unverified: Messages that no checksum protects.
    """

    topic: str
    type: str
    count: int
    expected_hz: float | None
    rate_hz: float | None
    wall_rate_hz: float | None
    max_gap_s: float | None
    max_gap_at_s: float | None
    gaps: int | None
    latency_p50_ms: float | None
    latency_p99_ms: float | None
    latency_max_ms: float | None
    dropped: int
    missed: int
    rejected: int
    unverified: int


@dataclass(frozen=True)
class Entry:
    """One line of the events or refusals."""

    time_s: float
    node: str
    name: str
    message: str
    level: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class Metrics:
    """Everything that a bag tells in numbers."""

    jumps: tuple[Jump, ...]
    topics: Mapping[str, TopicFigures]
    events: tuple[Entry, ...]
    refusals: tuple[Entry, ...]
    duration_s: float
    simulated_s: float | None

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON; the figures of the first jump stand at the top as well."""
        first = asdict(self.jumps[0]) if self.jumps else {}
        names = (
            "jump_height_m", "attitude_variation_rad", "slack", "peak_tension_N",
            "energy_drift_J", "flight_time_s", "travel_m",
        )  # fmt: skip
        return {
            **{name: first.get(name) for name in names},
            "duration_s": self.duration_s,
            "simulated_s": self.simulated_s,
            "jumps": [asdict(jump) for jump in self.jumps],
            "topics": {name: asdict(figures) for name, figures in self.topics.items()},
            "events": [asdict(entry) for entry in self.events],
            "refusals": [asdict(entry) for entry in self.refusals],
        }


@dataclass(frozen=True)
class Motion:
    """Motion of a body in the world.

    Attributes:
        time: Simulated time [s], shape (N,).
        log_ns: Time of reception [ns since 1970], shape (N,).
        position: Of its centre [m], shape (N, 3).
        velocity: Of its centre, in the world's axes [m/s], shape (N, 3).
        theta: Angle in the plane of x and z [rad], unwrapped, shape (N,).
        theta_rate: Its rate [rad/s], shape (N,).
    """

    time: Floats
    log_ns: Stamps
    position: Floats
    velocity: Floats
    theta: Floats
    theta_rate: Floats


def motion(track: Track) -> Motion:
    """World motion from a body's odometry, whose twist is in the body's own frame."""
    x, y, z, w = track.vector("orientation", "xyzw").T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    velocity = np.einsum("ijn,nj->ni", rotation, track.vector("linear"))
    # The body's x axis against the horizontal, in the plane of x and z.
    theta = np.unwrap(np.arctan2(rotation[2, 0], rotation[0, 0]))
    return Motion(
        track.time,
        track.log_ns,
        track.vector("position"),
        velocity,
        theta,
        -track.columns["angular.y"],
    )


def measure(bag: Bag) -> Metrics:
    """All figures of a bag."""
    clock = bag.track(topics.CLOCK)
    events = tuple(_entries(bag.track(topics.EVENTS)))
    return Metrics(
        jumps=tuple(_jumps(bag, events)),
        topics=_topic_figures(bag),
        events=events,
        refusals=tuple(
            entry for entry in _entries(bag.track(topics.DIAGNOSTICS)) if "code" in entry.values
        ),
        duration_s=bag.duration,
        simulated_s=float(clock.time[-1] - clock.time[0]) if clock is not None else None,
    )


# --- jumps ----------------------------------------------------------------------------------------


def _jumps(bag: Bag, events: Iterable[Entry]) -> Iterable[Jump]:
    track = bag.track(topics.TRUTH_BODY1)
    if track is None or len(track) < 3:
        return
    body = motion(track)
    for first, last, ended in flights(bag, body):
        yield _jump(bag, body, first, last, ended=ended, events=events)


def flights(bag: Bag, body: Motion) -> list[tuple[int, int, bool]]:
    """Flights as samples of Body 1: first and last one in the air, and whether it ended."""
    aloft = _aloft_by_phase(bag, body)
    if aloft is None:
        aloft = _aloft_by_contact(bag, body)
    if aloft is None:
        aloft = _aloft_by_motion(body)
    restarts = np.flatnonzero(np.diff(body.time) < 0.0)
    changes = np.diff(aloft.astype(np.int8))
    found = []
    for first in (np.flatnonzero(changes == 1) + 1).tolist():
        after = np.flatnonzero(changes[first:] == -1)
        last = first + int(after[0]) if len(after) else len(aloft) - 1
        # Simulated time that jumps back ends a flight without a landing.
        cut = restarts[(restarts >= first) & (restarts <= last)]
        ended = bool(len(after)) and not len(cut)
        last = int(cut[0]) if len(cut) else last
        # Back below its starting height it has landed, whether or not it is stopped there.
        height = body.position[first : last + 1, 2] - body.position[max(first - 1, 0), 2]
        below = np.flatnonzero((height < 0.0) & (body.velocity[first : last + 1, 2] < 0.0))
        if len(below):
            last, ended = int(first + below[0]) - 1, True
        if last > first:
            found.append((first, last, ended))
    return found


def _aloft_by_phase(bag: Bag, body: Motion) -> Any:
    """In the air by the recorded phase; samples at a change are settled by their motion."""
    track = bag.track(topics.TRUTH_PHASE)
    if track is None or not set(track.texts) & {FLIGHT, *_STANDING}:
        return None
    index = np.searchsorted(track.log_ns, body.log_ns, side="right") - 1
    words = np.array([*track.texts, track.texts[0]])
    aloft = words[index] == FLIGHT
    # Phase and motion travel on topics of their own: near a change their order is not theirs.
    near = np.zeros(len(aloft), dtype=bool)
    for change in track.log_ns:
        near |= np.abs(body.log_ns - change) < 200_000_000
    near &= np.isin(words[index], [FLIGHT, *_STANDING])
    moving = ~_resting(body)
    flown = FLIGHT in track.texts
    return np.where(near, moving & flown, aloft)


def _aloft_by_contact(bag: Bag, body: Motion) -> Any:
    track = bag.track(topics.CONTACT)
    if track is None:
        return None
    closed = track.columns[f"{FLOOR_SWITCH}.position"]
    if not (closed > 0.5).any():
        return None
    index = np.clip(np.searchsorted(track.time, body.time, side="right") - 1, 0, len(track) - 1)
    return closed[index] < 0.5


def _aloft_by_motion(body: Motion) -> Any:
    """Above the last place of rest; a motion that never rises by 5 mm is none."""
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
        if rise < _LEAST_RISE:
            aloft[first:last] = False
    return aloft


def _resting(body: Motion) -> Any:
    """At rest in this sample and in a neighbour: at the apex a body is slow in one only."""
    speed = np.linalg.norm(body.velocity, axis=1)
    slow = (speed < _AT_REST) & (np.abs(body.theta_rate) < _AT_REST)
    beside = np.zeros(len(slow), dtype=bool)
    beside[1:] |= slow[:-1]
    beside[:-1] |= slow[1:]
    return slow & beside


def _jump(
    bag: Bag, body: Motion, first: int, last: int, *, ended: bool, events: Iterable[Entry]
) -> Jump:
    start = max(first - 1, 0)
    z0 = float(body.position[start, 2])
    reported_start = _reported(events, "take_off", body.time[start], body.time[first])
    take_off = (
        reported_start.time_s
        if reported_start is not None
        else body.time[first] - _since_level(body, first, z0, back=True)
    )
    touchdown, landing, theta = _landing(body, last, z0, ended=ended)
    reported_end = (
        _reported(
            events, "touchdown", body.time[last], body.time[min(last + 1, len(body.time) - 1)]
        )
        if ended
        else None
    )
    if reported_end is not None:
        touchdown = reported_end.time_s
    apex, top = _apex(body, first, last)
    way = landing - body.position[start]
    travel = math.copysign(math.hypot(way[0], way[1]), way[0])
    end = touchdown if ended else float(body.time[last])
    values = reported_end.values if reported_end is not None else {}
    window = Window.of(body, start, min(last + 1, len(body.time) - 1))
    return Jump(
        take_off_s=float(take_off),
        apex_s=apex,
        touchdown_s=float(touchdown) if ended else None,
        jump_height_m=top - z0,
        attitude_variation_rad=float(theta - body.theta[start]),
        travel_m=travel,
        flight_time_s=float(end - take_off),
        slack=_slack(bag, window),
        peak_tension_N=_peak_tension(bag, window),
        energy_drift_J=_drift(bag, window),
        drop_samples=_missing(body.time[first : last + 1]),
        reported={
            key: number for key, text in values.items() if (number := _number(text)) is not None
        },
    )


def _landing(body: Motion, last: int, z0: float, *, ended: bool) -> tuple[float, Floats, float]:
    """Time, place and theta at which Body 1 is back at its starting height."""
    if ended and last + 1 < len(body.time):
        beyond = last + 1
        step = _since_level(body, last, z0, back=False)
        step = min(step, float(body.time[beyond] - body.time[last]))
        time = float(body.time[last]) + step
        if _resting(body)[beyond]:
            # Held where it came down: the first sample at rest is the landing itself.
            return time, body.position[beyond], float(body.theta[beyond])
        share = 0.5 * step**2 / float(body.time[beyond] - body.time[last])
        velocity, rate = body.velocity, body.theta_rate
        place = body.position[last] + velocity[last] * step
        place = place + (velocity[beyond] - velocity[last]) * share
        theta = body.theta[last] + rate[last] * step + (rate[beyond] - rate[last]) * share
        return time, place, float(theta)
    return float(body.time[last]), body.position[last], float(body.theta[last])


def _since_level(body: Motion, index: int, z0: float, *, back: bool) -> float:
    """Time between a sample in flight and the passage of the height z0 nearest to it."""
    other = index + 1 if back else index - 1
    height = float(body.position[index, 2]) - z0
    speed = float(body.velocity[index, 2])
    span = float(body.time[other] - body.time[index])
    gain = float(body.velocity[other, 2] - speed) / span if span else 0.0
    # height + speed t + gain t^2 / 2 = 0, the root nearest to t = 0 on the side that is asked.
    roots = np.roots([0.5 * gain, speed, height]) if gain else np.array([-height / speed])
    real = roots[np.isreal(roots)].real
    fitting = -real[real <= 0.0] if back else real[real >= 0.0]
    return float(fitting.min()) if len(fitting) else 0.0


def _apex(body: Motion, first: int, last: int) -> tuple[float, float]:
    """Time and height of the highest point, by cubic Hermite between samples."""
    z, v, t = body.position[:, 2], body.velocity[:, 2], body.time
    best = max(range(first, last + 1), key=lambda index: float(z[index]))
    time, top = float(t[best]), float(z[best])
    for left in (best - 1, best):
        if left < first or left + 1 > last:
            continue
        h = float(t[left + 1] - t[left])
        if h <= 0.0:
            continue
        rise = (z[left + 1] - z[left]) / h
        # z(s) = z0 + v0 s + c2 s^2 + c3 s^3 on 0..h
        c2 = (3 * rise - 2 * v[left] - v[left + 1]) / h
        c3 = (v[left] + v[left + 1] - 2 * rise) / h**2
        for root in np.roots([3 * c3, 2 * c2, v[left]]):
            if np.isreal(root) and 0.0 <= root.real <= h:
                s = float(root.real)
                height = float(z[left] + v[left] * s + c2 * s**2 + c3 * s**3)
                if height > top:
                    time, top = float(t[left]) + s, height
    return time, top


class Window(NamedTuple):
    """A stretch of simulated time [s] and, as that may be passed twice, of log time [ns]."""

    begin: float
    end: float
    log_begin: int
    log_end: int

    @classmethod
    def of(cls, body: Motion, first: int, last: int) -> "Window":
        """From one sample of a body to another."""
        margin = 1_000_000_000
        return cls(
            float(body.time[first]) - 1e-9,
            float(body.time[last]) + 1e-9,
            int(body.log_ns[first]) - margin,
            int(body.log_ns[last]) + margin,
        )

    def indices(self, track: Track) -> NDArray[np.intp]:
        """Messages of a track inside."""
        in_time = (track.time >= self.begin) & (track.time <= self.end)
        in_log = (track.log_ns >= self.log_begin) & (track.log_ns <= self.log_end)
        return np.flatnonzero(in_time & in_log)

    def before(self, track: Track) -> int:
        """The last message of a track up to the beginning."""
        near = (track.log_ns <= self.log_end) & (track.time <= self.begin + 2e-9)
        found = np.flatnonzero(near)
        return int(found[-1]) if len(found) else 0


def _slack(bag: Bag, window: Window) -> float | None:
    """dh/df of the tether's end points in the last shape before take-off."""
    track = bag.track(topics.TRUTH_TETHER)
    if track is None or track.nodes is None:
        return None
    nodes = track.nodes[window.before(track)]
    way = nodes[-1, :3] - nodes[0, :3]
    level = math.hypot(way[0], way[1])
    return float(abs(way[2]) / level) if level > 0.0 else None


def _peak_tension(bag: Bag, window: Window) -> float | None:
    """Largest recorded tension during a flight, along the tether and at the load cell."""
    peaks = []
    track = bag.track(topics.TRUTH_TETHER)
    if track is not None and track.nodes is not None:
        peaks += list(track.nodes[window.indices(track), :, _TENSION].max(axis=1))
    load = bag.track(topics.LOAD_CELL)
    if load is not None:
        peaks += list(np.linalg.norm(load.vector("force")[window.indices(load)], axis=1))
    return float(max(peaks)) if peaks else None


def _drift(bag: Bag, window: Window) -> float | None:
    """Change of the plant's energy balance over a flight."""
    track = bag.track(topics.TRUTH_ENERGY)
    if track is None:
        return None
    inside = window.indices(track)
    if len(inside) < 2:
        return None
    drift = track.columns["drift.position"]
    return float(drift[inside[-1]] - drift[inside[0]])


def _missing(time: Floats) -> int:
    """Samples that are not there, by the usual step."""
    steps = np.diff(time)
    if not len(steps):
        return 0
    usual = float(np.median(steps))
    return int(np.maximum(np.round(steps / usual) - 1, 0).sum()) if usual > 0.0 else 0


def _reported(events: Iterable[Entry], name: str, begin: float, end: float) -> Entry | None:
    near = [e for e in events if e.name == name and begin - 1e-6 <= e.time_s <= end + 1e-6]
    return near[0] if near else None


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


# --- topics ---------------------------------------------------------------------------------------


def _topic_figures(bag: Bag) -> dict[str, TopicFigures]:
    contract = {full: name for name, full in bag.full_names.items()}
    names = sorted(set(bag.counts) | set(bag.dropped) | set(bag.missed))
    return {contract.get(full, full): _figures(bag, full, contract.get(full)) for full in names}


def _figures(bag: Bag, full: str, name: str | None) -> TopicFigures:
    row = TOPICS.get(name) if name is not None else None
    track = bag.track(name) if name is not None else None
    rate = wall = gap = gap_at = None
    gaps = None
    latency: list[float | None] = [None, None, None]
    if track is not None:
        rate, wall = _rate(paced(track)), _rate(track.log_ns * 1e-9)
        steps = np.diff(paced(track))
        if len(steps):
            widest = int(np.argmax(steps))
            gap, gap_at = float(steps[widest]), float(track.time[widest])
            if row is not None and row.rate and row.intent is not Intent.COMMAND:
                gaps = int((steps > GAP / row.rate).sum())
        if row is not None and row.intent not in {Intent.LATCHED, Intent.EVENT}:
            heard = track.publish_ns >= track.log_ns[0]
            heard[0] |= len(track) == 1
            delay = (track.log_ns - track.publish_ns)[heard] * 1e-6
            if len(delay):
                latency = [float(np.percentile(delay, q)) for q in (50, 99, 100)]
    return TopicFigures(
        topic=name or full,
        type=bag.types.get(full, ""),
        count=bag.counts.get(full, 0),
        expected_hz=row.rate if row is not None else None,
        rate_hz=rate,
        wall_rate_hz=wall,
        max_gap_s=gap,
        max_gap_at_s=gap_at,
        gaps=gaps,
        latency_p50_ms=latency[0],
        latency_p99_ms=latency[1],
        latency_max_ms=latency[2],
        dropped=bag.dropped.get(full, 0),
        missed=bag.missed.get(full, 0),
        rejected=bag.rejected.get(name, 0) if name else 0,
        unverified=bag.unverified.get(full, 0),
    )


def paced(track: Track) -> Floats:
    """Times [s] by the clock that paces a topic.

    Nodes tell how they are by the machine's clock, so that they do also while simulated time
    stands still; everything else goes by simulated time.
    """
    if TOPICS[track.topic].sample is StatusSample:
        since: Floats = (track.log_ns - track.log_ns[0]) * 1e-9
        return since
    return track.time


def _rate(times: Any) -> float | None:
    span = float(times[-1] - times[0])
    return (len(times) - 1) / span if len(times) > 1 and span > 0.0 else None


# --- events and refusals --------------------------------------------------------------------------


def _entries(track: Track | None) -> Iterable[Entry]:
    if track is None:
        return
    for time, statuses in zip(track.time, track.statuses, strict=True):
        for status in statuses:
            yield _entry(float(time), status)


def _entry(time: float, status: Status) -> Entry:
    level = Level(status.level).name.lower()
    return Entry(time, status.hardware_id, status.name, status.message, level, dict(status.values))
