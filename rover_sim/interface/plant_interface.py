"""Protocol that connects a plant to the contract: its drives, and the samples of its topics.

Each plant model has one implementation. Pure: no ROS, no clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from msg_schemas.samples import DrawingSample, Sample
from rover_sim.devices.actuators import DriveFeedback
from rover_sim.devices.equipment import Equipment
from rover_sim.plants.plant import Plant, State, StepResult

S = TypeVar("S", bound=State)


class PlantInterface(Protocol[S]):
    """Drives and topics of a plant whose states are of type S."""

    @property
    def plant(self) -> Plant[S]:
        """The plant."""

    @property
    def equipment(self) -> Equipment:
        """The drives of the plant."""

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the plant; without a rover, none of the rover."""

    @property
    def available_after_tick(self) -> frozenset[str]:
        """Those topics that need a preceding tick, such as an accelerometer's."""

    def drive_feedback(self, state: S) -> DriveFeedback:
        """Return the state of the drives."""

    def restart(self, state: S, stamp_ns: int) -> None:
        """Set a state without a preceding tick; resets the sensors."""

    def measure(self, state: S, stamp_ns: int, result: StepResult) -> None:
        """Set the state at the end of a tick, and step the sensors over the tick.

        Args:
            state: the successor of the last one.
            stamp_ns: its simulated time.
            result: of the step.
        """

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of the last state for the topics that are due."""

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        """Return the drawing of the static environment.

        Args:
            stamp_ns: of the drawing.
        """
