"""A mother machine of the test's own: clock, drum, drive and sensors, around a reduced hoist.

It speaks by the contract and keeps simulated time: each tick it tells time and sensors, and waits
for the winch's command of that tick, so that a busy machine makes it slow and not wrong. Its drive
has the contract's watchdog: it brakes when commands stay away.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from winch_hoist import Hoist

from msg_schemas import topics
from msg_schemas.codecs import encode
from msg_schemas.samples import ClockSample, JointSample, JointValue, WrenchSample
from msg_schemas.table import (
    JUMP_MOTOR,
    TOPICS,
    WHEEL_MOTOR,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
    WINCH_MOTOR,
)
from rover_verify.checks.winch_rig import TICK, TICK_NS, Readings
from rover_verify.harness import Observer
from tether_winch.servo import DriveCommand

PATIENCE = 10.0  # the answer of a node that answers is waited for so long [s]
ANSWER = 0.05  # the same of one that did not answer the last tick [s]
LOST = 0.002  # the same of one that is known to be dead [s]
_LOOK = 0.002  # [s]


class Mother:
    """Runs in a thread of its own from ``begin`` on, or is stepped.

    Attributes:
        spoil: changes each message before it is sent, or drops it by returning None.
        history: time [s], readings, and whether the drive had a command, of every tick.
    """

    def __init__(self, observer: Observer, hoist: Hoist) -> None:
        self.hoist = hoist
        self.now_ns = 1_000_000_000
        self.is_alone = False
        self.spoil: Callable[[str, Any], Any] = lambda _topic, message: message
        self.history: list[tuple[float, Readings, DriveCommand | None]] = []
        self._observer = observer
        self._commands = observer.listen(topics.WINCH_COMMAND)
        self._publishers = {
            name: observer.publisher(name)
            for name in (topics.CLOCK, topics.WINCH_STATE, topics.LOAD_CELL, topics.MOTOR_CURRENTS)
        }
        self._is_answered = False  # of the last tick
        self._jump_ns = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.now_ns * 1e-9

    def begin(self) -> None:
        """Let time run."""
        self._thread.start()

    def end(self) -> None:
        """Stop time."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def jump(self, duration: float) -> None:
        """Let the clock jump at the next tick [s], below 0 back."""
        self._jump_ns = round(duration * 1e9)

    def wait(self, condition: Callable[[], bool], complaint: str) -> None:
        """Wait until a condition holds while time runs."""
        self._observer.wait_until(condition, complaint)

    def wait_for(self, duration: float) -> None:
        """Wait until so much simulated time has passed [s]."""
        end = self.time + duration
        self.wait(lambda: self.time >= end, f"{duration:g} s of simulated time have not passed")

    @property
    def last(self) -> Readings:
        """What the sensors said last."""
        return self.history[-1][1]

    def _run(self) -> None:
        while not self._ended.is_set():
            command = self._driven()
            readings = self.hoist.step(command, TICK)
            self.now_ns += TICK_NS
            if self._jump_ns:
                self.now_ns += self._jump_ns
                self._jump_ns = 0
            self.history.append((self.time, readings, command))
            heard = len(self._commands)
            self._tell(readings)
            self._await_answer(heard)

    def _driven(self) -> DriveCommand | None:
        """What the drive does: the last command, while it is not too old."""
        sample = self._commands.last
        if sample is None:
            return None
        moves = bool(self.history) and abs(self.history[-1][1].rate) > 1e-3
        stale = TOPICS[topics.WINCH_COMMAND].stale
        oldest = stale.timeout_moving if moves else stale.timeout
        if not 0.0 <= (self.now_ns - sample.stamp_ns) * 1e-9 < oldest:
            return None
        drum, brake, limit = (sample.joints[n] for n in (WINCH_DRUM, WINCH_BRAKE, WINCH_LIMIT))
        released = brake.position > 0.5
        return DriveCommand(drum.position, drum.velocity, drum.effort, released, limit.effort)

    def _tell(self, readings: Readings) -> None:
        stamp = self.now_ns
        drum = {
            WINCH_DRUM: JointValue(readings.length, readings.rate, 0.0),
            WINCH_BRAKE: JointValue(float(readings.brake_is_open), 0.0, 0.0),
        }
        currents = {
            JUMP_MOTOR: JointValue(),
            WHEEL_MOTOR: JointValue(),
            WINCH_MOTOR: JointValue(0.0, 0.0, readings.current),
        }
        for name, sample in (
            (topics.WINCH_STATE, JointSample(stamp, drum)),
            (topics.LOAD_CELL, WrenchSample(stamp, (0.0, 0.0, -readings.tension))),
            (topics.MOTOR_CURRENTS, JointSample(stamp, currents)),
            (topics.CLOCK, ClockSample(stamp)),
        ):
            message = self.spoil(name, encode(name, sample))
            if message is not None:
                self._publishers[name].publish(message)

    def _await_answer(self, heard: int) -> None:
        """Wait for the command of this tick, where so many have been heard before it."""

        def has_come() -> bool:
            last = self._commands.last
            return len(self._commands) > heard and last.stamp_ns >= self.now_ns

        patience = PATIENCE if self._is_answered else ANSWER
        self._is_answered = self._await(has_come, lambda: LOST if self.is_alone else patience)

    def _await(self, has_come: Callable[[], bool], patience: Callable[[], float]) -> bool:
        """Wait until an answer has come, or patience has ended [s]."""
        pause = threading.Event()
        begun = time.monotonic()
        while not self._ended.is_set():
            if has_come():
                return True
            if time.monotonic() - begun > patience():
                return False
            pause.wait(_LOOK)
        return False
