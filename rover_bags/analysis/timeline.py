"""Timeline of the machine's activities, from the recorded sensors.

Contact switches and the tether force at the rover distinguish ground, tether and flight; encoders
of drum, wheels and nut show what moves. Without recorded switches the phase published by the
plant is used.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.phases import JumpPhase, PlantPhase, WinchMode
from msg_schemas.samples import Level
from rover_bags.analysis.entries import entries_of
from rover_bags.analysis.geometry import gravity_of, masses_of
from rover_bags.analysis.signals import Flags, Signals, closed, opened, runs, signals_of
from rover_bags.reading.read import Bag, Floats


class Activity(StrEnum):
    """Activity of the machine."""

    HANGING = "hanging"
    DESCENDING = "descending"
    ASCENDING = "ascending"
    STANDING = "standing"
    SLACK = "slack"
    """The drum pays out or takes up slack while the ground supports the rover."""
    DRIVING = "driving"
    TURNING = "turning"
    COMPRESSING = "compressing"
    FLIGHT = "flight"


class TimelineEventKind(StrEnum):
    """Kind of an event on the timeline."""

    TOUCHDOWN = "touchdown"
    LIFT_OFF = "lift_off"
    LATCH_TRIP = "latch_trip"
    TAKE_OFF = "take_off"
    LANDING = "landing"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class ActivityInterval:
    """An interval of one activity.

    Attributes:
        activity: The activity.
        begin_s, end_s: Simulated time [s].
        log_begin, log_end: Time of reception [ns since 1970].
    """

    activity: Activity
    begin_s: float
    end_s: float
    log_begin: int
    log_end: int

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return self.end_s - self.begin_s


@dataclass(frozen=True)
class TimelineEvent:
    """An event on the timeline.

    Attributes:
        kind: Kind of the event.
        time_s: Simulated time [s].
        log_ns: Time of reception [ns since 1970].
        reason: Reason, if recorded.
    """

    kind: TimelineEventKind
    time_s: float
    log_ns: int
    reason: str = ""


@dataclass(frozen=True)
class Timeline:
    """Consecutive activity intervals, and events.

    Attributes:
        intervals, events: In the order of their reception.
        run_starts: Log times [ns since 1970] of the first instants after a reset.
    """

    intervals: tuple[ActivityInterval, ...] = ()
    events: tuple[TimelineEvent, ...] = ()
    run_starts: tuple[int, ...] = ()

    def of(self, *kinds: Activity) -> tuple[ActivityInterval, ...]:
        """Return the intervals of given activities."""
        return tuple(interval for interval in self.intervals if interval.activity in kinds)


_CREEP: Final = 5e-3
"""Payout rate below which the drum is at rest [m/s]."""
_MIN_TRAVEL: Final = 0.03
"""Smallest net motion of the drum that counts as travel, not as swing damping [m]."""
_STROKE: Final = 0.35
"""Longest damping stroke, as a fraction of the tether length."""
_QUARTER: Final = 1.5 * 0.5 * math.pi / math.sqrt(1.62)
"""Longest damping stroke over the root of the tether length [s/m^0.5].

A stroke lasts a quarter of the swing's period; with lunar gravity and a margin of 1.5."""
_UNDONE: Final = 2.2
"""Largest ratio of consecutive strokes; the first and the last are half as long as the others."""
_STROKE_REST: Final = (0.5, 0.3)
"""Longest rest between two strokes: constant part [s], and fraction of the shorter stroke."""
_PAUSE: Final = 0.3
"""Shortest rest that ends a motion, and shortest motion [s]."""
_BOUNCE: Final = 0.12
"""Shortest loss of contact that counts [s]."""
_WHEELS_TURN: Final = 0.08
"""Wheel rate below which a wheel is at rest [rad/s]."""
_MIN_DRIVE: Final = 0.7
"""Shortest drive [s]."""
_NOISE: Final = 6.0 / math.sqrt(2.0)
"""Four standard deviations of a normal error over the median change between two values."""
_UNLOADED_SHARE: Final = 0.3
"""Fraction of the rover's weight below which the tether counts as unloaded."""
_COMPRESSED_FORCE: Final = 2.0
"""Force on the nut [N] from which the spring counts as compressed."""
_JUST_BEFORE: Final = 0.6
"""Longest time from a latch trip to the flight of its jump [s]."""
_HOP: Final = 0.5
"""Shortest flight without a latch trip; a shorter one is a bounce [s]."""
_BRAKED: Final = 0.05
"""Payout rate from which a closing brake is a fault [m/s]."""
_BRAKE_DELAY: Final = 0.1
"""Time before the closed signal at which the brake does not act yet [s]."""
_SAME_FAULT: Final = 0.6
"""Reports within this time are of the same fault [s]."""

_ACTIVITY_OF_PHASE: Final[Mapping[str, Activity]] = {
    PlantPhase.HELD: Activity.STANDING,
    PlantPhase.LANDED: Activity.STANDING,
    PlantPhase.GROUNDED: Activity.STANDING,
    PlantPhase.FLIGHT: Activity.FLIGHT,
    PlantPhase.HANGING: Activity.HANGING,
}


def timeline_of(bag: Bag) -> Timeline:
    """Return the activities and events of a bag; empty without recorded switches and phase."""
    signals = signals_of(bag)
    if signals is None or len(signals.time) < 2:
        return Timeline()
    trips = _from_ground(signals, _trips(signals))
    support = _support(bag, signals, trips)
    if support is None:
        return Timeline(events=tuple(_faults(bag, signals)))
    intervals = tuple(_intervals(signals, _with_motions(signals, support, trips)))
    events = [
        *(
            TimelineEvent(
                TimelineEventKind.LATCH_TRIP, float(signals.time[i]), int(signals.log_ns[i])
            )
            for i in trips
        ),
        *_changes(intervals),
        *_faults(bag, signals),
    ]
    starts = tuple(signals.log_ns[signals.starts].tolist())
    return Timeline(intervals, tuple(sorted(events, key=lambda event: event.log_ns)), starts)


# --- ground, tether or neither ------------------------------------------------------------------


def _support(bag: Bag, signals: Signals, trips: NDArray[np.intp]) -> NDArray[np.object_] | None:
    """STANDING, HANGING or FLIGHT at each instant; None if it is unknown."""
    time = signals.time
    words = signals.phase
    if signals.in_contact is None:
        if words is None:
            return None
        return np.array(
            [_ACTIVITY_OF_PHASE.get(str(word), Activity.HANGING) for word in words], dtype=object
        )
    grounded = closed(signals.in_contact, time, _BOUNCE)
    found = np.full(len(time), Activity.HANGING, dtype=object)
    found[grounded] = Activity.STANDING
    for begin, end in runs(grounded):
        if grounded[begin]:
            continue
        after = time[end + 1] if end + 1 < len(time) else time[end]
        jumped = _follows(time[begin], time[trips])
        unloaded = _tether_unloaded(bag, signals, begin, end)
        if unloaded is None:  # force unknown: assume a fall after standing
            unloaded = np.full(end - begin + 1, begin > 0)
        if begin > 0 and jumped and unloaded[: max(1, len(unloaded) // 4)].any():
            # A jump is one flight, even if the tether snatches.
            share = closed(unloaded, time[begin : end + 1], 1.0)
            found[begin : end + 1][share] = Activity.FLIGHT
        elif begin > 0 and unloaded.all() and (after - time[begin] > _HOP or not len(trips)):
            found[begin : end + 1] = Activity.FLIGHT
        elif begin > 0 and after - time[begin] <= _HOP and end + 1 < len(time):
            found[begin : end + 1] = Activity.STANDING  # a bounce
        else:
            falls = opened(unloaded, time[begin : end + 1], _HOP)
            found[begin : end + 1][falls] = Activity.FLIGHT
    return found


def _follows(begin: float, trips: Floats) -> bool:
    return bool(((trips <= begin + 0.05) & (trips >= begin - _JUST_BEFORE)).any())


def _tether_unloaded(bag: Bag, signals: Signals, begin: int, end: int) -> Flags | None:
    """Where the tether is unloaded, in a span without contact; None if unknown."""
    part = slice(begin, end + 1)
    weight = _weight(bag)
    if signals.pull is not None and weight is not None:
        return signals.pull[part] < _UNLOADED_SHARE * weight
    if signals.phase is not None:
        return np.asarray(signals.phase[part] == PlantPhase.FLIGHT)
    return None


def _weight(bag: Bag) -> float | None:
    """Weight of the rover [N], as configured, or from its load cell while it hangs."""
    gravity, masses = gravity_of(bag), masses_of(bag)
    if masses is not None and gravity is not None:
        return sum(masses) * gravity
    series = bag.series(topics.ROVER_LOAD_CELL)
    if series is None:
        return None
    pull = np.linalg.norm(series.vector("force"), axis=1)
    return float(np.percentile(pull, 90))


# --- what moves ---------------------------------------------------------------------------------


def _trips(signals: Signals) -> NDArray[np.intp]:
    """Instants at which the latch trips: the force on the nut vanishes."""
    force = signals.get("nut_force")
    if force is None:
        return np.array([], dtype=np.intp)
    fell = (force[:-1] > _COMPRESSED_FORCE) & (force[1:] < 0.3 * force[:-1])
    return np.setdiff1d(np.flatnonzero(fell) + 1, signals.starts)


def _from_ground(signals: Signals, trips: NDArray[np.intp]) -> NDArray[np.intp]:
    """Trips with the rover on the ground or just off it: the nut of a hanging one has no latch."""
    if signals.in_contact is not None:
        grounded = signals.in_contact
    elif signals.phase is not None:
        grounded = np.array(
            [_ACTIVITY_OF_PHASE.get(str(word)) is Activity.STANDING for word in signals.phase]
        )
    else:
        return trips
    time = signals.time

    def is_from_ground(trip: int) -> bool:
        at = trip
        while at >= 0 and 0.0 <= time[trip] - time[at] <= _BOUNCE:
            if grounded[at]:
                return True
            at -= 1
        return False

    return np.array([trip for trip in trips.tolist() if is_from_ground(trip)], dtype=np.intp)


def _with_motions(
    signals: Signals, support: NDArray[np.object_], trips: NDArray[np.intp]
) -> NDArray[np.object_]:
    time, found = signals.time, support.copy()
    stands, flies = support == Activity.STANDING, support == Activity.FLIGHT
    for begin, end, side in _travels(signals, support == Activity.HANGING):
        part = slice(begin, end + 1)
        hangs = np.flatnonzero(support[part] == Activity.HANGING) + begin
        found[hangs] = Activity.DESCENDING if side > 0 else Activity.ASCENDING
        found[np.flatnonzero(stands[part]) + begin] = Activity.SLACK
    for begin, end, what in _drives(signals, stands):
        found[np.flatnonzero(stands[begin : end + 1]) + begin] = what
    force = signals.get("nut_force")
    if force is not None:
        charged = opened(closed(force > _COMPRESSED_FORCE, time, _PAUSE), time, _PAUSE)
        found[charged & stands] = Activity.COMPRESSING
        for trip in trips.tolist():
            # The spring expands from the trip until the rover leaves the ground.
            stop = trip
            while stop < len(time) and not flies[stop] and time[stop] - time[trip] < _JUST_BEFORE:
                stop += 1
            if stop < len(time) and flies[stop]:
                found[trip:stop] = Activity.COMPRESSING
    return found


def _travels(signals: Signals, hangs: Flags) -> list[tuple[int, int, int]]:
    """Motions of the drum without the strokes that damp a hanging swing."""
    motions = sorted(_drum_motions(signals))
    # Small strokes may lie between larger ones: remove them first.
    while strokes := _strokes(signals, hangs, motions):
        motions = [motion for motion in motions if motion not in strokes]
    return motions


def _strokes(
    signals: Signals, hangs: Flags, motions: list[tuple[int, int, int]]
) -> set[tuple[int, int, int]]:
    """Motions that their neighbour reverses."""
    time, length = signals.time, signals.get("length")
    found: set[tuple[int, int, int]] = set()
    if length is None:
        return found
    for one, other in itertools.pairwise(motions):
        if one[2] == other[2] or not (hangs[one[0]] and hangs[other[1]]):
            continue
        lengths = [abs(float(length[end] - length[begin])) for begin, end, _ in (one, other)]
        spans = [float(time[end] - time[begin]) for begin, end, _ in (one, other)]
        rest, share = _STROKE_REST
        if time[other[0]] - time[one[1]] > rest + share * min(spans):
            continue
        for motion, stroke, span, opposite in zip(
            (one, other), lengths, spans, lengths[::-1], strict=True
        ):
            out = float(length[motion[0]])
            short = stroke <= min(_UNDONE * opposite, _STROKE * out)
            if short and span <= _QUARTER * math.sqrt(max(out, 0.0)):
                found.add(motion)
    return found


def _drum_motions(signals: Signals) -> Iterator[tuple[int, int, int]]:
    """First and last instant and sign of each motion of the drum with a net travel."""
    rate, length = signals.get("rate"), signals.get("length")
    if rate is None or length is None:
        return
    sense = np.sign(np.where(np.abs(rate) > _CREEP, rate, 0.0)).astype(np.int8)
    for side in (1, -1):
        moves = opened(closed(sense == side, signals.time, _PAUSE), signals.time, _PAUSE)
        for begin, end in runs(moves):
            if moves[begin] and abs(length[end] - length[begin]) > _MIN_TRAVEL:
                yield begin, end, side


def _drives(signals: Signals, stands: Flags) -> Iterator[tuple[int, int, Activity]]:
    """Intervals of driven wheels on the ground."""
    left, right, current = signals.get("left"), signals.get("right"), signals.get("wheel_current")
    if left is None or right is None:
        return
    fastest = np.maximum(np.abs(left), np.abs(right))
    # Wheels that turn briefly after a landing are not driven; bounces do not end a drive.
    turning = closed((fastest > _WHEELS_TURN) & stands, signals.time, _PAUSE)
    turning = opened(turning, signals.time, _MIN_DRIVE)
    for begin, end in runs(turning):
        if not turning[begin]:
            continue
        part = slice(begin, end + 1)
        if current is not None and np.abs(current[part]).max() < _idle(signals, stands):
            continue
        # Backward, the ratchet drives the left wheel only and the rover turns on the spot. A wheel
        # that coasts forward longer than the other is not driven.
        time = signals.time[part]
        backward = closed(left[part] < -_WHEELS_TURN, time, _MIN_DRIVE)
        backward = opened(backward, time, _MIN_DRIVE)
        for first, last in runs(backward):
            what = Activity.TURNING if backward[first] else Activity.DRIVING
            if time[last] - time[first] >= _MIN_DRIVE:
                yield begin + first, begin + last, what


def _idle(signals: Signals, stands: Flags) -> float:
    """Upper bound of an idle motor's current [A]: four standard deviations of its noise.

    Estimated while the rover stands with its wheels at rest (while it hangs, they control its
    attitude), by the median change between samples: a motor that holds the rover on a slope has a
    steady current.
    """
    left, right, current = (signals.numbers[name] for name in ("left", "right", "wheel_current"))
    rest = stands & (np.abs(left) <= _WHEELS_TURN) & (np.abs(right) <= _WHEELS_TURN)
    changes = np.abs(np.diff(current)[rest[1:] & rest[:-1]])
    changes = changes[np.isfinite(changes)]
    return _NOISE * float(np.median(changes)) if len(changes) else 0.0


# --- intervals and events ----------------------------------------------------------------------


_RECORD_PAUSE: Final = 1.0
"""Pause of the record that ends an activity [s]."""


def _intervals(signals: Signals, found: NDArray[np.object_]) -> Iterator[ActivityInterval]:
    time, log = signals.time, signals.log_ns
    steps = np.diff(time)
    # Activities do not extend across a pause of the record or a reset.
    pause = max(_RECORD_PAUSE, 5.0 * float(np.median(steps)))
    breaks = {*(np.flatnonzero(steps > pause) + 1).tolist(), *signals.starts.tolist()}
    begin = 0
    for index in range(1, len(found) + 1):
        ends = index == len(found) or found[index] != found[begin] or index in breaks
        if not ends:
            continue
        follows = index < len(found) and index not in breaks
        last = index if follows else index - 1
        yield ActivityInterval(
            Activity(found[begin]),
            float(time[begin]),
            float(time[last]),
            int(log[begin]),
            int(log[last]),
        )
        begin = index


_ON_GROUND: Final = frozenset(
    {Activity.STANDING, Activity.SLACK, Activity.DRIVING, Activity.TURNING, Activity.COMPRESSING}
)
_ON_TETHER: Final = frozenset({Activity.HANGING, Activity.DESCENDING, Activity.ASCENDING})


def _changes(intervals: Iterable[ActivityInterval]) -> Iterator[TimelineEvent]:
    """Touchdowns, lift-offs, take-offs and landings between intervals."""
    ordered = list(intervals)
    for before, after in itertools.pairwise(ordered):
        if before.log_end != after.log_begin:
            continue
        kind = None
        if before.activity in _ON_TETHER and after.activity in _ON_GROUND:
            kind = TimelineEventKind.TOUCHDOWN
        elif before.activity in _ON_GROUND and after.activity in _ON_TETHER:
            kind = TimelineEventKind.LIFT_OFF
        elif before.activity in _ON_GROUND and after.activity is Activity.FLIGHT:
            kind = TimelineEventKind.TAKE_OFF
        elif before.activity is Activity.FLIGHT and after.activity in _ON_GROUND:
            kind = TimelineEventKind.LANDING
        if kind is not None:
            yield TimelineEvent(kind, after.begin_s, after.log_begin)


def _faults(bag: Bag, signals: Signals) -> list[TimelineEvent]:
    """Faults reported by nodes and drives, and brakes that close on a turning drum."""
    reported = list(_reported(bag))
    rate, brake = signals.get("rate"), signals.get("brake")
    if rate is not None and brake is not None:
        # Use the rate just before: the brake may stop the drum within a sample.
        running = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(signals.time), 0.0))])
        before = np.abs(rate)[np.searchsorted(running, running - _BRAKE_DELAY)]
        bites = np.flatnonzero((brake[:-1] > 0.5) & (brake[1:] < 0.5)) + 1
        for index in np.setdiff1d(bites, signals.starts).tolist():
            if before[index] > _BRAKED:
                when = float(signals.time[index])
                why = f"the brake closed at {before[index]:.3f} m/s"
                reported.append(
                    TimelineEvent(TimelineEventKind.FAULT, when, int(signals.log_ns[index]), why)
                )
    reported.sort(key=lambda event: event.log_ns)
    found: list[TimelineEvent] = []
    for event in reported:
        same = found and found[-1].kind is event.kind
        if same and abs(event.time_s - found[-1].time_s) < _SAME_FAULT:
            reasons = [*found[-1].reason.split("; "), event.reason]
            text = "; ".join(dict.fromkeys(reasons))
            found[-1] = replace(found[-1], reason=text)
        else:
            found.append(event)
    return found


_SEVERITIES = {
    Level.WARN.name.lower(): TimelineEventKind.WARNING,
    Level.ERROR.name.lower(): TimelineEventKind.FAULT,
}
_FAULT_WORDS = (
    (topics.WINCH_MODE, WinchMode.FAULT),
    (topics.JUMP_PHASE, JumpPhase.FAULT),
)


def _reported(bag: Bag) -> Iterator[TimelineEvent]:
    for entry in entries_of(bag.series(topics.EVENTS)):
        kind = _SEVERITIES.get(entry.level)
        if kind is not None:
            text = f"{entry.name}: {entry.message}"
            yield TimelineEvent(kind, entry.time_s, entry.log_ns, text)
    for name, fault in _FAULT_WORDS:
        series = bag.series(name)
        if series is not None:
            for time, log_ns, word in zip(series.time, series.log_ns, series.texts, strict=True):
                if word == fault:
                    text = f"{name} is fault"
                    yield TimelineEvent(TimelineEventKind.FAULT, float(time), int(log_ns), text)
