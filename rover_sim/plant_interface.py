"""How a plant meets the contract: which drives it has, and what it tells on which topics.

There is one implementation for each model of plant. All of it is pure: no ROS, no clock of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from msg_schemas.samples import DrawingSample, Sample
from rover_sim.actuators import DriveFeedback, Equipment
from rover_sim.plant import Plant, State, StepResult

S = TypeVar("S", bound=State)


class PlantInterface(Protocol[S]):
    """The outside of a plant whose states are of type S."""

    @property
    def plant(self) -> Plant[S]:
        """What is inside."""

    @property
    def equipment(self) -> Equipment:
        """The drives that there are."""

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that can be told: without a rover there is nothing of a rover."""

    @property
    def available_after_tick(self) -> frozenset[str]:
        """Those of them that can be told only after a tick, as an accelerometer's."""

    def drive_feedback(self, state: S) -> DriveFeedback:
        """What the drives feel."""

    def restart(self, state: S, stamp_ns: int) -> None:
        """Take a state with no tick before it: sensors begin anew."""

    def measure(self, state: S, stamp_ns: int, result: StepResult) -> None:
        """Take the state at a tick's end; sensors measure what the tick did.

        Args:
            state: follows the one taken before.
            stamp_ns: its simulated time.
            result: what the step reported.
        """

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of what was last taken, for the topics that are due."""

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        """What stands around the plant, to be looked at; nothing changes it.

        Args:
            stamp_ns: to be drawn with.
        """
