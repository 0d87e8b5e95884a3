"""Simulated mother machine on the contract: clock, drum, drive and sensors around a reduced hoist.

Each tick it publishes time and sensors, and waits for the winch's command of that tick, so that a
busy computer slows simulated time but does not change the result. Its drive has the contract's
watchdog: it brakes when commands time out.
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

PATIENCE = 10.0  # timeout for the answer of a responsive node [s]
ANSWER = 0.05  # timeout for a node that missed the last tick [s]
LOST = 0.002  # timeout for a dead node [s]
_LOOK = 0.002  # [s]


class Mother:
    """Runs in its own thread after ``begin``.

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
        """Start simulated time."""
        self._thread.start()

    def end(self) -> None:
        """Stop simulated time."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def jump(self, duration: float) -> None:
        """Make the clock jump at the next tick [s]; negative = back."""
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
        """Last readings."""
        return self.history[-1][1]

    def _run(self) -> None:
        while not self._ended.is_set():
            command = self._active_command()
            readings = self.hoist.step(command, TICK)
            self.now_ns += TICK_NS
            if self._jump_ns:
                self.now_ns += self._jump_ns
                self._jump_ns = 0
            self.history.append((self.time, readings, command))
            received = len(self._commands)
            self._publish(readings)
            self._await_answer(received)

    def _active_command(self) -> DriveCommand | None:
        """Command that the drive follows: the last one, while it is fresh."""
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

    def _publish(self, readings: Readings) -> None:
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

    def _await_answer(self, received: int) -> None:
        """Wait for the command of this tick, after `received` earlier commands."""

        def has_arrived() -> bool:
            last = self._commands.last
            return len(self._commands) > received and last.stamp_ns >= self.now_ns

        timeout = PATIENCE if self._is_answered else ANSWER
        self._is_answered = self._await(has_arrived, lambda: LOST if self.is_alone else timeout)

    def _await(self, has_arrived: Callable[[], bool], timeout: Callable[[], float]) -> bool:
        """Wait until an answer has arrived, or a timeout [s]; returns whether it has."""
        pause = threading.Event()
        begun = time.monotonic()
        while not self._ended.is_set():
            if has_arrived():
                return True
            if time.monotonic() - begun > timeout():
                return False
            pause.wait(_LOOK)
        return False
