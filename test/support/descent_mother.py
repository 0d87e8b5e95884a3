"""Simulated mother machine with a hanging rover, for winch and descent nodes together.

As `winch_mother`, it waits for the commands of both nodes, so that a busy computer slows simulated
time but does not change the result.
"""

from __future__ import annotations

import math

from hanging_machine import HangingMachine
from ros_messages import message_of
from winch_hoist import TICK, Hoist, Readings
from winch_mother import ANSWER, LOST, PATIENCE, Mother

from msg_schemas import topics
from msg_schemas.samples import JointSample
from msg_schemas.table import FLYWHEEL, TOPICS, WHEEL_DRIVE
from rover_verify.harness import Observer
from rover_verify.harness.observer import Feed

_LAG_NS = 60_000_000  # largest delay of the descent commands
_ESTIMATE_LAG_NS = 200_000_000  # largest delay of its estimates, published at 10 Hz
_MANY = 40  # ticks without an answer after which the descent counts as dead
_COASTING = 3.0  # deceleration of a wheel without commands, by friction [rad/s^2]


class DescentMother(Mother):
    """Runs in its own thread after ``begin``.

    Attributes:
        descends: whether the descent drives the flywheel; its delay is then limited.
    """

    def __init__(self, observer: Observer, hoist: Hoist, length: float) -> None:
        super().__init__(observer, hoist)
        self.rover = HangingMachine(length)
        self.descends = False
        self._unanswered = 1  # ticks since the descent was last in time
        self._wheel = observer.listen(topics.WHEEL_COMMAND)
        self._flywheel = observer.listen(topics.FLYWHEEL_COMMAND)
        self._estimate = observer.listen(topics.DESCENT_STATE)
        for name in (topics.IMU, topics.WHEEL_STATE, topics.FLYWHEEL_STATE, topics.CAMERA):
            self._publishers[name] = observer.publisher(name)

    def _fresh_command(self, feed: Feed) -> JointSample | None:
        """Last command of a drive, while it is fresh."""
        sample: JointSample | None = feed.last
        if sample is None:
            return None
        age = (self.now_ns - sample.stamp_ns) * 1e-9
        return sample if 0.0 <= age < TOPICS[feed.name].stale.timeout else None

    def _publish(self, readings: Readings) -> None:
        wheel, flywheel = self._fresh_command(self._wheel), self._fresh_command(self._flywheel)
        rate = self.rover.wheel_rate
        coasting = math.copysign(max(abs(rate) - _COASTING * TICK, 0.0), rate)
        self.rover.wheel_rate = wheel.joints[WHEEL_DRIVE].velocity if wheel else coasting
        self.rover.flywheel_torque = flywheel.joints[FLYWHEEL].effort if flywheel else 0.0
        self.rover.step(readings.length, readings.rate)
        for name, sample in self.rover.samples(self.now_ns):
            message = self.spoil(name, message_of(name, sample))
            if message is not None:
                self._publishers[name].publish(message)
        super()._publish(readings)

    def _await_answer(self, received: int) -> None:
        super()._await_answer(received)
        timeout = ANSWER if self._unanswered < _MANY else LOST
        if not self._unanswered:
            timeout = PATIENCE
        keeps_up = self._await(self._keeps_up, lambda: timeout)
        self._unanswered = 0 if keeps_up else self._unanswered + 1

    def _keeps_up(self) -> bool:
        """Whether the descent keeps up with simulated time."""
        feed, lag_ns = self._estimate, _ESTIMATE_LAG_NS
        if self.descends:
            feed, lag_ns = self._flywheel, _LAG_NS
        return feed.last is not None and self.now_ns - feed.last.stamp_ns <= lag_ns
