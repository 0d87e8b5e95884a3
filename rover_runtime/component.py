"""Base class of what each node of the suite does.

A ``Component`` has topics and services of the contract's table, typed parameters, a life cycle and
a health. It passes accepted samples to callbacks, and reports each refusal with its reason on
``diagnostics`` without stopping. It knows no ROS: a host carries it and gives it a ``Port``.

Life cycle: ``setup`` (configure) -> ``start`` (activate) -> ``stop`` (deactivate) -> ``release``
(clean-up).
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from msg_schemas import topics
from msg_schemas.access import Act, check_access
from msg_schemas.commands import CommandRecord
from msg_schemas.events import EventReport, NodeEvent
from msg_schemas.faults import Reason
from msg_schemas.health import Health
from msg_schemas.package import PACKAGE, package_version
from msg_schemas.parameters import P, from_mapping
from msg_schemas.phases import HealthState
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample, Status, StatusSample, TextSample
from msg_schemas.specifications import Topic
from msg_schemas.table import CONTRACT_VERSION, find_topic
from rover_runtime.command_log import CommandLog
from rover_runtime.log_limit import LogLimit
from rover_runtime.pacing import Stepper, TimeSource
from rover_runtime.port import Cancel, Port, Work
from rover_runtime.reception import Reception
from rover_runtime.refusal_log import RefusalLog

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Groups = dict[type[Any], Any]
T = TypeVar("T")

_DIAGNOSTICS_PERIOD = 1.0
_READINESS_PERIOD = 0.1


class ShutdownRequested(Exception):
    """Raised in a transition to end it early, because the process shuts down."""


class ExitCode(IntEnum):
    """Exit code of a node's process."""

    OK = 0
    CRASH = 1
    BAD_CONFIGURATION = 2
    DIVERGED = 3


class Publisher:
    """Publishes samples of one topic; a sample that violates the contract is refused, not sent.

    Args:
        port: of the component.
        row: specification of the topic.
        refuse: called with the refusal of each such sample.
    """

    def __init__(self, port: Port, row: Topic, refuse: Callable[[Refusal], object]) -> None:
        self._refuse = refuse
        is_named = row.is_command and not row.frame
        self._sender = port.full_name if is_named else ""
        # Unique for each instance: two nodes of the same name are two command sources.
        self._identifier = port.token if row.owned else ""
        self._channel = port.publish(row)

    def send(self, sample: Sample, identifier: str = "") -> bool:
        """Publish a sample; returns whether it was sent.

        Args:
            sample: of the topic's type.
            identifier: of a request, which its record repeats; empty = the stamp.
        """
        identifier = self._identifier or identifier
        name = f"{self._sender}#{identifier}" if self._sender and identifier else self._sender
        try:
            self._channel.send(sample, name)
        except Refusal as refusal:
            self._refuse(refusal)
            return False
        return True

    @property
    def has_subscribers(self) -> bool:
        """Whether the topic has a subscriber; without one a costly sample need not be made."""
        return self._channel.has_subscribers

    def close(self) -> None:
        """Close the topic."""
        self._channel.close()


class Component:
    """What a node does; its interface is the contract.

    Subclasses set ``NAME`` and ``PARAMETERS`` and override ``setup``, ``start``, ``stop``,
    ``release``, ``waiting_for``, ``health`` and ``configuration`` as needed. A ``setup`` that takes
    more than a few seconds calls ``check_shutdown`` repeatedly.

    Args:
        port: of the host.
        groups: values of the parameter classes, those of the host included.

    Attributes:
        active: whether the component is active.
        commands: records of the commands that the component has taken.
        reception: of messages.
        exit_code: set by the component to end its process.
        shutdown_requested: whether the process shuts down.
        RECEIVES_WITH_CALLS: whether the component, where it follows the clock of another process,
            receives clock and streams with its calls by the wall clock, not at each reading; of
            the samples of a stream that have arrived in batches it receives the newest alone.
        END_TIMEOUT: longest duration of ``stop``, and of ``release``, at the end of a process [s].
    """

    NAME: ClassVar[str] = ""
    PARAMETERS: ClassVar[tuple[type[DataclassInstance], ...]] = ()
    RECEIVES_WITH_CALLS: ClassVar[bool] = False
    END_TIMEOUT: ClassVar[float] = 20.0

    def __init__(self, port: Port, groups: Groups) -> None:
        self.port = port
        self.active = False
        self.exit_code: ExitCode | None = None
        self.shutdown_requested: Callable[[], bool] = lambda: False
        self._groups = dict(groups)
        self._refusals = RefusalLog(self.NAME)
        self._log_limit = LogLimit()
        self._changes: list[Callable[[], None]] = []  # reactions to changes while inactive
        self._published_health: Health | None = None
        self._last_configuration: str | None = None
        self._opened: list[Cancel] = []  # until the clean-up
        self._timers: list[Cancel] = []  # while active
        self._diagnostics = self._publisher_of(topics.DIAGNOSTICS)
        self._events = self._publisher_of(topics.EVENTS)
        self._config = self._publisher_of(topics.CONFIG)
        self._command_records = self._publisher_of(topics.COMMANDS)
        self.commands = CommandLog(self.NAME, self.now_ns, self._publish_command)
        self.reception = Reception(self, self.commands)
        port.every(_DIAGNOSTICS_PERIOD, self.publish_health, by_wall_clock=True)

    # --- what subclasses override --------------------------------------------------------------

    def setup(self) -> None:
        """Configure: load, compile, open publishers and subscriptions."""

    def start(self) -> None:
        """Activate: start to command and publish."""

    def stop(self) -> None:
        """Deactivate: leave all actuators safe."""

    def release(self) -> None:
        """Clean up: close what ``setup`` opened besides publishers, subscriptions and services.

        Called also after a ``setup`` that failed; may be called twice.
        """

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
        """React to a clock that has jumped back; called while active, or after the start."""

    def parameters_changed(self) -> None:
        """React to changed parameters; called while active, or after the start."""

    # --- parameters ------------------------------------------------------------------------------

    def parameters_of(self, cls: type[P]) -> P:
        """Return the present values of a parameter class, or of settings with such fields."""
        if cls not in self._groups and (parts := parts_of(cls)):
            return cls(**{name: self.parameters_of(part) for name, part in parts.items()})
        found: P = self._groups[cls]
        return found

    def change_parameters(self, values: Mapping[str, Any]) -> None:
        """Apply changed parameters, by name.

        Raises:
            ParameterError: a new value is wrong; nothing has changed.
        """
        changed: Groups = {}
        for cls, present in self._groups.items():
            names = {field.name for field in dataclasses.fields(cls)}
            mine = {name: value for name, value in values.items() if name in names}
            if mine:
                changed[cls] = from_mapping(cls, {**dataclasses.asdict(present), **mine})
        if not changed:
            return
        self._groups.update(changed)
        self._notify(self.parameters_changed)
        if self._last_configuration is not None:
            self._publish_configuration()

    # --- publishing, subscribing, serving --------------------------------------------------------

    @property
    def full_name(self) -> str:
        """Name with the namespace."""
        return self.port.full_name

    def _publisher_of(self, name: str) -> Publisher:
        return Publisher(self.port, find_topic(name), self.refuse)

    def publisher(self, name: str) -> Publisher:
        """Open a publisher for a topic of the table."""
        check_access(self.NAME, Act.PUBLISH, name)
        made = self._publisher_of(name)
        self._opened.append(made.close)
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
        receive = self.reception.open(row, callback, depth)
        close = self.port.subscribe(row, receive, depth)
        self._opened += (close, self.reception.forget_latched)

    def serve(self, name: str, callback: Callable[..., tuple[bool, str]]) -> None:
        """Offer a Trigger or SetBool service of the table.

        ``callback`` takes no argument (Trigger) or one bool (SetBool) and returns
        success and a message. If it raises a ``Refusal``, the response is its text.
        """
        check_access(self.NAME, Act.SERVE, name)

        def answer(*arguments: bool) -> tuple[bool, str]:
            self.commands.take(name, what=", ".join(str(each).lower() for each in arguments))
            try:
                unready = self.unready()
                if unready:
                    raise Refusal(name, RefusalCode.NOT_ACTIVE, unready)
                success, text = callback(*arguments)
            except Refusal as refusal:
                self.commands.refuse(refusal, publishes=self.refuse(refusal))
                return False, str(refusal)
            self.commands.finish_taking(text)
            return success, text

        self._opened.append(self.port.serve(name, answer))

    def call_service(self, name: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a Trigger service of the table; returns whether its server is available.

        ``answered`` receives success and message of the response; it is not called if the
        server dies first.
        """
        check_access(self.NAME, Act.CALL, name)

        def report_answer(success: bool, text: str) -> None:
            if self.active:
                answered(success, text)

        return self.port.call(name, report_answer)

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> None:
        """Call ``callback`` every ``period`` seconds of the node's clock while active."""
        self._timers.append(self.port.every(period, callback, by_wall_clock=by_wall_clock))

    def work(self, duration: float, function: Callable[[], T]) -> Work[T]:
        """Compute beside the node; see ``Port.work``."""
        return self.port.work(duration, function)

    def time_stepper(self, source: TimeSource, factor: float) -> Stepper:
        """Be the source of simulated time."""
        return self.port.time_stepper(source, factor)

    def now_ns(self) -> int:
        """Return the node's clock [ns]."""
        return self.port.now_ns()

    def knows_time(self) -> bool:
        """Whether the node's clock has a reading: simulated time has none before its first message.

        The age of a sample cannot be checked before.
        """
        return self.port.knows_time()

    def event(self, report: EventReport, *, diagnoses: bool = False) -> None:
        """Publish and log an event; ``diagnoses``: also on diagnostics, unless its level is OK."""
        name, message, level = report.name.value, report.message, report.level
        status = Status(name, message, level, self.NAME, report.texts())
        stamp = self.now_ns() if report.stamp_ns is None else report.stamp_ns
        self._events.send(StatusSample(stamp, (status,)))
        if self._log_limit.take(name):
            self.port.log(level, f"{name}: {message}")
        if diagnoses and level is not Level.OK:
            self.report(replace(status, name=f"{self.NAME}: {name}"))

    def end_command(self, change: EventReport, *kinds: str) -> None:
        """End the first open command, or the first one of these kinds, because of an event.

        The event's reason determines its last state; without a reason it is done.
        """
        result = {name: text for name, text in change.texts().items() if name != "reason"}
        reason = change.reason or Reason.COMPLETED
        self.commands.end(reason, change.message, *kinds, result=result)

    def refuse(self, refusal: Refusal) -> bool:
        """Report a refusal with its reason on diagnostics.

        ``RefusalLog`` limits the rate; returns whether it is reported now.
        """
        status = self._refusals.take(refusal)
        if status is None:
            return False
        self.report(status)
        self.port.log(Level.WARN, f"refused {refusal}")
        return True

    def report(self, status: Status) -> None:
        """Publish one status on diagnostics at once."""
        self._diagnostics.send(StatusSample(self.now_ns(), (status,)))

    def unready(self) -> str:
        """Why no message can be accepted now; empty = it can."""
        if not self.active:
            return f"{self.NAME} is not active, it must be activated first"
        if not self.knows_time():
            return f"{self.NAME} follows simulated time and has not received {topics.CLOCK} yet"
        return ""

    def _publish_command(self, record: CommandRecord) -> None:
        self._command_records.send(StatusSample(self.now_ns(), (record.status(),)))

    def clock_went_back(self) -> None:
        """Called by the host when simulated time has gone back."""
        self.reception.forget_stamps()
        self._notify(self.clock_jumped)
        self.commands.discard(Reason.CLOCK_JUMP, "the clock went back")

    def _notify(self, react: Callable[[], None]) -> None:
        """Let the component react to a change, once it is active."""
        if self.active:
            react()
        elif react not in self._changes:
            self._changes.append(react)

    # --- health and configuration ----------------------------------------------------------------

    def _current_health(self) -> Health:
        """State of the node and the inputs that it waits for."""
        if not self.active:
            return Health(self.NAME, HealthState.INACTIVE)
        missing = tuple(self.waiting_for()) if self.knows_time() else (topics.CLOCK,)
        return Health(self.NAME, HealthState.WAITING if missing else HealthState.READY, missing)

    def publish_health(self) -> None:
        """Publish the health, and the refusals that were held back."""
        self._published_health = health = self._current_health()
        held_back = self._refusals.end_period()
        for status in held_back:
            self.port.log(Level.WARN, f"{status.name}: {status.message}")
        for line in self._log_limit.end_period():
            self.port.log(Level.WARN, line)
        values = {
            "accepted": str(self.reception.accepted),
            "refused": str(self._refusals.refused),
        }
        for owned, owner in self.reception.owners().items():
            values[f"owner of {owned}"] = owner
        own = health.status(values)
        self._diagnostics.send(StatusSample(self.now_ns(), (own, *self.health(), *held_back)))

    def _publish_health_change(self) -> None:
        """Publish the health at once if it has changed: other nodes may wait for it."""
        self.reception.process_latched()
        if self._current_health() != self._published_health:
            self.publish_health()

    def _publish_configuration(self) -> None:
        parameters = {
            name: value
            for group in self._groups.values()
            for name, value in dataclasses.asdict(group).items()
        }
        content = {
            "node": self.full_name,
            "package": PACKAGE,
            "package_version": package_version(),
            "contract_version": CONTRACT_VERSION,
            "parameters": parameters,
            **self.configuration(),
        }
        self._last_configuration = json.dumps(content, sort_keys=True)
        self._config.send(TextSample(self._last_configuration))

    # --- life cycle, called by the host ----------------------------------------------------------

    def configure(self) -> None:
        """Configure; on a failure release what was opened and raise it."""
        try:
            self.setup()
        except Exception:
            self.release()
            _cancel(self._opened)
            raise
        self._changes.clear()
        self._publish_configuration()

    def activate(self) -> None:
        """Activate; on a failure stay inactive and raise it."""
        self.active = True
        self.reception.restart()
        try:
            self.start()
            changes, self._changes = self._changes, []
            for react in changes:
                react()
        except Exception:
            self.active = False
            _cancel(self._timers)
            raise
        self.reception.process_latched()
        self.every(_READINESS_PERIOD, self._publish_health_change, by_wall_clock=True)
        self.event(EventReport(NodeEvent.ACTIVE, f"{self.NAME} is active"))

    def deactivate(self) -> None:
        """Deactivate; may be called in any state."""
        _cancel(self._timers)
        if self.active:
            try:
                self.stop()
            finally:
                self.commands.discard(Reason.SHUTDOWN, f"{self.NAME} stops")
                self.active = False
            self.event(EventReport(NodeEvent.INACTIVE, f"{self.NAME} is inactive"))

    def clean_up(self) -> None:
        """Deactivate and release everything; may be called in any state."""
        self.deactivate()
        self.release()
        self._last_configuration = None
        _cancel(self._opened)

    def check_shutdown(self) -> None:
        """End a long transition early if a shutdown is requested.

        Raises:
            ShutdownRequested: a shutdown is requested.
        """
        if self.shutdown_requested():
            raise ShutdownRequested


def parts_of(settings: type[Any]) -> Mapping[str, type[Any]]:
    """Parameter classes of the fields of settings, by name of the field."""
    values = {part.name: getattr(settings(), part.name) for part in dataclasses.fields(settings)}
    return {name: type(value) for name, value in values.items() if dataclasses.is_dataclass(value)}


def _cancel(opened: list[Cancel]) -> None:
    for cancel in opened:
        cancel()
    opened.clear()
