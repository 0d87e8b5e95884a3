"""A winch controller on a reduced hoist, stepped tick by tick, beside a descent's controller."""

from __future__ import annotations

from dataclasses import dataclass, field

from winch_hoist import TICK, TICK_NS, Hoist, Readings

from msg_schemas import machine
from msg_schemas.events import EventReport
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from tether_winch.servo import ServoCommand
from tether_winch.winch import WinchController


@dataclass
class Session:
    """A winch controller on a hoist, stepped at 100 Hz.

    Attributes:
        ticks: readings of each tick.
        transitions: reports of the winch, with the time of each [s].
    """

    winch: WinchController
    hoist: Hoist
    now_ns: int = 1_000_000_000
    ticks: list[Readings] = field(default_factory=list)
    transitions: list[tuple[float, EventReport]] = field(default_factory=list)
    _command: ServoCommand | None = None

    def request(
        self, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
    ) -> None:
        """Send a request."""
        value = JointValue(position, velocity, effort)
        self.winch.request(JointSample(self.now_ns, {joint: value}), self.now_ns)

    def tick(self) -> Readings:
        """One tick: plant, sensors, controller."""
        readings = self.hoist.step(self._command, TICK)
        self.now_ns += TICK_NS
        self._on_readings(readings)
        self._command = self.winch.step(self.now_ns)
        now = self.now_ns * 1e-9
        self.transitions += [(now, each) for each in self.winch.take_transitions()]
        self.ticks.append(readings)
        return readings

    def _on_readings(self, readings: Readings) -> None:
        stamp = self.now_ns
        drum = {
            machine.WINCH_DRUM: JointValue(readings.length, readings.rate),
            machine.WINCH_BRAKE: JointValue(float(readings.brake_is_open)),
        }
        self.winch.sensing.on_drum(JointSample(stamp, drum), stamp)
        self.winch.sensing.on_load_cell(WrenchSample(stamp, (0.0, 0.0, -readings.tension)), stamp)
        currents = {
            machine.JUMP_MOTOR: JointValue(),
            machine.WHEEL_MOTOR: JointValue(),
            machine.WINCH_MOTOR: JointValue(0.0, 0.0, readings.current),
        }
        self.winch.sensing.on_currents(JointSample(stamp, currents), stamp)
