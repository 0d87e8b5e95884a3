"""Simulated mother machine on the contract: clock, drum, drive and sensors around a reduced hoist.

Each tick it publishes time and sensors, and waits for the winch's command of that tick, so that a
busy computer slows simulated time but does not change the result. Its drive is the simulator's,
with watchdog and quick stop.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ros_messages import message_of
from winch_hoist import TICK, TICK_NS, Hoist, Readings

from msg_schemas import topics
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal
from msg_schemas.samples import ClockSample, JointSample, JointValue, WrenchSample
from msg_schemas.table import (
    JUMP_MOTOR,
    WHEEL_MOTOR,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_MOTOR,
)
from rover_sim.devices.actuators import Actuators, DriveFeedback
from rover_sim.devices.equipment import Equipment, QuickStopDecelerations
from rover_verify.harness import Observer
from tether_winch.servo import DriveCommand

PATIENCE = 10.0  # timeout for the answer of a responsive node [s]
ANSWER = 0.05  # timeout for a node that missed the last tick [s]
LOST = 0.002  # timeout for a dead node [s]
DECELERATION = 0.4  # of the drive's quick stop [m/s^2]
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
        self._drive = Actuators(
            Equipment("hoist", quick_stop=QuickStopDecelerations(DECELERATION)), TICK_NS
        )
        self._accepted_ns = 0  # stamp of the drive's last command
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
        """Command that the drive executes in this tick."""
        last = self.history[-1][1] if self.history else None
        feedback = DriveFeedback(PlantPhase.HANGING)
        if last is not None:
            feedback = feedback._replace(
                length=last.length, payout_rate=last.rate, brake_closed=not last.brake_is_open
            )
        sample = self._commands.last
        if sample is not None and sample.stamp_ns != self._accepted_ns:
            self._accepted_ns = sample.stamp_ns
            with suppress(Refusal):
                self._drive.accept_command(topics.WINCH_COMMAND, sample, feedback, self.now_ns)
        self._drive.step(feedback, self.now_ns)
        command = self._drive.command.winch
        if command is None:
            return None
        return DriveCommand(
            command.length,
            command.rate,
            command.feed_forward,
            command.brake_released,
            command.max_tension,
        )

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
            message = self.spoil(name, message_of(name, sample))
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
