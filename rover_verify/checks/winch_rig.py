"""A winch controller on a plant: sensors with their errors, and a record, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from msg_schemas.events import EventReport
from msg_schemas.machine import (
    JUMP_MOTOR,
    WHEEL_MOTOR,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_MOTOR,
    WINCH_TO_LENGTH,
)
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from tether_winch.servo import DriveCommand
from tether_winch.winch import Winch

TICK_NS = 10_000_000  # of controller and sensors
TICK = TICK_NS * 1e-9


class Readings(NamedTuple):
    """Error-free readings of the winch sensors."""

    length: float  # payout [m]
    rate: float  # payout rate [m/s]
    brake_is_open: bool
    current: float  # of the motor [A], > 0 pays out
    tension: float  # at the fairlead [N]


class Rig(Protocol):
    """A plant with a drum."""

    def step(self, command: DriveCommand | None, dt: float) -> Readings:
        """Advance by dt [s] under a command; None = the drive has none."""


@dataclass(frozen=True)
class SensorErrors:
    """How far the sensors are off."""

    cell_noise: float = 0.0  # standard deviation [N]
    cell_bias: float = 0.0  # [N]
    cell_gain: float = 1.0
    rate_noise: float = 0.0  # standard deviation [m/s]
    current_noise: float = 0.0  # standard deviation [A]


class Tick(NamedTuple):
    """One tick as it was."""

    time: float
    length: float
    rate: float
    tension: float
    reference: float  # length reference
    reference_rate: float
    mode: WinchMode
    torque: float  # of the motor [N m]


@dataclass
class Session:
    """A winch controller on a rig, stepped at 100 Hz.

    Attributes:
        ticks: everything that was, if it is kept.
        transitions: reports of the winch, with the time of each.
        requests: length requests, as time, length and rate of each.
    """

    winch: Winch
    rig: Rig
    errors: SensorErrors = SensorErrors()
    generator: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    keeps: bool = True
    now_ns: int = 1_000_000_000
    ticks: list[Tick] = field(default_factory=list)
    transitions: list[tuple[float, EventReport]] = field(default_factory=list)
    requests: list[tuple[float, float, float]] = field(default_factory=list)
    _command: DriveCommand | None = None

    @property
    def time(self) -> float:
        """[s]."""
        return self.now_ns * 1e-9

    def arm(self) -> None:
        """Let the winch hear its sensors, and arm it."""
        self.run(0.1)
        self.winch.rearm(self.now_ns)

    def request(
        self, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
    ) -> None:
        """Send a request."""
        value = JointValue(position, velocity, effort)
        self.winch.request(JointSample(self.now_ns, {joint: value}), self.now_ns)
        if joint == WINCH_TO_LENGTH:
            self.requests.append((self.time, position, velocity))

    def run(self, duration: float) -> None:
        """Go on for so long [s]."""
        for _ in range(round(duration / TICK)):
            self.tick()

    def run_until_rest(self, limit: float) -> None:
        """Go on until the winch has come to rest by itself, or so long [s]."""
        for _ in range(round(limit / TICK)):
            self.tick()
            if self.winch.mode is not WinchMode.LENGTH and self.winch.servo.is_at_rest:
                return

    def tick(self) -> Readings:
        """One tick: plant, sensors, controller."""
        readings = self.rig.step(self._command, TICK)
        self.now_ns += TICK_NS
        self._on_readings(readings)
        self._command = self.winch.step(self.now_ns)
        self.transitions += [(self.time, t) for t in self.winch.take_transitions()]
        if self.keeps:
            reference = self.winch.servo.reference
            self.ticks.append(
                Tick(
                    self.time,
                    readings.length,
                    readings.rate,
                    readings.tension,
                    reference.length,
                    reference.rate,
                    self.winch.mode,
                    readings.current * self.winch.parameters.drum.torque_constant,
                )
            )
        return readings

    def _on_readings(self, readings: Readings) -> None:
        e, noise = self.errors, self.generator.standard_normal(3)
        stamp = self.now_ns
        drum = JointValue(readings.length, readings.rate + e.rate_noise * noise[0], 0.0)
        brake = JointValue(float(readings.brake_is_open), 0.0, 0.0)
        self.winch.on_drum(JointSample(stamp, {WINCH_DRUM: drum, WINCH_BRAKE: brake}), stamp)
        tension = e.cell_gain * readings.tension + e.cell_bias + e.cell_noise * noise[1]
        self.winch.on_load_cell(WrenchSample(stamp, (0.0, 0.0, -float(tension))), stamp)
        current = readings.current + e.current_noise * noise[2]
        currents = {
            JUMP_MOTOR: JointValue(),
            WHEEL_MOTOR: JointValue(),
            WINCH_MOTOR: JointValue(0.0, 0.0, float(current)),
        }
        self.winch.on_currents(JointSample(stamp, currents), stamp)

    def times_of(self, name: str) -> list[float]:
        """Times at which the winch told something by this name."""
        return [time for time, transition in self.transitions if transition.name == name]

    def column(self, name: str) -> NDArray[np.float64]:
        """One quantity over all ticks."""
        return np.array([getattr(tick, name) for tick in self.ticks], dtype=float)
