"""A mother machine with the rover that hangs on it, for winch and descent nodes together.

As `winch_mother`, it waits for the answers of both nodes, so that a busy machine makes it slow and
not wrong.
"""

from __future__ import annotations

import math

from hanging_machine import HangingMachine
from winch_hoist import Hoist
from winch_mother import ANSWER, LOST, PATIENCE, Mother

from msg_schemas import topics
from msg_schemas.codecs import encode
from msg_schemas.samples import JointSample
from msg_schemas.table import FLYWHEEL, TOPICS, WHEEL_DRIVE
from rover_verify.checks.winch_rig import TICK, Readings
from rover_verify.harness import Observer
from rover_verify.harness.observer import Feed

_LAG_NS = 60_000_000  # by which the descent's commands may be behind
_ESTIMATE_LAG_NS = 200_000_000  # by which its estimates may be, that it tells ten times a second
_MANY = 40  # ticks without an answer, after which the descent is taken for dead
_COASTING = 3.0  # of a wheel without commands, by its friction [rad/s^2]


class DescentMother(Mother):
    """Runs in a thread of its own from ``begin`` on.

    Attributes:
        descends: whether it drives the flywheel, and may be no further behind than a drive bears.
    """

    def __init__(self, observer: Observer, hoist: Hoist, length: float) -> None:
        super().__init__(observer, hoist)
        self.rover = HangingMachine(length)
        self.descends = False
        self._unanswered = 1  # ticks since the descent was no further behind than it may be
        self._wheel = observer.listen(topics.WHEEL_COMMAND)
        self._flywheel = observer.listen(topics.FLYWHEEL_COMMAND)
        self._estimate = observer.listen(topics.DESCENT_STATE)
        for name in (topics.IMU, topics.WHEEL_STATE, topics.FLYWHEEL_STATE, topics.CAMERA):
            self._publishers[name] = observer.publisher(name)

    def _heeded(self, feed: Feed) -> JointSample | None:
        """The last command of a drive, while it is not too old."""
        sample: JointSample | None = feed.last
        if sample is None:
            return None
        silence = (self.now_ns - sample.stamp_ns) * 1e-9
        return sample if 0.0 <= silence < TOPICS[feed.name].stale.timeout else None

    def _tell(self, readings: Readings) -> None:
        wheel, flywheel = self._heeded(self._wheel), self._heeded(self._flywheel)
        rate = self.rover.wheel_rate
        coasting = math.copysign(max(abs(rate) - _COASTING * TICK, 0.0), rate)
        self.rover.wheel_rate = wheel.joints[WHEEL_DRIVE].velocity if wheel else coasting
        self.rover.flywheel_torque = flywheel.joints[FLYWHEEL].effort if flywheel else 0.0
        self.rover.step(readings.length, readings.rate)
        for name, sample in self.rover.samples(self.now_ns):
            message = self.spoil(name, encode(name, sample))
            if message is not None:
                self._publishers[name].publish(message)
        super()._tell(readings)

    def _await_answer(self, heard: int) -> None:
        super()._await_answer(heard)
        patience = ANSWER if self._unanswered < _MANY else LOST
        if not self._unanswered:
            patience = PATIENCE
        keeps_up = self._await(self._keeps_up, lambda: patience)
        self._unanswered = 0 if keeps_up else self._unanswered + 1

    def _keeps_up(self) -> bool:
        """Whether the descent has heard what it was told but a moment ago."""
        feed, lag_ns = self._estimate, _ESTIMATE_LAG_NS
        if self.descends:
            feed, lag_ns = self._flywheel, _LAG_NS
        return feed.last is not None and self.now_ns - feed.last.stamp_ns <= lag_ns
