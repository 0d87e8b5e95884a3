"""Lowers the rover to the floor: fast at first, slowly near the floor."""

import sys
from dataclasses import dataclass

from msg_schemas import machine, topics
from msg_schemas.events import EventName, EventReport
from msg_schemas.parameters import parameter
from msg_schemas.samples import JointSample, JointValue, Level
from rover_runtime.component import Component


@dataclass(frozen=True)
class LanderParameters:
    """Expected depth of the floor, and payout rates."""

    floor: float = parameter(7.3, "m", "smallest payout at touchdown", 1.0, 300.0)
    fast: float = parameter(0.3, "m/s", "payout rate above the floor", 0.01, 0.5)
    slow: float = parameter(0.05, "m/s", "payout rate near the floor", 0.01, 0.1)
    deceleration: float = parameter(0.05, "m/s^2", "from fast to slow", 0.01, 0.5)


class Lander:
    """Computes the payout rate; pure, without ROS."""

    def __init__(self, parameters: LanderParameters) -> None:
        self.parameters = parameters

    def rate(self, length: float, on_ground: bool) -> float:
        """Return the payout rate [m/s] at a payout [m]; 0 on the ground."""
        if on_ground:
            return 0.0
        p = self.parameters
        distance = max(p.floor - length, 0.0)
        return float(min(p.fast, (p.slow**2 + 2.0 * p.deceleration * distance) ** 0.5))


class LanderEvent(EventName):
    """Events of this node."""

    LANDED = "landed", Level.OK, "the rover is on the floor"


class LanderNode(Component):
    """Requests the payout from the winch until the rover is on the ground."""

    NAME = "lander"
    PARAMETERS = (LanderParameters,)

    def setup(self) -> None:
        """Open topics."""
        self._lander = Lander(self.parameters_of(LanderParameters))
        self._length, self._on_ground = 0.0, False
        self._request = self.publisher(topics.WINCH_REQUEST)
        self.subscribe(topics.WINCH_STATE, self._on_winch)
        self.subscribe(topics.CONTACT, self._on_contact)

    def start(self) -> None:
        """Renew the request five times a second; the winch ends it one second after the last."""
        self.every(0.2, self._publish_request)

    def _on_winch(self, sample: JointSample) -> None:
        self._length = sample.joints[machine.WINCH_DRUM].position

    def _on_contact(self, sample: JointSample) -> None:
        if sample.joints[machine.FLOOR_SWITCH].position and not self._on_ground:
            self.event(EventReport(LanderEvent.LANDED, f"on the floor at {self._length:.2f} m"))
            self._on_ground = True

    def _publish_request(self) -> None:
        rate = self._lander.rate(self._length, self._on_ground)
        if rate and self._length:
            setpoint = JointValue(self._length + 2.0 * rate, rate)
            self._request.send(JointSample(self.now_ns(), {machine.WINCH_WHILE_RENEWED: setpoint}))


if __name__ == "__main__":
    from rover_runtime.ros.process import run  # the loop host needs no ROS

    sys.exit(run(LanderNode))
