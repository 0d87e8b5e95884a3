"""Sensors and drives of a simulated hanging rover, for the descent controller."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hanging_model import HangingModel
from winch_hoist import TICK

from msg_schemas import machine, topics
from msg_schemas.samples import ImuSample, JointSample, JointValue, Sample, Vector
from rover_control.hanging.attitude import RotorParameters
from rover_control.hanging.hanging_rover import HangingParameters

WALL = 3.0  # distance [m]
_CAMERA_EVERY = 10  # ticks


class HangingMachine:
    """Wheels and flywheel follow their commands and react on the rover.

    Args:
        length: of the tether [m].
        swing: initial displacement along x, at rest [rad].

    Attributes:
        wheel_rate: of the left wheel [rad/s].
        flywheel_torque: [N m].
        screw: screw angle [rad].
        stance: specific force of the rover while it stands on a slope [m/s^2]; None = it hangs.
    """

    def __init__(self, length: float, swing: float = 0.0) -> None:
        self.wheel_rate = 0.0
        self.flywheel_torque = 0.0
        self.stance: Vector | None = None
        self._hanging = HangingParameters()
        self._model = HangingModel(self._hanging, length, swing, 0.0, swing)
        self._wheel = 0.0
        self.screw = RotorParameters().screw_travel_centre
        self._rate = 0.0
        self._ticks = 0

    def step(self, length: float, payout_rate: float) -> None:
        """Advance by a tick at a payout [m] and payout rate [m/s]."""
        self._model.length, self._model.payout_rate = length, payout_rate
        friction = RotorParameters().flywheel_friction * math.tanh(self._rate)
        turning = self.flywheel_torque - friction
        self._rate += TICK * turning / self._hanging.flywheel_inertia
        self.screw += TICK * self._rate
        rolling = self._hanging.wheel_inertia * (self.wheel_rate - self._wheel) / TICK
        self._wheel = self.wheel_rate
        self._gyro, self._force = self._model.step((turning, rolling))
        self._ticks += 1

    def samples(self, stamp_ns: int) -> Iterator[tuple[str, Sample]]:
        """Sensor samples by topic; the smear encodes the time [px = 1000 s]."""
        standing = ((0.0, 0.0, 0.0), self.stance) if self.stance is not None else None
        yield topics.IMU, ImuSample(stamp_ns, *(standing or (self._gyro, self._force)))
        left, right = JointValue(0.0, self._wheel), JointValue()
        yield (
            topics.WHEEL_STATE,
            JointSample(stamp_ns, {machine.WHEEL_LEFT: left, machine.WHEEL_RIGHT: right}),
        )
        turning = JointValue(self.screw, self._rate)
        yield topics.FLYWHEEL_STATE, JointSample(stamp_ns, {machine.FLYWHEEL: turning})
        if self._ticks % _CAMERA_EVERY == 0:
            seen = {
                machine.WALL_DISTANCE: JointValue(WALL),
                machine.SMEAR: JointValue(stamp_ns * 1e-12),
            }
            yield topics.CAMERA, JointSample(stamp_ns, seen)
