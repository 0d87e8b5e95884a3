"""The ``winch_node`` executable: holds the drum and watches the tether's tension."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.node import ContractNode, run
from msg_schemas.parameters import parameter
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Level,
    Status,
    TextSample,
    WrenchSample,
)
from msg_schemas.table import MAX_TENSION, SMALLEST_LIMIT, WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT
from tether_winch.tension_watch import TensionChange, TensionParameters, TensionWatch
from tether_winch.winch_hold import WinchHold

_CHECK_PERIOD = 0.1


@dataclass(frozen=True)
class WinchNodeParameters:
    """How the drum is held."""

    command_rate: float = parameter(
        20.0, "Hz", "how often the drum is told", 5.0, 200.0, read_only=True
    )
    tension_limit: float = parameter(
        1000.0, "N", "largest tension that the drive may use", SMALLEST_LIMIT, MAX_TENSION
    )


class WinchNode(ContractNode):
    """Holds the drum where it stands, and tells slack and too much tension by the load cell."""

    NAME = "winch_node"
    PARAMETERS = (WinchNodeParameters, TensionParameters)

    def setup(self) -> None:
        """Open topics."""
        self._command_outlet = self.publisher(topics.WINCH_COMMAND)
        self._watch_outlet = self.publisher(topics.TENSION_WATCH)
        self._begin()
        self.subscribe(topics.WINCH_STATE, self._on_drum)
        self.subscribe(topics.LOAD_CELL, self._on_load_cell)

    def start(self) -> None:
        """Begin to hold and to watch."""
        self._begin()
        self.every(1.0 / self.parameters_of(WinchNodeParameters).command_rate, self._command)
        # By the wall clock: where simulated time has stopped, the load cell is silent too.
        self.every(_CHECK_PERIOD, self._check, by_wall_clock=True)

    def parameters_changed(self) -> None:
        """Watch by the new thresholds; what is held stays."""
        if self.active:
            self._hold.tension_limit = self.parameters_of(WinchNodeParameters).tension_limit
            self._begin_to_watch()

    def clock_jumped(self) -> None:
        """Begin anew: what was timed means nothing any more."""
        if self.active:
            self._begin()

    def health(self) -> tuple[Status, ...]:
        """Tension and what is held."""
        if not self.active:
            return ()
        state, tension, length = self._watch.state, self._watch.tension, self._hold.length
        values = {
            "tension": "" if math.isnan(tension) else repr(tension),
            "held_length": "" if length is None else repr(length),
        }
        statuses = [
            Status(f"{self.NAME}: tension", state.value, state.level, self.NAME, values),
        ]
        if length is None:
            reason = f"{topics.WINCH_STATE} was never heard: the drum is not held"
            statuses.append(Status(f"{self.NAME}: drum", reason, Level.WARN, self.NAME))
        return tuple(statuses)

    def _begin(self) -> None:
        self._hold = WinchHold(self.parameters_of(WinchNodeParameters).tension_limit)
        self._begin_to_watch()

    def _begin_to_watch(self) -> None:
        self._watch = TensionWatch(self.parameters_of(TensionParameters))
        self._heard = time.monotonic()
        self._watch_outlet.send(TextSample(self._watch.state.value))

    def _on_drum(self, sample: JointSample) -> None:
        self._hold.hear(sample)

    def _on_load_cell(self, sample: WrenchSample) -> None:
        self._heard = time.monotonic()
        self._tell(self._watch.hear(sample, self.now_ns()))

    def _check(self) -> None:
        self._tell(self._watch.check(time.monotonic() - self._heard))

    def _command(self) -> None:
        command = self._hold.command()
        if command is not None:
            joints = {
                WINCH_DRUM: JointValue(command.length, command.rate),
                WINCH_BRAKE: JointValue(0.0),
                WINCH_LIMIT: JointValue(effort=command.tension),
            }
            self._command_outlet.send(JointSample(self.now_ns(), joints))

    def _tell(self, change: TensionChange | None) -> None:
        if change is None:
            return
        self._watch_outlet.send(TextSample(change.state.value))
        values = {} if math.isnan(change.tension) else {"tension": change.tension}
        name = f"tension_{change.state.value}"
        self.event(name, change.reason, change.state.level, values)
        if change.state.level is not Level.OK:
            self.report(
                Status(f"{self.NAME}: {name}", change.reason, change.state.level, self.NAME)
            )


def main() -> int:
    """Run the node."""
    return run(WinchNode)


if __name__ == "__main__":
    sys.exit(main())
