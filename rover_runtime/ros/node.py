"""The ROS host of one component: a lifecycle node that is its port.

With the parameter ``autostart`` (the default) the node configures and activates itself.
``rover_runtime.ros.process`` runs nodes as a process.
"""

from __future__ import annotations

import gc
import secrets
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakSet

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import ROSClock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from rclpy.time import Time

from msg_schemas import qos, topics
from msg_schemas.cdr import pack
from msg_schemas.events import EventReport, NodeEvent
from msg_schemas.message_types import message_class
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal
from msg_schemas.samples import ClockSample, Level, Sample
from msg_schemas.specifications import Intent, Topic
from msg_schemas.table import SERVICES, find_topic
from rover_runtime.batches import STREAMS
from rover_runtime.component import Component, ExitCode, ShutdownRequested
from rover_runtime.pacing import PacedThread, TimeSource
from rover_runtime.periodic_calls import PeriodicCalls
from rover_runtime.port import Cancel, Message, Work
from rover_runtime.ros.batches import BatchPublisher, BatchPublishers
from rover_runtime.ros.clock_guard import ClockGuard
from rover_runtime.ros.delivery import wait_until_acknowledged
from rover_runtime.ros.foreign_callbacks import guard_foreign_callbacks
from rover_runtime.ros.lockstep import LockstepCarrier, read_processes
from rover_runtime.ros.parameters import declare_parameters
from rover_runtime.ros.scheduling import set_realtime_priority
from rover_runtime.ros.subscriptions import Subscriptions
from rover_runtime.ros.timers import steady_timer
from rover_runtime.worker_process import WorkerProcess

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from rclpy.publisher import Publisher

T = TypeVar("T")

_USE_SIM_TIME = "use_sim_time"


@dataclass(frozen=True)
class HostParameters:
    """Parameters that every node has."""

    autostart: bool = parameter(
        True,
        "-",
        "configure and activate at the start; false waits for a lifecycle manager",
        read_only=True,
    )
    realtime_priority: int = parameter(
        0,
        "-",
        "SCHED_RR priority of the process once it is active (Linux only); 0 = normal scheduling",
        0,
        49,  # below the kernel's interrupt threads at 50
        read_only=True,
    )
    lockstep: str = parameter(
        "",
        "-",
        "processes for which simulated time waits, in order, as PROCESS=NODE+NODE,...; empty = "
        "time runs by itself",
        read_only=True,
    )
    delay_seed: int = parameter(
        1, "-", "seed of the messages' delays in lockstep", 0, 2**31 - 1, read_only=True
    )


class RosComponent(Component):
    """A component that the ROS host alone carries, because it uses the graph itself."""

    @property
    def ros(self) -> ComponentNode:
        """The rclpy node."""
        node = self.port.ros_node
        assert isinstance(node, ComponentNode), f"{self.NAME} needs the ROS host"
        return node

    @property
    def is_in_lockstep(self) -> bool:
        """Whether simulated time waits for the component."""
        return bool(self.parameters_of(HostParameters).lockstep)


class _RosChannel:
    """A topic to publish on, and the batch of its node if it is a stream."""

    def __init__(self, node: ComponentNode, row: Topic, batch: BatchPublisher | None) -> None:
        self._node = node
        self._name = row.name
        self._batch = batch
        self._is_clock = row.intent is Intent.CLOCK
        self.publisher = node.create_publisher(
            message_class(row.message), row.name, qos.publisher_profile(row.intent)
        )
        self._full_name = self.publisher.topic_name

    @property
    def has_subscribers(self) -> bool:
        return bool(self.publisher.get_subscription_count()) or (
            self._batch is not None and self._batch.has_subscribers
        )

    def send(self, sample: Sample, sender: str) -> None:
        data = pack(self._name, sample, sender)
        if self._batch is not None:
            self._batch.add(self._full_name, data)
            if self._is_clock:
                # The last message of a tick: on its arrival the batch has arrived.
                self._batch.flush()
        if self._batch is None or self.publisher.get_subscription_count():
            self.publisher.publish(data)

    def close(self) -> None:
        self._node.close_channel(self)


class ComponentNode(LifecycleNode):
    """A lifecycle node that carries a component, and its port.

    Args:
        component_class: what the node does.
        shared: by the nodes of the process.
        node_options: of rclpy's node.

    Raises:
        ParameterError: a parameter override is wrong.
    """

    def __init__(
        self,
        component_class: type[Component],
        shared: Shared | None = None,
        **node_options: Any,
    ) -> None:
        self._shared = Shared() if shared is None else shared
        self._receiving = self._shared.subscriptions
        self._polled: WeakSet[Subscription] = WeakSet()
        try:
            super().__init__(component_class.NAME, **node_options)
        except InvalidParameterTypeException as error:  # of rclpy's own parameters
            raise ParameterError(str(error)) from error
        guard_foreign_callbacks(self, self._refuse_foreign)
        self._clock_guard = ClockGuard(self)
        self._failure: Exception | None = None
        self._token = secrets.token_hex(4)
        self._calls = PeriodicCalls()  # by simulated time
        self._is_simulated = bool(self.get_parameter(_USE_SIM_TIME).value)
        self._has_slow_clock = component_class.RECEIVES_WITH_CALLS
        self._simulated_ns = 0
        self._has_reading = False  # of simulated time
        self._stop_clock: Cancel | None = None
        self._channels: list[_RosChannel] = []
        self._service_clients: dict[str, Any] = {}
        self._worker: WorkerProcess | None = None
        groups = declare_parameters(self, parameter_classes(component_class))
        self._host_parameters: HostParameters = groups[HostParameters]
        carrier = None
        if self._host_parameters.lockstep and shared is not None:
            carrier = shared.carrier_of(self, self._host_parameters)
        if carrier is None and self._is_simulated:
            self._stop_clock = self._follow_clock()
        self.component = (
            component_class(self, groups)
            if carrier is None
            else carrier.add(self, component_class, groups, self.log)
        )
        self.add_on_set_parameters_callback(self._on_set_parameters)

    # --- the port --------------------------------------------------------------------------------

    @property
    def full_name(self) -> str:
        """Name with the namespace."""
        return str(self.get_fully_qualified_name())

    @property
    def token(self) -> str:
        """Text that no other process has."""
        return self._token

    @property
    def is_simulated(self) -> bool:
        """Whether the node follows simulated time."""
        return self._is_simulated

    @property
    def ros_node(self) -> ComponentNode:
        """This node."""
        return self

    def publish(self, topic: Topic) -> _RosChannel:
        """Create a publisher."""
        is_stream = topic.name in STREAMS
        batch = self._shared.batches.join(self, topic.name) if is_stream else None
        channel = _RosChannel(self, topic, batch)
        self._channels.append(channel)
        return channel

    def close_channel(self, channel: _RosChannel) -> None:
        """Remove a publisher from the graph."""
        self._channels.remove(channel)
        self.destroy_publisher(channel.publisher)

    def subscribe(
        self, topic: Topic, receive: Callable[[Message], None], depth: int | None
    ) -> Cancel:
        """Subscribe together with the other components of the process."""
        by_clock = self._stop_clock is not None
        return self._receiving.open(
            self, topic, receive, depth, by_clock=by_clock, newest=self._has_slow_clock
        )

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that the executor attends to."""
        yield from (
            each
            for each in super().subscriptions
            if each not in self._polled and not self._receiving.is_polled(each)
        )

    def poll(self, subscription: Subscription) -> None:
        """Take the messages of a subscription without the executor."""
        self._polled.add(subscription)

    def serve(self, service: str, answer: Callable[..., tuple[bool, str]]) -> Cancel:
        """Create a service."""

        def respond(request: Any, response: Any) -> Any:
            arguments = (bool(request.data),) if hasattr(request, "data") else ()
            response.success, response.message = answer(*arguments)
            return response

        kind = message_class(SERVICES[service].service)
        created = self.create_service(kind, service, respond)
        return lambda: _ignore(self.destroy_service(created))

    def call(self, service: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a service if its server is known."""
        if service not in self._service_clients:
            kind = message_class(SERVICES[service].service)
            self._service_clients[service] = self.create_client(kind, service)
        client = self._service_clients[service]
        if not client.service_is_ready():
            return False

        def report_answer(future: Any) -> None:
            if future.exception() is None:
                answered(future.result().success, future.result().message)

        client.call_async(client.srv_type.Request()).add_done_callback(report_answer)
        return True

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> Cancel:
        """Call back by a timer, or by the received clock."""
        if self._is_simulated and not by_wall_clock:
            return self._calls.add(round(period * 1e9), callback, self.now_ns())
        if by_wall_clock and self._has_slow_clock:
            callback = partial(self._receiving.call, callback)
        timer = steady_timer(self, period, callback)
        return lambda: _ignore(self.destroy_timer(timer))

    def work(self, duration: float, function: Callable[[], T]) -> Work[T]:
        """Compute in a process; its own time counts."""
        del duration
        if self._worker is None:
            self._worker = WorkerProcess()
        return self._worker.submit(function)

    def now_ns(self) -> int:
        """Reading of the node's clock [ns]."""
        return self._simulated_ns if self._is_simulated else time.time_ns()

    def knows_time(self) -> bool:
        """Whether the node's clock has a reading."""
        return not self._is_simulated or self._has_reading

    def steady_ns(self) -> int:
        """Reading of the computer's steady clock [ns]."""
        return time.monotonic_ns()

    def time_stepper(self, source: TimeSource, factor: float) -> PacedThread:
        """Advance simulated time in a thread, paced by the wall clock."""
        return PacedThread(source, factor)

    def log(self, level: Level, text: str) -> None:
        """Write to ROS's log."""
        # Three calls, as rclpy allows one severity per line of code.
        if level is Level.OK:
            self.get_logger().info(text)
        elif level is Level.WARN:
            self.get_logger().warning(text)
        else:
            self.get_logger().error(text)

    def _follow_clock(self) -> Cancel:
        """Receive simulated time with the other components, in place of rclpy."""
        self._time_source.detach_node()
        clock = find_topic(topics.CLOCK)
        if self._has_slow_clock:
            return self._receiving.open_slow_clock(self, clock, self._on_clock)
        return self._receiving.open(self, clock, self._on_clock, None, by_clock=False)

    def _on_clock(self, message: Message) -> None:
        content = message.content
        if isinstance(content, Refusal):
            self.component.refuse(content)
            return
        assert isinstance(content, ClockSample)
        before_ns, now_ns = self._simulated_ns, content.stamp_ns
        self._simulated_ns, self._has_reading = now_ns, True
        clock = self.get_clock()
        assert isinstance(clock, ROSClock)
        clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))
        if now_ns > before_ns:
            self._calls.advance(now_ns)
        elif now_ns < before_ns:
            self._calls.restart(now_ns)
            self.component.clock_went_back()

    def _refuse_foreign(self, refusal: Refusal) -> None:
        self.component.refuse(refusal)

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        if any(change.name == _USE_SIM_TIME for change in changes):
            reason = f"{_USE_SIM_TIME} is read at the start of the node only: give it then"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self.component.change_parameters({change.name: change.value for change in changes})
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    # --- lifecycle -------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; on a failure, log its reason and stay unconfigured."""
        return self._transition(super().on_configure, state, self.component.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate."""
        return self._transition(super().on_activate, state, self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._transition(super().on_deactivate, state, self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release what ``on_configure`` opened."""
        return self._transition(super().on_cleanup, state, self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and release everything, from any state."""
        return self._transition(super().on_shutdown, state, self._clean_up)

    def _transition(
        self,
        inherited: Callable[[LifecycleState], TransitionCallbackReturn],
        state: LifecycleState,
        act: Callable[[], None],
    ) -> TransitionCallbackReturn:
        try:
            act()
        except ShutdownRequested:
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 - a transition must return its result
            self._failure = error
            self.get_logger().error(f"{type(error).__name__}: {error}")
            return TransitionCallbackReturn.FAILURE
        return inherited(state)

    def _activate(self) -> None:
        self._clock_guard.refuse_second(self.component)
        # The objects made so far live as long as the node. Frozen, they are not traversed by the
        # garbage collector, which would stop the node for 0.1 s or more each time.
        gc.collect()
        gc.freeze()
        denied = set_realtime_priority(self._host_parameters.realtime_priority)
        if denied:
            self.component.event(EventReport(NodeEvent.REALTIME_DENIED, denied))
        self.component.activate()

    def _deactivate(self) -> None:
        self.component.deactivate()
        self._cancel_work()

    def _clean_up(self) -> None:
        self.component.clean_up()
        self._cancel_work()
        for client in self._service_clients.values():
            self.destroy_client(client)
        self._service_clients.clear()

    def _cancel_work(self) -> None:
        """Cancel all computations."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def configure_and_activate(self) -> ExitCode | None:
        """Configure and activate if ``autostart`` is set; returns the exit code of a failure.

        A requested shutdown ends it after the present transition.
        """
        if not self._host_parameters.autostart:
            return None
        shutdown_requested = self.component.shutdown_requested
        for transition in (self.trigger_configure, self.trigger_activate):
            if shutdown_requested():
                return None
            succeeded = transition() is TransitionCallbackReturn.SUCCESS
            if not succeeded and not shutdown_requested():
                bad_configuration = isinstance(self._failure, (ValueError, OSError))
                return ExitCode.BAD_CONFIGURATION if bad_configuration else ExitCode.CRASH
        return None

    def wait_for_delivery(self) -> None:
        """Wait until subscribers have all messages, which are lost when the process ends."""
        self._shared.flush()
        own = [channel.publisher for channel in self._channels]
        wait_until_acknowledged(own + self._shared.publishers)

    def deactivate_and_report(self) -> None:
        """Deactivate and publish the health; may be called twice."""
        self._deactivate()
        self.component.publish_health()
        self.wait_for_delivery()

    def release_resources(self) -> None:
        """Release everything, after the executor has shut down."""
        self._clean_up()
        if self._stop_clock is not None:
            self._stop_clock()


class Shared:
    """What the nodes of a process share.

    Attributes:
        batches: of their streams, where time runs by itself.
        subscriptions: of their components.
        carrier: carries their components in lockstep; None where time runs by itself.
    """

    def __init__(self) -> None:
        self.batches = BatchPublishers()
        self.subscriptions = Subscriptions(self.batches.flush)
        self.carrier: LockstepCarrier | None = None

    def flush(self) -> None:
        """Send the batches."""
        self.batches.flush()
        if self.carrier is not None:
            self.carrier.flush()

    @property
    def publishers(self) -> list[Publisher]:
        """Publishers of the batches and of the carrier."""
        carried = [] if self.carrier is None else self.carrier.publishers
        return self.batches.publishers + carried

    def carrier_of(self, node: ComponentNode, parameters: HostParameters) -> LockstepCarrier:
        """Return the carrier.

        Raises:
            ParameterError: the processes in lockstep do not contain this node.
        """
        if self.carrier is None:
            processes = read_processes(parameters.lockstep)
            own = [name for name, nodes in processes.items() if node.get_name() in nodes]
            if not own:
                msg = f"lockstep is {parameters.lockstep!r}: should name {node.get_name()}"
                raise ParameterError(msg)
            self.carrier = LockstepCarrier(
                processes, own[0], parameters.delay_seed, node.get_namespace(), node.token
            )
        return self.carrier


def parameter_classes(component_class: type[Component]) -> list[type[DataclassInstance]]:
    """Return all parameter classes of a node, those of the host included."""
    return [HostParameters, *component_class.PARAMETERS]


def _ignore(_: object) -> None:
    """Discard a result."""
