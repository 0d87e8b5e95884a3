"""Lockstep: joins the loop hosts of several processes, so that simulated time waits for all.

After each tick a process reports to the process with the source of time what its components have
sent. The source of time releases the next tick when it has the reports of all members: the release
carries the time, the members and the reports. So a process receives what it needs in one message.

Reports and releases may be lost: the source of time repeats a release that a report is missing of,
and a process that has run the tick reports again.

What reaches a process by its topics beside that comes from outside, unless a member has reported
the same bytes. It is received in the tick that takes it. Pure: no ROS, no waiting.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from msg_schemas.access import Act
from msg_schemas.table import find_topic
from rover_runtime.loop_host import LoopHost
from rover_runtime.loop_port import LoopPort
from rover_runtime.remote import OPERATOR, Call, Response, Sent

_OUTSIDE_AFTER = 2  # ticks without a report of a message's bytes: a member is ahead by two at most
# A report: tick, length of its names and of its requests, number of its messages.
_REPORT = struct.Struct("<qIII")
# A message: numbers of the names of topic and sender, sequence, tick in which it is due, length.
_SENT = struct.Struct("<HHqqI")
# A release: tick, time, length of the processes' names, their number.
_RELEASE = struct.Struct("<qqII")
# A process: first tick as a member, whether its report is there, and the report's length.
_PROCESS = struct.Struct("<q?I")
_NO_MEMBER = -1


@dataclass
class Report:
    """What the components of a process have sent in a tick.

    Attributes:
        process: name of the process.
        tick: number of the tick.
        sent: messages to other processes with their bytes.
        calls: requests to services of other processes.
        responses: responses to requests of other processes.
    """

    process: str
    tick: int
    sent: list[tuple[Sent, bytes]] = field(default_factory=list)
    calls: list[Call] = field(default_factory=list)
    responses: list[Response] = field(default_factory=list)

    def to_bytes(self) -> bytes:
        """Return the report: names, requests in JSON, a table of the messages, their bytes."""
        numbers = {self.process: 0}
        table = [
            _SENT.pack(
                numbers.setdefault(topic, len(numbers)),
                numbers.setdefault(sender, len(numbers)),
                sequence,
                due,
                len(data),
            )
            for (topic, sender, sequence, due), data in self.sent
        ]
        requests = b""
        if self.calls or self.responses:
            requests = json.dumps((self.calls, self.responses), separators=(",", ":")).encode()
        names = "\n".join(numbers).encode()
        head = _REPORT.pack(self.tick, len(names), len(requests), len(self.sent))
        return b"".join((head, names, requests, *table, *(data for _, data in self.sent)))

    @staticmethod
    def from_bytes(data: bytes, is_needed: Callable[[str], bool] = lambda _topic: True) -> Report:
        """Read a report.

        Args:
            data: the report.
            is_needed: whether the messages of a topic are read; others are left out.

        Raises:
            ValueError: the bytes are none.
        """
        try:
            tick, names_size, requests_size, count = _REPORT.unpack_from(data)
            begin = _REPORT.size + names_size
            names = data[_REPORT.size : begin].decode().split("\n")
            requests = data[begin : begin + requests_size]
            begin += requests_size
            end = begin + count * _SENT.size
            table = list(_SENT.iter_unpack(data[begin:end]))
            sent = []
            needed: dict[int, bool] = {}
            for topic, sender, sequence, due, length in table:
                begin, end = end, end + length
                if topic not in needed:
                    needed[topic] = is_needed(find_topic(names[topic]).name)
                if needed[topic]:
                    message = Sent(names[topic], names[sender], sequence, due)
                    sent.append((message, data[begin:end]))
            calls, responses = json.loads(requests) if requests else ((), ())
            if len(table) != count or end != len(data):
                msg = f"a report of {count} messages should have {end} bytes, it has {len(data)}"
                raise ValueError(msg)
            return Report(
                names[0],
                tick,
                sent,
                [
                    Call(str(name), str(caller), int(number), tuple(map(bool, given)), int(due))
                    for name, caller, number, given, due in calls
                ],
                [
                    Response(str(name), str(to), int(n), str(by), bool(ok), str(text), int(due))
                    for name, to, n, by, ok, text, due in responses
                ],
            )
        except (struct.error, TypeError, IndexError, KeyError, OverflowError, RecursionError) as e:
            msg = f"{data[:200]!r} is no report of a tick: {e}"
            raise ValueError(msg) from e


@dataclass
class Release:
    """The release of a tick by the source of time.

    Attributes:
        tick: number of the released tick.
        now_ns: its simulated time [ns].
        members: first tick whose report is awaited, by process.
        reports: bytes of the report of the past tick, by process.
    """

    tick: int
    now_ns: int
    members: dict[str, int]
    reports: dict[str, bytes]

    def to_bytes(self) -> bytes:
        """Return the release: names of the processes, a table of them, their reports."""
        processes = tuple(self.members | self.reports)
        table = [
            _PROCESS.pack(
                self.members.get(name, _NO_MEMBER),
                name in self.reports,
                len(self.reports.get(name, b"")),
            )
            for name in processes
        ]
        reports = [self.reports[name] for name in processes if name in self.reports]
        names = "\n".join(processes).encode()
        head = _RELEASE.pack(self.tick, self.now_ns, len(names), len(table))
        return b"".join((head, names, *table, *reports))

    @staticmethod
    def from_bytes(data: bytes) -> Release:
        """Read a release.

        Raises:
            ValueError: the bytes are none.
        """
        try:
            tick, now_ns, names_size, count = _RELEASE.unpack_from(data)
            begin = _RELEASE.size + names_size
            names = data[_RELEASE.size : begin].decode().split("\n")
            end = begin + count * _PROCESS.size
            members: dict[str, int] = {}
            reports: dict[str, bytes] = {}
            table = _PROCESS.iter_unpack(data[begin:end])
            for name, (first, has_report, length) in zip(names, table, strict=True):
                if first != _NO_MEMBER:
                    members[name] = first
                if has_report:
                    begin, end = end, end + length
                    reports[name] = data[begin:end]
            if end != len(data):
                msg = f"a release of {count} processes should have {end} bytes, it has {len(data)}"
                raise ValueError(msg)
            return Release(tick, now_ns, members, reports)
        except struct.error as error:
            msg = f"{data[:200]!r} is no release of a tick: {error}"
            raise ValueError(msg) from error


class Network(Protocol):
    """Carries messages, reports and releases between the processes."""

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""

    def publish(self, component: str, topic: str, data: bytes) -> None:
        """Send a message of a component to those who listen outside the lockstep."""

    def report(self, data: bytes) -> None:
        """Send a report to the process with the source of time."""

    def release(self, data: bytes) -> None:
        """Send a release to all other processes."""

    def is_received(self, topic: str) -> bool:
        """Whether anybody outside this process receives a topic."""

    def is_needed(self, topic: str) -> bool:
        """Whether a component of another process receives a topic."""

    def is_watched(self, topic: str) -> bool:
        """Whether this process receives the messages of a topic that come from outside."""

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""


class _Arrival(NamedTuple):
    topic: str
    digest: int
    data: bytes
    tick: int  # in which it arrived


class LockstepProcess:
    """One process of several that share simulated time.

    Args:
        name: of the process.
        host: carries the components of the process, which are started later.
        network: to the other processes.

    Attributes:
        members: first tick whose report is awaited, by process.
    """

    def __init__(self, name: str, host: LoopHost, network: Network) -> None:
        self.name = name
        self.host = host
        self.members: dict[str, int] = {}
        self._network = network
        self._held: list[tuple[Sent, bytes]] = []  # until the first tick
        self._report = Report(name, 0)
        self._past = Report(name, -1)  # of the past tick, where this is the source of time
        self._is_shared = False  # whether there are other processes, excluded ones too
        self._reports: dict[int, dict[str, tuple[Report, bytes]]] = {}  # by tick and process
        self._release: Release | None = None
        self._received = b""  # the last release that this process has taken
        self._sent = b""  # the last release or report that it has sent
        self._released: list[Report] = []  # the others' reports in the release
        # Messages of members on their way by their topics, and messages that nobody has reported.
        self._expected: Counter[tuple[str, int]] = Counter()
        self._arrivals: deque[_Arrival] = deque()
        self._outside_count = 0
        host.exchange.remote = self  # before its components are started

    # --- what the components send, by the exchange of messages -----------------------------------

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""
        self._network.open(act, port, name)

    def is_received(self, topic: str) -> bool:
        """Whether anybody outside this process receives a topic."""
        return self._network.is_received(topic)

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""
        return self._network.is_served(service)

    def send(self, sent: Sent, data: bytes) -> None:
        """Send a message; before the first tick it waits until the processes have met."""
        if not self.is_member:
            self._held.append((sent, data))
            return
        self._network.publish(sent.sender, sent.topic, data)
        if self._network.is_watched(sent.topic):
            self._expected[sent.topic, _digest(data)] += 1
        if self._network.is_needed(sent.topic):
            self._report.sent.append((sent, data))

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

    def on_message(self, topic: str, data: bytes) -> None:
        """Take a message that has arrived by its topic."""
        self._arrivals.append(_Arrival(topic, _digest(data), data, self.host.exchange.ticks))

    def on_report(self, data: bytes) -> None:
        """Take the report of a member, as the source of time."""
        report = Report.from_bytes(data)
        if report.process in self.members and report.tick >= self.host.exchange.ticks - 1:
            self._reports.setdefault(report.tick, {})[report.process] = report, data

    def on_release(self, data: bytes) -> None:
        """Take a release of the source of time."""
        if data == self._received:
            if self._release is None:  # its tick ran, and the report was lost
                self._network.report(self._sent)
            return
        release = Release.from_bytes(data)
        others = [d for name, d in release.reports.items() if name != self.name]
        reports = [Report.from_bytes(each, self._is_needed) for each in others]
        first = release.members.get(self.name)
        if first == release.tick:
            self._join(release.members, first)
        elif first is None or not self.is_member:
            self.members.clear()
            return
        if release.tick == self.host.exchange.ticks:
            self.members, self._release = release.members, release
            self._received, self._released = data, reports

    def _is_needed(self, topic: str) -> bool:
        return self.host.exchange.is_subscribed(topic) or self._network.is_watched(topic)

    def _join(self, members: dict[str, int], first: int) -> None:
        if first < self.host.exchange.ticks:  # the source of time was started again
            self._expected.clear()
            self._arrivals.clear()
        self.host.exchange.restart_at(first)
        self._report = Report(self.name, first)
        self.members = members
        for sent, data in self._held:
            self.send(sent._replace(due=max(sent.due, first + 1)), data)
        self._held.clear()

    def exclude(self, process: str) -> None:
        """Wait for a process no longer."""
        self.members.pop(process, None)

    # --- ticks -----------------------------------------------------------------------------------

    def begin(self, processes: Iterable[str]) -> None:
        """Let all processes start with the first tick, as the one with the source of time."""
        self._join(dict.fromkeys(processes, 0), 0)
        self._is_shared = len(self.members) > 1

    def invite(self, process: str) -> None:
        """Make a process a member from the next tick on."""
        self.members[process] = self.host.exchange.ticks

    def missing(self) -> tuple[str, ...]:
        """Processes that the next tick waits for."""
        if not self.host.has_source:
            return () if self._release is not None else ("the source of time",)
        past = self.host.exchange.ticks - 1
        reports = self._reports.get(past, {})
        return tuple(
            each
            for each, first in self.members.items()
            if first <= past and each != self.name and each not in reports
        )

    def computing(self) -> tuple[str, ...]:
        """Components of this process for whose computations the next tick waits."""
        if not self.is_member or self.missing():
            return ()
        return self.host.computing(self._next_ns)

    @property
    def _next_ns(self) -> int:
        """Simulated time of the next tick [ns]."""
        return self.host.now_ns() if self._release is None else self._release.now_ns

    def repeat_release(self) -> None:
        """Send the last release again, because it or a report was lost."""
        if self.missing():
            self._network.release(self._sent)

    def run_tick(self) -> bool:
        """Run the next tick if nothing is missing; returns whether it ran."""
        host = self.host
        if not self.is_member or self.missing():
            return False
        now_ns = self._next_ns
        if host.computing(now_ns):
            return False
        if host.has_source:
            received = self._reports.pop(host.exchange.ticks - 1, {})
            reports = [report for report, _ in received.values()]
            if self._is_shared:  # by its releases an excluded process learns that it is no member
                data = {self.name: self._past.to_bytes()} | {n: d for n, (_, d) in received.items()}
                self._sent = Release(host.exchange.ticks, now_ns, self.members, data).to_bytes()
                self._network.release(self._sent)
        else:
            assert self._release is not None
            reports, self._release = self._released, None
            host.advance(now_ns)
        self._take(reports)
        self._take_outside()
        host.step()
        report, self._report = self._report, Report(self.name, host.exchange.ticks)
        if host.has_source:
            self._past = report
            host.advance(host.next_ns)
        else:
            self._sent = report.to_bytes()
            self._network.report(self._sent)
        return True

    def _take(self, reports: Iterable[Report]) -> None:
        """Schedule what the other members have sent in the past tick."""
        for report in reports:
            for sent, data in report.sent:
                self.host.exchange.receive_bytes(sent, data)
                if self._network.is_watched(sent.topic):
                    self._expected[sent.topic, _digest(data)] += 1
            for call in report.calls:
                self.host.exchange.receive_call(call)
            for response in report.responses:
                self.host.exchange.receive_response(response)

    def _take_outside(self) -> None:
        """Receive the messages that no member has reported."""
        ticks, waiting = self.host.exchange.ticks, deque[_Arrival]()
        for each in self._arrivals:
            topic, digest, data, arrived = each
            count = self._expected.pop((topic, digest), 0)
            if count:
                if count > 1:
                    self._expected[topic, digest] = count - 1
            elif arrived + _OUTSIDE_AFTER > ticks:
                waiting.append(each)
            else:
                self._outside_count += 1
                sent = Sent(topic, OPERATOR, self._outside_count, ticks)
                self.host.exchange.receive_bytes(sent, data)
        self._arrivals = waiting


def _digest(data: bytes) -> int:
    """Return the digest of a message's bytes; the middleware may append zeros."""
    return zlib.crc32(data.rstrip(b"\0"))
