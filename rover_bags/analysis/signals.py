"""Sensor signals of several topics, resampled at common instants."""

from __future__ import annotations

import bisect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from msg_schemas.events import SimulationEvent
from rover_bags.analysis.entries import entries_of
from rover_bags.reading.read import Bag, Floats, Stamps, TimeSeries

Flags = NDArray[np.bool_]

_FINEST: Final = 0.02
"""Smallest time between instants [s]."""
_MAX_AGE: Final = 1.0
"""Validity of a sensor's last value [s]; or five of its periods, if longer."""
_SWITCHES: Final = (
    machine.FLOOR_SWITCH,
    machine.WHEEL_LEFT,
    machine.WHEEL_RIGHT,
    machine.BODY_SWITCH,
)
_BASES: Final = (
    topics.CONTACT,
    topics.WINCH_STATE,
    topics.TRUTH_BODY1,
    topics.IMU,
    topics.JUMP_MOTOR_STATE,
)
_NUMBERS: Final[Mapping[str, tuple[str, str]]] = {
    "length": (topics.WINCH_STATE, f"{machine.WINCH_DRUM}.position"),
    "rate": (topics.WINCH_STATE, f"{machine.WINCH_DRUM}.velocity"),
    "brake": (topics.WINCH_STATE, f"{machine.WINCH_BRAKE}.position"),
    "left": (topics.WHEEL_STATE, f"{machine.WHEEL_LEFT}.velocity"),
    "right": (topics.WHEEL_STATE, f"{machine.WHEEL_RIGHT}.velocity"),
    "wheel_current": (topics.MOTOR_CURRENTS, f"{machine.WHEEL_MOTOR}.effort"),
    "nut": (topics.JUMP_MOTOR_STATE, f"{machine.JUMP_SCREW}.position"),
    "nut_force": (topics.JUMP_MOTOR_STATE, f"{machine.JUMP_SCREW}.effort"),
}


@dataclass(frozen=True)
class Signals:
    """Sensor signals at common instants, shape (N,) each; None if not recorded.

    Attributes:
        time: Simulated time [s]; it decreases where the clock was reset.
        log_ns: Reception of the instants' messages [ns since 1970].
        in_contact: Whether any contact switch is closed.
        pull: Tether force on the rover [N].
        numbers: Tether length [m] and rate [m/s] at the drum, brake (1 released), wheel rates
            [rad/s], wheel motor current [A], nut position [m] and force [N]; NaN where the last
            value is too old.
        phase: Phase published by the plant.
        starts: Indices of the first instants after a reset of clock or plant, shape (R,).
    """

    time: Floats
    log_ns: Stamps
    in_contact: Flags | None
    pull: Floats | None
    numbers: Mapping[str, Floats]
    phase: NDArray[np.str_] | None
    starts: NDArray[np.intp]

    def get(self, name: str) -> Floats | None:
        """Return one of the numbers, or None if it is not recorded."""
        return self.numbers.get(name)


def signals_of(bag: Bag) -> Signals | None:
    """Return the bag's signals, or None if it holds no topic of rover or winch."""
    base = next((series for name in _BASES if (series := bag.series(name)) is not None), None)
    if base is None:
        return None
    chosen = _spaced(base.time)
    time, log_ns = base.time[chosen], base.log_ns[chosen]
    matcher = _Matcher(base, chosen)
    numbers = {}
    for name, (topic, path) in _NUMBERS.items():
        series = bag.series(topic)
        if series is not None and path in series.columns:
            numbers[name] = matcher.last(series, series.columns[path])
    return Signals(
        time=time,
        log_ns=log_ns,
        in_contact=_in_contact(bag, matcher),
        pull=_pull(bag, matcher),
        numbers=numbers,
        phase=_phase(bag, matcher),
        starts=run_starts(bag, time, log_ns),
    )


def run_starts(bag: Bag, time: Floats, log_ns: Stamps) -> NDArray[np.intp]:
    """Return the indices of the first messages after a reset of the clock or of the plant.

    Args:
        bag: Its events hold the resets of the plant, after which simulated time goes on.
        time: Simulated time of the messages [s], shape (N,).
        log_ns: Reception of the messages [ns since 1970], shape (N,).
    """
    starts = (np.flatnonzero(np.diff(time) < 0.0) + 1).tolist()
    edges = [0, *starts, len(time)]
    for entry in entries_of(bag.series(topics.EVENTS)):
        if entry.name == SimulationEvent.PLANT_RESET:
            run = bisect.bisect_right(starts, entry.log_ns, key=lambda at: log_ns[at])
            begin, end = edges[run : run + 2]
            after = begin + int(np.searchsorted(time[begin:end], entry.time_s + 1e-9, side="right"))
            # The plant's start has the stamp of the state before it.
            after -= int(after > begin + 1 and time[after - 1] - time[after - 2] < 1e-9)
            starts += [after] if begin < after < end else []
    return np.unique(np.array(starts, dtype=np.intp))


class _Matcher:
    """Finds a series' last value at given instants, by stamp or after a reset by reception."""

    def __init__(self, base: TimeSeries, chosen: NDArray[np.intp]) -> None:
        self._by_time = bool((np.diff(base.time) >= 0.0).all())
        self._time = base.time[chosen] + 1e-9
        self._log = base.log_ns[chosen]

    def last(self, series: TimeSeries, values: Floats) -> Floats:
        """Last value at each instant, the first value before it; NaN if it is too old."""
        index = self.indices(series)
        found = np.array(values[index], dtype=np.float64)
        if self._follows(series):
            typical = float(np.median(np.diff(series.time))) if len(series) > 1 else 0.0
            apart = np.abs(self._time - series.time[index])
        else:
            typical = float(np.median(np.diff(series.log_ns))) * 1e-9 if len(series) > 1 else 0.0
            apart = np.abs(self._log - series.log_ns[index]) * 1e-9
        found[apart > max(_MAX_AGE, 5.0 * typical)] = np.nan
        return found

    def indices(self, series: TimeSeries) -> NDArray[np.intp]:
        if self._follows(series):
            found = np.searchsorted(series.time, self._time, side="right")
        else:
            found = np.searchsorted(series.log_ns, self._log, side="right")
        return np.maximum(found - 1, 0)

    def _follows(self, series: TimeSeries) -> bool:
        return self._by_time and bool((np.diff(series.time) >= 0.0).all())


def _spaced(time: Floats) -> NDArray[np.intp]:
    """Indices of samples spaced by at least `_FINEST`."""
    typical = float(np.median(np.diff(time))) if len(time) > 1 else _FINEST
    every = max(1, round(_FINEST / typical)) if typical > 0.0 else 1
    return np.arange(0, len(time), every)


def _in_contact(bag: Bag, matcher: _Matcher) -> Flags | None:
    series = bag.series(topics.CONTACT)
    if series is None:
        return None
    closed = np.zeros(len(series), dtype=bool)
    for name in _SWITCHES:
        column = series.columns.get(f"{name}.position")
        if column is not None:
            closed |= column > 0.5
    return matcher.last(series, closed.astype(np.float64)) > 0.5


def _pull(bag: Bag, matcher: _Matcher) -> Floats | None:
    series = bag.series(topics.ROVER_LOAD_CELL)
    if series is None:
        return None
    return matcher.last(series, np.linalg.norm(series.vector("force"), axis=1))


def _phase(bag: Bag, matcher: _Matcher) -> NDArray[np.str_] | None:
    series = bag.series(topics.TRUTH_PHASE)
    if series is None:
        return None
    return np.array(series.texts)[matcher.indices(series)]


# --- runs of equal values -----------------------------------------------------------------------


def runs(flags: NDArray[np.generic]) -> list[tuple[int, int]]:
    """Return first and last index of each run of equal values."""
    if not len(flags):
        return []
    edges = np.flatnonzero(flags[1:] != flags[:-1]) + 1
    begins = np.concatenate([[0], edges])
    ends = np.concatenate([edges, [len(flags)]]) - 1
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def closed(flags: Flags, time: Floats, longest: float) -> Flags:
    """Morphological closing: fill gaps of at most `longest` seconds."""
    filled = flags.copy()
    for begin, end in runs(flags):
        inside = begin > 0 and end + 1 < len(flags)
        if inside and not flags[begin] and 0.0 <= time[end + 1] - time[begin] <= longest:
            filled[begin : end + 1] = True
    return filled


def opened(flags: Flags, time: Floats, shortest: float) -> Flags:
    """Morphological opening: remove runs of less than `shortest` seconds."""
    kept = flags.copy()
    for begin, end in runs(flags):
        after = time[end + 1] if end + 1 < len(time) else time[end]
        if flags[begin] and 0.0 <= after - time[begin] < shortest:
            kept[begin : end + 1] = False
    return kept
