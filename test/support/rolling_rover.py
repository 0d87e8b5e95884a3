"""A rover that rolls as its ratchets allow, with separate slip of each side, and its sensors.

Kinematic and independent of the controller's model: the contact points of the wheels move, and the
pose follows from them. A mother machine holds the tether at a tension.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from msg_schemas import machine
from msg_schemas.phases import WinchMode
from msg_schemas.samples import ImuSample, JointSample, JointValue
from rover_control.drive.drive_controller import DriveController

RADIUS, WHEEL_SPACING, AXLE_OFFSET = 0.15, 0.44, 0.08  # [m]
GRAVITY = 1.62  # [m/s^2]
DENSITY = 0.005  # linear density of the tether [kg/m]
SERVO = 40.0  # bandwidth of the wheel rate [rad/s]


@dataclass
class RollingRover:
    """A rover on a plane below a fairlead.

    Attributes:
        slip: of the left and the right wheel straight ahead.
        turning_slip: of the left wheel in a turn.
        drop: height of the fairlead above the attachment [m].
        gyro_bias: [rad/s].
        seed: of the sensor noise.
        stuck: the wheels turn, the rover does not move.
        blocked: the wheels do not turn.
        obeys: the winch accepts requests.
        roll: inclination of the ground [rad].
        climb: inclination of the ground ahead [rad].
    """

    slip: tuple[float, float] = (0.256, 0.256)
    turning_slip: float = 0.33
    drop: float = 20.0
    gyro_bias: float = 1.7e-3
    seed: int = 0
    stuck: bool = False
    blocked: bool = False
    obeys: bool = True
    on_floor: bool = True
    roll: float = 0.0
    climb: float = 0.0
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    now_ns: int = 1_000_000_000
    mode: str = "hold"
    current: float = 0.6  # of the driven wheels [A]
    rates: tuple[float, float] = (0.0, 0.0)
    angles: tuple[float, float] = (0.0, 0.0)
    travelled: float = 0.0
    requests: list[tuple[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._noise = np.random.default_rng(self.seed)
        self._length = self._distance()
        self._speed = 0.0

    def _distance(self) -> float:
        return math.hypot(self.x, self.y, self.drop)

    @property
    def now(self) -> float:
        """[s]."""
        return self.now_ns * 1e-9

    def step(self, drive: DriveController, h: float = 0.02) -> None:
        """Step the controller, move the rover, and send its sensors' samples to the controller."""
        drives = drive.step(self.now_ns)
        if drives.winch is not None and self.obeys:
            self.requests.append((drives.winch.joint, drives.winch.effort))
            self.mode = "tension" if drives.winch.joint == machine.WINCH_AT_TENSION else "hold"
        self._roll(drives.wheel_rate, h)
        self.now_ns += round(h * 1e9)
        self.send_samples(drive, h)

    def _roll(self, rate: float | None, h: float) -> None:
        setpoint = 0.0 if rate is None or self.blocked else rate
        u, w = self.rates
        u += min(SERVO * h, 1.0) * (setpoint - u)
        w = max(u, 0.0)
        self.rates = (u, w)
        self.angles = (self.angles[0] + u * h, self.angles[1] + w * h)
        left = RADIUS * u * (1.0 - (self.slip[0] if u > 0.0 else self.turning_slip))
        right = RADIUS * w * (1.0 - self.slip[1])
        if self.stuck:
            left = right = 0.0
        self.yaw_rate = (right - left) / WHEEL_SPACING
        middle = self.heading + 0.5 * self.yaw_rate * h
        c, s = math.cos(self.heading), math.sin(self.heading)
        px = self.x + c * AXLE_OFFSET + s * 0.5 * WHEEL_SPACING + right * h * math.cos(middle)
        py = self.y + s * AXLE_OFFSET - c * 0.5 * WHEEL_SPACING + right * h * math.sin(middle)
        self.heading += self.yaw_rate * h
        c, s = math.cos(self.heading), math.sin(self.heading)
        self.x = px - c * AXLE_OFFSET - s * 0.5 * WHEEL_SPACING
        self.y = py - s * AXLE_OFFSET + c * 0.5 * WHEEL_SPACING
        speed = 0.5 * (left + right)
        self._acceleration, self._speed = (speed - self._speed) / h, speed
        self.travelled += abs(speed) * h

    def send_samples(self, drive: DriveController, h: float = 0.02) -> None:
        """Send one sample of every sensor."""
        noise = self._noise.standard_normal(6)
        stamp, root = self.now_ns, math.sqrt(h)
        yaw = getattr(self, "yaw_rate", 0.0)
        gyro = (
            8.7e-5 / root * noise[0],
            8.7e-5 / root * noise[1],
            yaw + self.gyro_bias + 8.7e-5 / root * noise[2],
        )
        forward = getattr(self, "_acceleration", 0.0) + 1e-3 / root * noise[3]
        drive.sensors.on_contact(
            JointSample(stamp, {machine.FLOOR_SWITCH: JointValue(float(self.on_floor))}), stamp
        )
        across = GRAVITY * math.cos(self.climb)
        force = (
            forward + GRAVITY * math.sin(self.climb),
            across * math.sin(self.roll),
            across * math.cos(self.roll),
        )
        drive.sensors.on_imu(ImuSample(stamp, gyro, force), stamp)
        wheels = {
            name: JointValue(angle, rate)
            for name, angle, rate in zip(
                (machine.WHEEL_LEFT, machine.WHEEL_RIGHT), self.angles, self.rates, strict=True
            )
        }
        drive.sensors.on_wheels(JointSample(stamp, wheels), stamp)
        current = math.copysign(self.current, self.rates[0]) if any(self.rates) else 0.0
        currents = {
            machine.JUMP_MOTOR: JointValue(),
            machine.WHEEL_MOTOR: JointValue(effort=current + 0.01 * float(noise[4])),
            machine.WINCH_MOTOR: JointValue(),
        }
        drive.sensors.on_currents(JointSample(stamp, currents), stamp)
        if self.mode == WinchMode.TENSION:
            self._length = self._distance()
        weight = DENSITY * GRAVITY * self._length
        held = (
            drive.tether.parameters.tension_margin if self.mode == WinchMode.TENSION else 0.0
        ) + weight
        estimate = {
            machine.PAYOUT: JointValue(self._length, 0.0),
            machine.STRETCHED: JointValue(self._length, 0.0),
            machine.TENSION: JointValue(1.0, 0.0, held + 0.02 * float(noise[5])),
            machine.TETHER_OUT: JointValue(weight / GRAVITY, 0.0, weight),
            machine.REFERENCE: JointValue(),
        }
        drive.tether.on_mode(self.mode)
        drive.sensors.on_winch_estimate(JointSample(stamp, estimate), stamp)

    def run(self, drive: DriveController, limit: float) -> None:
        """Run until the rover is at rest without a goal, or for a time [s]."""
        ends = self.now + limit
        while self.now < ends:
            self.step(drive)
            if (
                not drive.wheels.is_driving
                and max(map(abs, self.rates)) < 1e-3
                and self.mode == WinchMode.HOLD
            ):
                return
