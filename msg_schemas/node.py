"""Base class of every node of the suite.

``ContractNode`` is a lifecycle node whose topics and services all come from the
contract's table. It declares typed parameters, publishes samples, passes accepted
samples to callbacks, and reports each refusal with its reason on ``diagnostics``
without stopping. ``msg_schemas.node_process`` runs one as a process.

Lifecycle: ``setup`` (configure) -> ``start`` (activate) -> ``stop``
(deactivate) -> ``release`` (clean-up). With the parameter ``autostart`` (the
default) it configures and activates itself.
"""

from __future__ import annotations

import dataclasses
import gc
import json
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, ClassVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, JumpThreshold, ROSClock, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from msg_schemas import qos, topics
from msg_schemas.access import Act, check_access
from msg_schemas.admission import Admission, requester_of
from msg_schemas.codecs import find_topic, message_class
from msg_schemas.events import EventReport, NodeEvent
from msg_schemas.health import Health
from msg_schemas.parameters import P, ParameterError, parameter
from msg_schemas.periodic_calls import PeriodicCalls
from msg_schemas.phases import HealthState
from msg_schemas.publisher import ContractPublisher
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.refusal_log import RefusalLog
from msg_schemas.ros_parameters import (
    changed_groups,
    declare_parameters,
)
from msg_schemas.samples import Level, Status, StatusSample, TextSample
from msg_schemas.scheduling import set_realtime_priority
from msg_schemas.table import CONTRACT_VERSION, SERVICES, Intent, Topic

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

PACKAGE = "mother_rover"

_DIAGNOSTICS_PERIOD = 1.0
_READINESS_PERIOD = 0.1
_SPIN_SLICE = 0.1
_MAX_MESSAGES_AT_ONCE = 50
_DELIVERY_TIMEOUT = 0.5
_USE_SIM_TIME = "use_sim_time"
_EVERY_CHANGE = JumpThreshold(
    min_forward=Duration(nanoseconds=1),
    min_backward=Duration(nanoseconds=-1),
    on_clock_change=False,  # use_sim_time cannot change while the node runs
)


class ShutdownRequested(Exception):
    """Raised in a transition to end it early, because the process shuts down."""


class ExitCode(IntEnum):
    """Exit code of a node's process."""

    OK = 0
    CRASH = 1
    BAD_CONFIGURATION = 2
    DIVERGED = 3


def package_version() -> str:
    """Return the installed version of the package, or ``unknown`` when run from a bare tree."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True)
class BaseParameters:
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


class ContractNode(LifecycleNode):
    """A lifecycle node whose interface is the contract.

    Subclasses set ``NAME`` and ``PARAMETERS`` and override ``setup``, ``start``,
    ``stop``, ``release``, ``waiting_for``, ``health`` and ``configuration`` as needed.
    A ``setup`` that takes more than a few seconds calls ``check_shutdown`` repeatedly.
    """

    NAME: ClassVar[str] = ""
    PARAMETERS: ClassVar[tuple[type[DataclassInstance], ...]] = ()
    # Less than half the time per message of rclpy's other executors, which use wait sets.
    EXECUTOR: ClassVar[Callable[[], Executor]] = EventsExecutor

    def __init__(self, **node_options: Any) -> None:
        """Declare parameters and open the publishers of events, diagnostics and configuration.

        Raises:
            ParameterError: a parameter override is wrong.
        """
        super().__init__(self.NAME, **node_options)
        self.exit_code: ExitCode | None = None
        self.shutdown_requested: Callable[[], bool] = lambda: False
        self.active = False
        self._failure: Exception | None = None
        self._accepted: Counter[str] = Counter()
        self._refusals = RefusalLog(self.NAME)
        self._published_health: Health | None = None
        self._latched: dict[str, tuple[Topic, Callable[[Any], None], Any]] = {}
        self._is_latched_processed = False
        self._admission = Admission()
        self._publishers_made: list[ContractPublisher] = []
        self._subscriptions_made: list[Any] = []
        self._services_made: list[Any] = []
        self._service_clients: dict[str, Any] = {}
        self._timers_while_active: list[Any] = []
        self._calls_while_active = PeriodicCalls()  # by simulated time
        self._groups = declare_parameters(self, parameter_classes(type(self)))
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._diagnostics = ContractPublisher(self, topics.DIAGNOSTICS, self.refuse)
        self._events = ContractPublisher(self, topics.EVENTS, self.refuse)
        self._config = ContractPublisher(self, topics.CONFIG, self.refuse)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DIAGNOSTICS_PERIOD, self._publish_health, clock=self._steady)
        self._jump_handle = self.get_clock().create_jump_callback(
            _EVERY_CHANGE, post_callback=self._on_clock_jump
        )

    # --- what subclasses override --------------------------------------------------------------

    def setup(self) -> None:
        """Configure: load, compile, open publishers and subscriptions."""

    def start(self) -> None:
        """Activate: start to command and publish."""

    def stop(self) -> None:
        """Deactivate: leave all actuators safe."""

    def release(self) -> None:
        """Clean up: close what ``setup`` opened besides publishers, subscriptions and services."""

    def waiting_for(self) -> tuple[str, ...]:
        """Return the input topics whose missing messages keep the node from its work."""
        return ()

    def health(self) -> tuple[Status, ...]:
        """Return further statuses for the periodic diagnostics."""
        return ()

    def configuration(self) -> Mapping[str, Any]:
        """Return further entries of the latched configuration (JSON values)."""
        return {}

    def clock_jumped(self) -> None:
        """React to a clock that has jumped back."""

    def parameters_changed(self) -> None:
        """React to changed parameters of the running node."""

    # --- parameters ------------------------------------------------------------------------------

    def parameters_of(self, cls: type[P]) -> P:
        """Return the present values of a parameter class."""
        found: P = self._groups[cls]
        return found

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        if any(change.name == _USE_SIM_TIME for change in changes):
            reason = f"{_USE_SIM_TIME} is read at the start of the node only: give it then"
            return SetParametersResult(successful=False, reason=reason)
        try:
            renewed = changed_groups(self._groups, changes)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._groups.update(renewed)
        if renewed:
            self.parameters_changed()
            if self._last_configuration is not None:
                self._publish_configuration()
        return SetParametersResult(successful=True)

    # --- publishing, subscribing, serving --------------------------------------------------------

    def publisher(self, name: str) -> ContractPublisher:
        """Open a publisher for a topic of the table."""
        check_access(self.NAME, Act.PUBLISH, name)
        made = ContractPublisher(self, name, self.refuse)
        self._publishers_made.append(made)
        return made

    def subscribe(
        self, name: str, callback: Callable[[Any], None], depth: int | None = None
    ) -> None:
        """Subscribe to a topic of the table; ``callback`` gets accepted samples only.

        ``depth`` overrides the depth of the queue. ``callback`` may raise ``Refusal``
        for what the table cannot express, such as a wrong phase.
        """
        check_access(self.NAME, Act.SUBSCRIBE, name)
        row = find_topic(name)
        message_type = message_class(row.message)

        def receive(message: Any) -> None:
            self._receive(row, callback, message)
            # Drain the queue: the executor takes several times as long per message, and a node
            # that lags behind would act on ever older samples.
            for _ in range(_MAX_MESSAGES_AT_ONCE):
                with subscription.handle:
                    taken = subscription.handle.take_message(message_type, False)
                if taken is None:
                    return
                self._receive(row, callback, taken[0])

        subscription = self.create_subscription(
            message_type, name, receive, qos.profile(row.intent, depth)
        )
        self._subscriptions_made.append(subscription)

    def serve(self, name: str, callback: Callable[..., tuple[bool, str]]) -> None:
        """Offer a Trigger or SetBool service of the table.

        ``callback`` takes no argument (Trigger) or one bool (SetBool) and returns
        success and a message. If it raises a ``Refusal``, the response is its text.
        """
        check_access(self.NAME, Act.SERVE, name)
        row = SERVICES[name]

        def answer(request: Any, response: Any) -> Any:
            arguments = (bool(request.data),) if hasattr(request, "data") else ()
            try:
                unready = self._unready()
                if unready:
                    raise Refusal(name, RefusalCode.NOT_ACTIVE, unready)
                response.success, response.message = callback(*arguments)
            except Refusal as refusal:
                self.refuse(refusal)
                response.success, response.message = False, str(refusal)
            return response

        self._services_made.append(self.create_service(message_class(row.service), name, answer))

    def call_service(self, name: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a Trigger service of the table; returns whether its server is available.

        ``answered`` receives success and message of the response; it is not called if the
        server dies first.
        """
        check_access(self.NAME, Act.CALL, name)
        if name not in self._service_clients:
            self._service_clients[name] = self.create_client(
                message_class(SERVICES[name].service), name
            )
        client = self._service_clients[name]
        if not client.service_is_ready():
            return False

        def report_answer(future: Any) -> None:
            if self.active and future.exception() is None:
                answered(future.result().success, future.result().message)

        client.call_async(client.srv_type.Request()).add_done_callback(report_answer)
        return True

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> None:
        """Call ``callback`` every ``period`` seconds of the node's clock while active."""
        if self._is_simulated and not by_wall_clock:
            self._calls_while_active.add(round(period * 1e9), callback, self.now_ns())
            return
        clock = self._steady if by_wall_clock else None
        self._timers_while_active.append(self.create_timer(period, callback, clock=clock))

    def now_ns(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def knows_time(self) -> bool:
        """Whether the node's clock has a reading: simulated time has none before its first message.

        The age of a sample cannot be checked before.
        """
        return not self._is_simulated or self.now_ns() > 0

    @property
    def _is_simulated(self) -> bool:
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def event(self, report: EventReport, *, diagnoses: bool = False) -> None:
        """Publish and log an event; ``diagnoses``: also on diagnostics, unless its level is OK."""
        name, message, level = report.name.value, report.message, report.level
        status = Status(name, message, level, self.NAME, report.texts())
        stamp = self.now_ns() if report.stamp_ns is None else report.stamp_ns
        self._events.send(StatusSample(stamp, (status,)))
        # Three calls, as rclpy allows one severity per line of code.
        if level is Level.OK:
            self.get_logger().info(f"{name}: {message}")
        elif level is Level.WARN:
            self.get_logger().warning(f"{name}: {message}")
        else:
            self.get_logger().error(f"{name}: {message}")
        if diagnoses and level is not Level.OK:
            self.report(replace(status, name=f"{self.NAME}: {name}"))

    def refuse(self, refusal: Refusal) -> None:
        """Report a refusal with its reason on diagnostics; ``RefusalLog`` limits the rate."""
        status = self._refusals.take(refusal)
        if status is not None:
            self.report(status)
            self.get_logger().warning(f"refused {refusal}")

    def report(self, status: Status) -> None:
        """Publish one status on diagnostics at once."""
        self._diagnostics.send(StatusSample(self.now_ns(), (status,)))

    def _unready(self) -> str:
        """Why no message can be accepted now; empty = it can."""
        if not self.active:
            return f"{self.NAME} is not active, it must be activated first"
        if not self.knows_time():
            return f"{self.NAME} follows simulated time and has not received {topics.CLOCK} yet"
        return ""

    def _process_latched(self) -> None:
        """Process latched messages that came before the node was ready; none is sent twice."""
        if self._is_latched_processed or self._unready():
            return
        self._is_latched_processed = True
        for row, callback, message in tuple(self._latched.values()):
            self._receive(row, callback, message)

    def _receive(self, row: Topic, callback: Callable[[Any], None], message: Any) -> None:
        is_command = row.intent is Intent.COMMAND
        if row.intent is Intent.LATCHED:
            self._latched[row.name] = (row, callback, message)
        requester = requester_of(row, message) if is_command else ""
        unready = self._unready()
        if unready:
            if is_command:
                self._refuse_request(requester, Refusal(row.name, RefusalCode.NOT_ACTIVE, unready))
            return
        now_ns = self.now_ns()
        try:
            sample = self._admission.admit(row, message, now_ns)
            callback(sample)
        except Refusal as refusal:
            self._refuse_request(requester, refusal)
            return
        self._admission.accepted(row, message, now_ns)
        self._accepted[row.name] += 1
        if requester and not row.one_owner:
            values = {"topic": row.name, "command_source": requester}
            text = f"{row.name} of {requester}"
            self.event(EventReport(NodeEvent.REQUEST_ACCEPTED, text, values))

    def _refuse_request(self, requester: str, refusal: Refusal) -> None:
        refusal.command_source = requester
        self.refuse(refusal)

    def accept_earlier_stamps(self) -> None:
        """Forget the stamps of past commands, because the clock has gone back."""
        self._admission.forget()

    def _on_clock_jump(self, jump: TimeJump) -> None:
        if jump.delta.nanoseconds > 0:
            self._calls_while_active.advance(self.now_ns())
            return
        self._calls_while_active.restart(self.now_ns())
        self.accept_earlier_stamps()
        self.clock_jumped()

    # --- health and configuration ----------------------------------------------------------------

    _last_configuration: str | None = None

    def _current_health(self) -> Health:
        """State of the node and the inputs that it waits for."""
        if not self.active:
            return Health(self.NAME, HealthState.INACTIVE)
        missing = tuple(self.waiting_for()) if self.knows_time() else (topics.CLOCK,)
        return Health(self.NAME, HealthState.WAITING if missing else HealthState.READY, missing)

    def _publish_health(self) -> None:
        self._published_health = health = self._current_health()
        held_back = self._refusals.end_period()
        for status in held_back:
            self.get_logger().warning(f"{status.name}: {status.message}")
        values = {
            "accepted": str(sum(self._accepted.values())),
            "refused": str(self._refusals.refused),
        }
        for topic, owner in self._admission.owners(self.now_ns()).items():
            values[f"owner of {topic}"] = owner
        own = health.status(values)
        self._diagnostics.send(StatusSample(self.now_ns(), (own, *self.health(), *held_back)))

    def _publish_health_change(self) -> None:
        """Publish the health at once if it has changed: other nodes may wait for it."""
        self._process_latched()
        if self._current_health() != self._published_health:
            self._publish_health()

    def _publish_configuration(self) -> None:
        parameters = {
            name: value
            for group in self._groups.values()
            for name, value in dataclasses.asdict(group).items()
        }
        content = {
            "node": self.get_fully_qualified_name(),
            "package": PACKAGE,
            "package_version": package_version(),
            "contract_version": CONTRACT_VERSION,
            "parameters": parameters,
            **self.configuration(),
        }
        self._last_configuration = json.dumps(content, sort_keys=True)
        self._config.send(TextSample(self._last_configuration))

    # --- lifecycle -------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; on a failure, log its reason and stay unconfigured."""
        return self._transition(super().on_configure, state, self._configure)

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

    def _configure(self) -> None:
        try:
            self.setup()
        except Exception:
            self._close()
            raise
        self._publish_configuration()

    def _activate(self) -> None:
        # The objects made so far live as long as the node. Frozen, they are not traversed by the
        # garbage collector, which would stop the node for 0.1 s or more each time.
        gc.collect()
        gc.freeze()
        self.active, self._is_latched_processed = True, False
        refused = set_realtime_priority(self.parameters_of(BaseParameters).realtime_priority)
        if refused:
            self.event(EventReport(NodeEvent.REALTIME_DENIED, refused))
        self.start()
        self._process_latched()
        self.every(_READINESS_PERIOD, self._publish_health_change, by_wall_clock=True)
        self.event(EventReport(NodeEvent.ACTIVE, f"{self.NAME} is active"))

    def _deactivate(self) -> None:
        for timer in self._timers_while_active:
            self.destroy_timer(timer)
        self._timers_while_active.clear()
        self._calls_while_active.clear()
        if self.active:
            self.stop()
            self.active = False
            self.event(EventReport(NodeEvent.INACTIVE, f"{self.NAME} is inactive"))

    def _clean_up(self) -> None:
        self._deactivate()
        self.release()
        self._last_configuration = None
        self._close()

    def _close(self) -> None:
        for subscription in self._subscriptions_made:
            self.destroy_subscription(subscription)
        for service in self._services_made:
            self.destroy_service(service)
        for client in self._service_clients.values():
            self.destroy_client(client)
        for made in self._publishers_made:
            made.destroy()
        self._service_clients.clear()
        self._subscriptions_made.clear()
        self._latched.clear()
        self._services_made.clear()
        self._publishers_made.clear()

    def check_shutdown(self) -> None:
        """End a long transition early if a shutdown is requested.

        Raises:
            ShutdownRequested: a shutdown is requested.
        """
        if self.shutdown_requested():
            raise ShutdownRequested

    def configure_and_activate(self) -> ExitCode | None:
        """Configure and activate if ``autostart`` is set; returns the exit code of a failure.

        A requested shutdown ends it after the present transition.
        """
        if not self.parameters_of(BaseParameters).autostart:
            return None
        for transition in (self.trigger_configure, self.trigger_activate):
            if self.shutdown_requested():
                return None
            succeeded = transition() is TransitionCallbackReturn.SUCCESS
            if not succeeded and not self.shutdown_requested():
                bad_configuration = isinstance(self._failure, (ValueError, OSError))
                return ExitCode.BAD_CONFIGURATION if bad_configuration else ExitCode.CRASH
        return None

    def wait_for_delivery(self) -> None:
        """Wait until subscribers have all messages, which are lost when the process ends."""
        deadline = time.monotonic() + _DELIVERY_TIMEOUT
        for made in (*self._publishers_made, self._events, self._diagnostics):
            made.wait_for_delivery(max(0.0, deadline - time.monotonic()))

    def deactivate_and_report(self) -> None:
        """Deactivate and publish the health; may be called twice."""
        self._deactivate()
        self._publish_health()
        self.wait_for_delivery()

    def release_resources(self) -> None:
        """Release everything, after the executor has shut down."""
        self._clean_up()
        self._jump_handle.unregister()


def parameter_classes(node_class: type[ContractNode]) -> list[type[DataclassInstance]]:
    """Return all parameter classes of a node, those of the base class included."""
    return [BaseParameters, *node_class.PARAMETERS]
