"""The shell that every node of the suite wears.

``ContractNode`` is a lifecycle node that speaks by the contract's table only:
it declares typed parameters, publishes samples, hands accepted samples to
callbacks, and puts every refusal with its reason on diagnostics while it lives
on. ``msg_schemas.node_process`` runs one.

Life of a node: ``setup`` (configure) -> ``start`` (activate) -> ``stop``
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
_MOST_AT_ONCE = 50
_LAST_WORDS = 0.5
_SIMULATED = "use_sim_time"
_ANY_TIME = JumpThreshold(
    min_forward=Duration(nanoseconds=1),
    min_backward=Duration(nanoseconds=-1),
    on_clock_change=False,  # it keeps the clock that it started with
)


class ShutdownRequested(Exception):
    """Raised in a transition that gives up because its node is told to stop."""


class ExitCode(IntEnum):
    """What a node's exit code says."""

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
        "configure and activate by itself; false waits for a lifecycle manager",
        read_only=True,
    )
    realtime_priority: int = parameter(
        0,
        "-",
        "of the process from its activation on, by SCHED_RR of Linux; 0: scheduled as any other",
        0,
        49,  # the kernel's own interrupts stand at 50
        read_only=True,
    )


class ContractNode(LifecycleNode):
    """A node that speaks by the contract.

    Subclasses set ``NAME`` and ``PARAMETERS`` and override ``setup``, ``start``,
    ``stop``, ``release``, ``waiting_for``, ``health`` and ``configuration`` as they
    need. A ``setup`` that takes more than a few seconds calls ``check_shutdown`` now and then.
    """

    NAME: ClassVar[str] = ""
    PARAMETERS: ClassVar[tuple[type[DataclassInstance], ...]] = ()
    # For each message it takes less than half of the time of rclpy's others, which wait for sets.
    EXECUTOR: ClassVar[Callable[[], Executor]] = EventsExecutor

    def __init__(self, **node_options: Any) -> None:
        """Declare parameters and open events, diagnostics and configuration.

        Raises:
            ParameterError: a parameter given from outside is wrong.
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
        self._opened: list[ContractPublisher] = []
        self._subscriptions_opened: list[Any] = []
        self._served: list[Any] = []
        self._callers: dict[str, Any] = {}
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
            _ANY_TIME, post_callback=self._on_clock_jump
        )

    # --- what subclasses override --------------------------------------------------------------

    def setup(self) -> None:
        """Configure: load, compile, open publishers and subscriptions."""

    def start(self) -> None:
        """Activate: begin to act."""

    def stop(self) -> None:
        """Deactivate: stop acting, leave everything safe."""

    def release(self) -> None:
        """Clean up what ``setup`` made beyond publishers, subscriptions and services."""

    def waiting_for(self) -> tuple[str, ...]:
        """Return the topics that must be heard before the node can do its work."""
        return ()

    def health(self) -> tuple[Status, ...]:
        """Return further statuses for the periodic diagnostics."""
        return ()

    def configuration(self) -> Mapping[str, Any]:
        """Return what else the latched configuration shall hold (JSON values)."""
        return {}

    def clock_jumped(self) -> None:
        """React to a clock that jumped back."""

    def parameters_changed(self) -> None:
        """React to parameters that were changed while the node runs."""

    # --- parameters ------------------------------------------------------------------------------

    def parameters_of(self, cls: type[P]) -> P:
        """Return the present values of one of the node's parameter classes."""
        found: P = self._groups[cls]
        return found

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        if any(change.name == _SIMULATED for change in changes):
            reason = f"{_SIMULATED} is read when the node starts: it should be given then"
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
        self._opened.append(made)
        return made

    def subscribe(
        self, name: str, callback: Callable[[Any], None], depth: int | None = None
    ) -> None:
        """Subscribe to a topic of the table; ``callback`` gets accepted samples only.

        ``depth`` deepens the queue, where several speak at once. ``callback`` may
        raise ``Refusal`` for what only it can judge, such as a wrong phase.
        """
        check_access(self.NAME, Act.SUBSCRIBE, name)
        row = find_topic(name)
        message_type = message_class(row.message)

        def receive(message: Any) -> None:
            self._receive(row, callback, message)
            # What waits already on this topic, too: the executor's own way to it costs several
            # times as much, and a node that lags behind would act on ever older samples.
            for _ in range(_MOST_AT_ONCE):
                with subscription.handle:
                    taken = subscription.handle.take_message(message_type, False)
                if taken is None:
                    return
                self._receive(row, callback, taken[0])

        subscription = self.create_subscription(
            message_type, name, receive, qos.profile(row.intent, depth)
        )
        self._subscriptions_opened.append(subscription)

    def serve(self, name: str, callback: Callable[..., tuple[bool, str]]) -> None:
        """Offer a Trigger or SetBool service of the table.

        ``callback`` takes no argument (Trigger) or one bool (SetBool) and returns
        success and a message; a ``Refusal`` that it raises becomes the answer.
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

        self._served.append(self.create_service(message_class(row.service), name, answer))

    def call_service(self, name: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a Trigger service of the table; returns whether its server is there.

        ``answered`` gets success and message when the answer comes; a server that dies
        meanwhile gives none.
        """
        check_access(self.NAME, Act.CALL, name)
        if name not in self._callers:
            self._callers[name] = self.create_client(message_class(SERVICES[name].service), name)
        client = self._callers[name]
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
        """Call back every ``period`` seconds of the node's clock while active."""
        if self._is_simulated and not by_wall_clock:
            self._calls_while_active.add(round(period * 1e9), callback, self.now_ns())
            return
        clock = self._steady if by_wall_clock else None
        self._timers_while_active.append(self.create_timer(period, callback, clock=clock))

    def now_ns(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def knows_time(self) -> bool:
        """Whether the node's clock goes: simulated time is unknown before it is first heard.

        A sample that is heard before would seem as old as the clock's first reading.
        """
        return not self._is_simulated or self.now_ns() > 0

    @property
    def _is_simulated(self) -> bool:
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def event(self, report: EventReport, *, diagnoses: bool = False) -> None:
        """Publish an event and log it; ``diagnoses``: on diagnostics too, where it is not OK."""
        name, message, level = report.name.value, report.message, report.level
        status = Status(name, message, level, self.NAME, report.texts())
        stamp = self.now_ns() if report.stamp_ns is None else report.stamp_ns
        self._events.send(StatusSample(stamp, (status,)))
        # Spelt out, as rclpy allows each line of code one severity only.
        if level is Level.OK:
            self.get_logger().info(f"{name}: {message}")
        elif level is Level.WARN:
            self.get_logger().warning(f"{name}: {message}")
        else:
            self.get_logger().error(f"{name}: {message}")
        if diagnoses and level is not Level.OK:
            self.report(replace(status, name=f"{self.NAME}: {name}"))

    def refuse(self, refusal: Refusal) -> None:
        """Put a refusal on diagnostics, with its reason; a flood is counted, not repeated."""
        status = self._refusals.take(refusal)
        if status is not None:
            self.report(status)
            self.get_logger().warning(f"refused {refusal}")

    def report(self, status: Status) -> None:
        """Put one status on diagnostics now, besides the periodic ones."""
        self._diagnostics.send(StatusSample(self.now_ns(), (status,)))

    def _unready(self) -> str:
        """Why nothing can be taken now; empty if it can."""
        if not self.active:
            return f"{self.NAME} is not active, it must be activated first"
        if not self.knows_time():
            return f"{self.NAME} follows simulated time and has not received {topics.CLOCK} yet"
        return ""

    def _process_latched(self) -> None:
        """Take what is latched, once all is ready: nobody says it again."""
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
        """Forget the stamps of past commands: the clock that they follow has gone back."""
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
        """Whether the node can do its work, and if not, which inputs it waits for."""
        if not self.active:
            return Health(self.NAME, HealthState.INACTIVE)
        missing = tuple(self.waiting_for()) if self.knows_time() else (topics.CLOCK,)
        return Health(self.NAME, HealthState.WAITING if missing else HealthState.READY, missing)

    def _publish_health(self) -> None:
        self._published_health = condition = self._current_health()
        held_back = self._refusals.end_period()
        for status in held_back:
            self.get_logger().warning(f"{status.name}: {status.message}")
        values = {
            "accepted": str(sum(self._accepted.values())),
            "refused": str(self._refusals.refused),
        }
        for topic, owner in self._admission.owners(self.now_ns()).items():
            values[f"owner of {topic}"] = owner
        own = condition.status(values)
        self._diagnostics.send(StatusSample(self.now_ns(), (own, *self.health(), *held_back)))

    def _publish_health_change(self) -> None:
        """Tell at once what who waits for this node waits for."""
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
        """Configure; a failure leaves the node unconfigured and says why."""
        return self._transition(super().on_configure, state, self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate."""
        return self._transition(super().on_activate, state, self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._transition(super().on_deactivate, state, self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give back what ``on_configure`` made."""
        return self._transition(super().on_cleanup, state, self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and give everything back, from any state."""
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
        except Exception as error:  # noqa: BLE001 - a transition must answer, whatever went wrong
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
        # What was made up to here lives as long as the node. The garbage collector would look at it
        # again and again, and hold the node up for 0.1 s and more each time.
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
        for subscription in self._subscriptions_opened:
            self.destroy_subscription(subscription)
        for service in self._served:
            self.destroy_service(service)
        for client in self._callers.values():
            self.destroy_client(client)
        for made in self._opened:
            made.destroy()
        self._callers.clear()
        self._subscriptions_opened.clear()
        self._latched.clear()
        self._served.clear()
        self._opened.clear()

    def check_shutdown(self) -> None:
        """Leave a transition that takes long, if the node is told to stop meanwhile.

        Raises:
            ShutdownRequested: it is.
        """
        if self.shutdown_requested():
            raise ShutdownRequested

    def configure_and_activate(self) -> ExitCode | None:
        """Configure and activate when ``autostart`` says so; returns why it could not.

        It goes no further than it is when the node is told to stop.
        """
        if not self.parameters_of(BaseParameters).autostart:
            return None
        for transition in (self.trigger_configure, self.trigger_activate):
            if self.shutdown_requested():
                return None
            done = transition() is TransitionCallbackReturn.SUCCESS
            if not done and not self.shutdown_requested():
                failed = self._failure
                expected = isinstance(failed, (ValueError, OSError))
                return ExitCode.BAD_CONFIGURATION if expected else ExitCode.CRASH
        return None

    def wait_for_delivery(self) -> None:
        """Let what was said reach who listens, as it is lost when the process ends."""
        deadline = time.monotonic() + _LAST_WORDS
        for made in (*self._opened, self._events, self._diagnostics):
            made.wait_for_delivery(max(0.0, deadline - time.monotonic()))

    def deactivate_and_report(self) -> None:
        """Leave everything safe, and say so; safe to call twice."""
        self._deactivate()
        self._publish_health()
        self.wait_for_delivery()

    def release_resources(self) -> None:
        """Give back what was made, once no executor looks at it any more."""
        self._clean_up()
        self._jump_handle.unregister()


def parameter_classes(node_class: type[ContractNode]) -> list[type[DataclassInstance]]:
    """Return all parameter classes of a node, those of the shell included."""
    return [BaseParameters, *node_class.PARAMETERS]
