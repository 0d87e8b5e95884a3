"""Lowers the rover to the floor: fast at first, slowly where the floor may be."""

import sys
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.machine import FLOOR_SWITCH, WINCH_DRUM, WINCH_WHILE_RENEWED
from msg_schemas.node import ContractNode
from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from msg_schemas.samples import JointSample, JointValue


@dataclass(frozen=True)
class LanderParameters:
    """What is known of the place, and how careful to be."""

    floor: float = parameter(7.3, "m", "least length at which it may stand", 1.0, 300.0)
    fast: float = parameter(0.3, "m/s", "payout rate on the way", 0.01, 0.5)
    slow: float = parameter(0.05, "m/s", "payout rate where the floor may be", 0.01, 0.1)
    slowing: float = parameter(0.05, "m/s^2", "from the one to the other", 0.01, 0.5)


class Lander:
    """Pure: what is heard goes in, what is wanted of the winch comes out."""

    def __init__(self, parameters: LanderParameters) -> None:
        self.parameters = parameters

    def rate(self, length: float, stands: bool) -> float:
        """Payout rate [m/s] at a length [m]; 0 when it is done."""
        if stands:
            return 0.0
        p = self.parameters
        way = max(p.floor - length, 0.0)
        return float(min(p.fast, (p.slow**2 + 2.0 * p.slowing * way) ** 0.5))


class LanderNode(ContractNode):
    """Asks the winch to go on for as long as the rover does not stand."""

    NAME = "lander"
    PARAMETERS = (LanderParameters,)

    def setup(self) -> None:
        """Open topics."""
        self._lander = Lander(self.parameters_of(LanderParameters))
        self._length, self._stands = 0.0, False
        self._request = self.publisher(topics.WINCH_REQUEST)
        self.subscribe(topics.WINCH_STATE, self._on_winch)
        self.subscribe(topics.CONTACT, self._on_contact)

    def start(self) -> None:
        """Ask five times a second: what is not renewed within one, the winch ends by itself."""
        self.every(0.2, self._ask)

    def _on_winch(self, sample: JointSample) -> None:
        self._length = sample.joints[WINCH_DRUM].position

    def _on_contact(self, sample: JointSample) -> None:
        if sample.joints[FLOOR_SWITCH].position and not self._stands:
            self.event("landed", f"it stands at {self._length:.2f} m")
            self._stands = True

    def _ask(self) -> None:
        rate = self._lander.rate(self._length, self._stands)
        if rate and self._length:
            asked = JointValue(self._length + 2.0 * rate, rate)
            self._request.send(JointSample(self.now_ns(), {WINCH_WHILE_RENEWED: asked}))


if __name__ == "__main__":
    sys.exit(run(LanderNode))
