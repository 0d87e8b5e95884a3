"""Which sources of the machine's data are dead: no samples arrive any more, or time stands still.

A source is dead when its topic brought nothing for ``DEAD_AFTER`` by a steady clock and, as a
simulation may be slow or paused, for five of its periods by machine time. A clock that stands still
without a pause, and two sources of one clock, are faults of the plant.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.table import find_topic

DEAD_AFTER = 0.7
"""Least time without a sample after which its source is dead [s]."""

SILENT_AFTER = 3.0
"""A node whose health report (1 Hz) is missing for longer is silent [s]."""

PERIODS = 5.0
"""Missed samples of a topic until it is stale."""

_ALTERNATION = 2.0  # a clock that goes back so often within this time has two sources [s]
_ALTERNATIONS = 3  # more than an operator resets it
_LONGEST_STEP = 5.0  # of the clock of a slow simulation [s]
_STEPS = 2.0  # missed steps until such a clock stands still
_RECENT = 3  # steps by which it is known
_PLANT = (topics.SIM_STATUS, topics.WINCH_STATE, topics.LINK_STATUS)
_BY_WALL_CLOCK = frozenset({topics.SIM_STATUS, topics.LINK_STATUS})


@dataclass(frozen=True)
class Danger:
    """A dead, stopped or contradictory part, without which nothing may be moved.

    Attributes:
        part: plant, winch or link.
        text: what is wrong, for people.
    """

    part: str
    text: str


class Liveness:
    """Arrivals of the topics and the course of the clock.

    Args:
        patience: gap between samples up to which every source lives [s].
    """

    def __init__(self, patience: float = DEAD_AFTER) -> None:
        self._patience = patience
        self._arrivals: dict[str, tuple[float, float]] = {}  # steady and machine time [s]
        self._clock: float | None = None  # [s]
        self._moved = math.inf  # steady time at which the clock moved or was paused last [s]
        self._steps: deque[float] = deque(maxlen=_RECENT)  # between its moves, steady time [s]
        self._backward: deque[float] = deque(maxlen=_ALTERNATIONS)  # steady times [s]
        self.is_paused = False

    @property
    def has_plant(self) -> bool:
        """Whether anything was received from a plant."""
        return any(topic in self._arrivals for topic in _PLANT)

    def on_sample(self, topic: str, now: float) -> None:
        """Process the arrival of a sample at a steady time [s]."""
        self._arrivals[topic] = now, self._machine_time(now)

    def on_clock(self, stamp_ns: int, now: float) -> None:
        """Process simulated time [ns]."""
        time = stamp_ns * 1e-9
        if self._clock is not None and time < self._clock:
            self._backward.append(now)
            self._arrivals = {
                topic: (at, min(machine_at, time))
                for topic, (at, machine_at) in self._arrivals.items()
            }
        if time != self._clock:
            if self._clock is not None:
                self._steps.append(min(now - self._moved, _LONGEST_STEP))
            self._clock, self._moved = time, now

    def on_pause(self, is_paused: bool, now: float) -> None:
        """Process the plant's report whether simulated time is paused."""
        self.is_paused = is_paused
        if is_paused and self._clock is not None:
            self._moved = now
            # Samples may have arrived before the last reading of the clock, up to a batch earlier.
            self._arrivals |= {
                topic: (at, self._clock)
                for topic, (at, _) in self._arrivals.items()
                if self.dead_for(topic, now) is None
            }

    def _machine_time(self, now: float) -> float:
        """Simulated time [s], or steady time without a clock."""
        return now if self._clock is None else self._clock

    def dead_for(self, topic: str, now: float) -> float | None:
        """Time since the last sample of a dead topic [s]; None = it lives or was never received."""
        if topic not in self._arrivals:
            return None
        at, machine_at = self._arrivals[topic]
        age, rate = now - at, find_topic(topic).rate
        missed = PERIODS / rate if rate else SILENT_AFTER
        by_machine = topic not in _BY_WALL_CLOCK and self._still_for(now) == 0.0
        passed = self._machine_time(now) - machine_at if by_machine else age
        return age if age > self._patience and passed > missed else None

    def fault_of_time(self, now: float) -> str:
        """What is wrong with simulated time, for people; empty = nothing."""
        often = len(self._backward) == _ALTERNATIONS
        if often and now - self._backward[0] < _ALTERNATION:
            return f"two plants publish {topics.CLOCK}: end one of them"
        still = self._still_for(now)
        return f"simulated time stands still for {still:.0f} s without a pause" if still else ""

    def _still_for(self, now: float) -> float:
        """Time for which the clock stands still without a pause [s]; 0 = it runs."""
        still = now - self._moved
        # All of the last steps are long in a slow simulation, one of them on a busy machine.
        step = min(self._steps, default=0.0)
        return still if still > max(self._patience, _STEPS * step) else 0.0
