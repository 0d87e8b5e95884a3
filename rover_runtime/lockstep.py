"""Lockstep: joins the loop hosts of several processes, so that simulated time waits for all.

After each tick a process reports what its components have sent in it. A process starts the next
tick when it has the reports of all members and the messages that they name. The process with the
source of time decides who is a member, and what time the next tick has.

A message is known by the digest of its bytes: one that no member reports comes from outside, and is
received in the tick that takes it. Pure: no ROS, no waiting.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from msg_schemas.access import Act
from rover_runtime.loop_host import OPERATOR, LoopHost
from rover_runtime.loop_port import LoopPort
from rover_runtime.port import Message
from rover_runtime.remote import Call, Response, Sent

BEFORE_START = -1
"""Tick of the first report of the source of time, which starts the first tick."""
_JOIN_AFTER = 2  # ticks: by then all members report after they were announced a new one
_OUTSIDE_AFTER = 2  # ticks without a report that names a message: a member is ahead by two at most


@dataclass
class Report:
    """What the components of a process have sent in a tick.

    Attributes:
        process: name of the process.
        tick: number of the tick.
        sent: messages with the digests of their bytes.
        calls: requests to services of other processes.
        responses: responses to requests of other processes.
        next_ns: simulated time of the next tick [ns]; of the source of time only.
        members: first tick whose report is awaited, by process; of the source of time only.
    """

    process: str
    tick: int
    sent: list[tuple[Sent, int]] = field(default_factory=list)
    calls: list[Call] = field(default_factory=list)
    responses: list[Response] = field(default_factory=list)
    next_ns: int | None = None
    members: dict[str, int] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return the report as JSON."""
        return json.dumps(
            [
                self.process,
                self.tick,
                [[*sent, digest] for sent, digest in self.sent],
                self.calls,
                self.responses,
                self.next_ns,
                self.members,
            ],
            separators=(",", ":"),
        )

    @staticmethod
    def from_json(text: str) -> Report:
        """Read a report.

        Raises:
            ValueError: the text is none.
        """
        try:
            process, tick, sent, calls, responses, next_ns, members = json.loads(text)
            return Report(
                str(process),
                int(tick),
                [(Sent(*each[:-1]), int(each[-1])) for each in sent],
                [Call(*each)._replace(arguments=tuple(each[3])) for each in calls],
                [Response(*each) for each in responses],
                None if next_ns is None else int(next_ns),
                dict(members),
            )
        except (TypeError, IndexError) as error:
            msg = f"{text[:200]!r} is no report of a tick: {error}"
            raise ValueError(msg) from error


class Network(Protocol):
    """Carries messages and reports between the processes."""

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""

    def publish(self, component: str, topic: str, message: Message) -> int:
        """Send a message of a component; returns the digest of its bytes."""

    def report(self, report: Report) -> None:
        """Send a report to all other processes."""

    def is_received(self, topic: str) -> bool:
        """Whether another process receives a topic."""

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""


class _Waiting(NamedTuple):
    message: Message
    tick: int  # in which it arrived


class LockstepProcess:
    """One process of several that share simulated time; the ``Remote`` of its host.

    Args:
        name: of the process.
        host: carries the components of the process, which are started later.
        network: to the other processes.
    """

    def __init__(self, name: str, host: LoopHost, network: Network) -> None:
        self.name = name
        self.host = host
        self.members: dict[str, int] = {}  # first tick whose report is awaited
        self._network = network
        self._held: list[tuple[Sent, Message]] = []  # until the first tick
        self._report = Report(name, 0)
        self._reports: dict[int, dict[str, Report]] = {}
        # By tick: topic and digest of the reported messages that have not been seen to arrive.
        self._awaited: dict[int, dict[tuple[str, int], tuple[str, int]]] = {}
        self._arrived: dict[str, dict[int, deque[_Waiting]]] = {}  # by topic and digest
        self._arrivals: deque[tuple[str, int, int]] = deque()  # topic, digest and tick, in order
        self._own: Counter[tuple[str, int]] = Counter()  # own messages on their way back
        self._outside_count = 0
        self._source = ""  # process with the source of time
        host.remote = self  # before its components are started

    # --- what the components send (Remote) -------------------------------------------------------

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""
        self._network.open(act, port, name)

    def is_received(self, topic: str) -> bool:
        """Whether a topic has a receiver in another process."""
        return self._network.is_received(topic)

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""
        return self._network.is_served(service)

    def send(self, sent: Sent, message: Message) -> None:
        """Send a message; before the first tick it waits until the processes have met."""
        if not self.is_member:
            self._held.append((sent, message))
            return
        digest = self._network.publish(sent.sender, sent.topic, message)
        self._report.sent.append((sent, digest))
        if self.host.is_subscribed(sent.topic):
            self._own[sent.topic, digest] += 1

    def call(self, call: Call) -> None:
        """Send a request to a service."""
        self._report.calls.append(call)

    def respond(self, response: Response) -> None:
        """Send the response to a request."""
        self._report.responses.append(response)

    # --- what the others send --------------------------------------------------------------------

    @property
    def is_member(self) -> bool:
        """Whether the other processes wait for this one."""
        return self.name in self.members

    def on_message(self, topic: str, digest: int, message: Message) -> None:
        """Take a message that has arrived."""
        key = topic, digest
        if self._own[key] > 0:
            self._own[key] -= 1
            return
        waiting = self._arrived.setdefault(topic, {}).setdefault(digest, deque())
        waiting.append(_Waiting(message, self.host.ticks))
        self._arrivals.append((topic, digest, self.host.ticks))

    def on_report(self, report: Report) -> None:
        """Take a report that has arrived."""
        if report.next_ns is not None:
            self._source = report.process
            first = report.members.get(self.name)
            if not self.is_member and first is not None and first > report.tick:
                self._join(report.members, first)
            elif self.is_member:
                self.members = dict(report.members)
        if report.tick >= self.host.ticks - 1:
            awaited = self._awaited.setdefault(report.tick, {})
            for sent, digest in report.sent:
                if self.host.is_subscribed(sent.topic):
                    _, count = awaited.get((sent.topic, digest), ("", 0))
                    awaited[sent.topic, digest] = report.process, count + 1
            self._reports.setdefault(report.tick, {})[report.process] = report

    def _join(self, members: dict[str, int], first: int) -> None:
        self.host.restart_at(first)
        self._report = Report(self.name, first)
        self._reports = {tick: each for tick, each in self._reports.items() if tick >= first - 1}
        self.members = dict(members)
        for sent, message in self._held:
            self.send(sent._replace(due=max(sent.due, first + 1)), message)
        self._held.clear()

    def exclude(self, process: str) -> None:
        """Wait for a process no longer."""
        self.members.pop(process, None)

    # --- ticks -----------------------------------------------------------------------------------

    def begin(self, processes: Iterable[str]) -> None:
        """Start the first tick of all processes, as the one with the source of time."""
        self._source = self.name
        self._join(dict.fromkeys(processes, 0), 0)
        members = dict(self.members)
        start = Report(self.name, BEFORE_START, next_ns=self.host.now_ns(), members=members)
        self._network.report(start)

    def invite(self, process: str) -> None:
        """Make a process a member that has received all since a past tick."""
        self.members[process] = self.host.ticks + _JOIN_AFTER

    def missing(self) -> tuple[str, ...]:
        """Processes whose reports or messages the next tick waits for."""
        past = self.host.ticks - 1
        if not self.is_member:
            return (self._source or "the source of time",)
        if past == BEFORE_START:
            return ()
        reports = self._reports.get(past, {})
        silent = tuple(
            each
            for each, first in self.members.items()
            if first <= past and each != self.name and each not in reports
        )
        return silent or self._late(past)

    def _late(self, tick: int) -> tuple[str, ...]:
        """Process of a reported message that has not arrived; what has is not looked up again."""
        awaited = self._awaited.get(tick, {})
        while awaited:
            (topic, digest), (process, count) = awaited.popitem()
            if len(self._arrived.get(topic, {}).get(digest, ())) < count:
                awaited[topic, digest] = process, count
                return (process,) if process in self.members else ()
        return ()

    def run_tick(self) -> bool:
        """Run the next tick if nothing is missing; returns whether it ran."""
        host = self.host
        if self.missing():
            return False
        reports = self._reports.get(host.ticks - 1, {})
        next_ns = host.now_ns() if host.has_source else self._next_ns(reports)
        if host.is_computing(next_ns):
            return False
        self._reports.pop(host.ticks - 1, None)
        self._awaited.pop(host.ticks - 1, None)
        if not host.has_source:
            host.advance(next_ns)
        self._take(reports)
        self._take_outside()
        host.step()
        report, self._report = self._report, Report(self.name, host.ticks)
        if host.has_source:
            report.next_ns, report.members = host.next_ns, dict(self.members)
        self._network.report(report)
        if host.has_source:
            host.advance(host.next_ns)
        return True

    def _next_ns(self, reports: Mapping[str, Report]) -> int:
        source = reports.get(self._source)
        if source is None or source.next_ns is None:
            return self.host.now_ns()
        return source.next_ns

    def _take(self, reports: Mapping[str, Report]) -> None:
        """Schedule what the members have sent in the past tick."""
        for process in self.members:
            report = reports.get(process)
            if report is None:
                continue
            for sent, digest in report.sent:
                if self.host.is_subscribed(sent.topic):
                    waiting = self._arrived.get(sent.topic, {}).get(digest)
                    if not waiting:
                        continue  # of a process that was excluded meanwhile
                    self.host.receive(sent, waiting.popleft().message)
                    if not waiting:
                        del self._arrived[sent.topic][digest]
            for call in report.calls:
                self.host.receive_call(call)
            for response in report.responses:
                self.host.receive_response(response)

    def _take_outside(self) -> None:
        """Receive the messages that no member has reported."""
        ticks = self.host.ticks
        while self._arrivals and self._arrivals[0][2] + _OUTSIDE_AFTER <= ticks:
            topic, digest, arrived = self._arrivals.popleft()
            waiting = self._arrived.get(topic, {}).get(digest)
            if not waiting or waiting[0].tick > arrived:
                continue  # a member has reported it
            message = waiting.popleft().message
            if not waiting:
                del self._arrived[topic][digest]
            self._outside_count += 1
            self.host.receive(Sent(topic, OPERATOR, self._outside_count, ticks), message)
