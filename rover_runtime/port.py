"""The port: all that a component asks of the host that carries it.

``rover_runtime.ros`` implements it with rclpy, ``rover_runtime.loop_host`` in one thread without
ROS. A component speaks to it through the methods of ``Component``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar

from msg_schemas.refusal import Refusal
from msg_schemas.samples import Level, Sample
from msg_schemas.specifications import Topic
from rover_runtime.pacing import Stepper, TimeSource

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

Cancel = Callable[[], None]
"""Closes what a method of the port has opened."""


class Message(NamedTuple):
    """A received message.

    Attributes:
        sender: text of a command's ``header.frame_id``, which names its source; else empty.
        stamp_ns: stamp of a command [ns]; else 0, or that of the sample.
        content: the sample, or why the message holds none.
    """

    sender: str
    stamp_ns: int
    content: Sample | Refusal


class Channel(Protocol):
    """An open topic to send to."""

    @property
    def has_subscribers(self) -> bool:
        """Whether somebody receives what is sent."""

    def send(self, sample: Sample, sender: str) -> None:
        """Send a sample; ``sender`` goes to ``header.frame_id`` unless it is empty.

        Raises:
            Refusal: the sample violates the contract; nothing was sent.
        """

    def close(self) -> None:
        """Close the topic."""


class Work(Protocol[T_co]):
    """A computation that takes longer than a tick."""

    def done(self) -> bool:
        """Whether the result is there."""

    def result(self) -> T_co:
        """Return the result.

        Raises:
            WorkFailed: the computation raised an exception, or its process died or hung.
        """


class Port(Protocol):
    """What a host offers to one component."""

    @property
    def full_name(self) -> str:
        """Name of the component with its namespace."""

    @property
    def token(self) -> str:
        """Text that no other instance of the component has."""

    @property
    def is_simulated(self) -> bool:
        """Whether ``now_ns`` is simulated time."""

    def publish(self, topic: Topic) -> Channel:
        """Open a topic to send to."""

    def subscribe(
        self, topic: Topic, receive: Callable[[Message], None], depth: int | None
    ) -> Cancel:
        """Receive the messages of a topic; ``depth`` overrides the depth of the queue."""

    def serve(self, service: str, answer: Callable[..., tuple[bool, str]]) -> Cancel:
        """Answer the requests of a service; ``answer`` takes one bool if the request has one."""

    def call(self, service: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a Trigger service; returns whether it has a server."""

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> Cancel:
        """Call back with a period [s] of ``now_ns``, or of a clock that no pause stops."""

    def work(self, duration: float, function: Callable[[], T]) -> Work[T]:
        """Compute beside the component; simulated time counts it as ``duration`` [s].

        ``function`` and its result can be pickled: the ROS host computes it in another process.
        """

    def now_ns(self) -> int:
        """Present time [ns]: simulated time or the time of day."""

    def knows_time(self) -> bool:
        """Whether ``now_ns`` is valid: simulated time is unknown before its first message."""

    def steady_ns(self) -> int:
        """Time that never stands still against real hardware [ns]; on the loop host ``now_ns``."""

    def time_stepper(self, source: TimeSource, factor: float) -> Stepper:
        """Advance simulated time by this source, at a real-time factor where there is one."""

    def log(self, level: Level, text: str) -> None:
        """Write to the log."""

    @property
    def ros_node(self) -> Any:
        """The rclpy node that carries the component; None on the loop host."""
