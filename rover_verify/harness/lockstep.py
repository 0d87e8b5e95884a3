"""Lockstep: simulated time advances only after a node has answered the last tick.

A computer that is too slow for real time does not change the result.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from msg_schemas import topics
from msg_schemas.message_types import message_class
from msg_schemas.table import SERVICES
from rover_verify.harness.observer import Observer
from rover_verify.harness.processes import DEFAULT_TIMEOUT

_POLL_PERIOD = 0.0005  # [s]


class Lockstep:
    """Steps a paused simulator by its service until `release`.

    Args:
        observer: subscribes and calls.
        answer: topic by which the node answers each tick.
        followers: topics of nodes that answer less often, awaited after their first message.
        lag: largest age of a follower's last stamp [s].
    """

    _ANSWER_TIMEOUT = 5.0  # of the answer to a tick [s]

    def __init__(
        self, observer: Observer, answer: str, followers: Iterable[str] = (), lag: float = 0.0
    ) -> None:
        self._observer = observer
        self._answers = observer.listen(answer)
        self._followers = {name: observer.listen(name) for name in followers}
        self._abandoned: dict[str, int] = {}  # number of messages when a follower was abandoned
        self._lag_ns = round(lag * 1e9)
        self._kind = message_class(SERVICES[topics.SIM_STEP].service)
        self._client = observer.node.create_client(self._kind, topics.SIM_STEP)
        observer.wait_until(self._client.service_is_ready, "the simulator cannot be stepped")
        observer.call(topics.SIM_PAUSE, True)

    def run_until(self, condition: Callable[[], bool], limit: float) -> None:
        """Step until a condition holds; AssertionError after `limit` of simulated time [s]."""
        end = self._observer.time_ns() + round(limit * 1e9)
        while not condition():
            assert self._observer.time_ns() < end, f"not within {limit:g} s of simulated time"
            self.step()

    def step(self) -> None:
        """Make one tick, and wait for its answer."""
        last_answer = self._answers.last
        before = 0 if last_answer is None else last_answer.stamp_ns
        done = threading.Event()
        future = self._client.call_async(self._kind.Request())
        future.add_done_callback(lambda _: done.set())
        assert done.wait(DEFAULT_TIMEOUT), (
            f"{topics.SIM_STEP} did not respond within {DEFAULT_TIMEOUT:g} s"
        )
        deadline = time.monotonic() + self._ANSWER_TIMEOUT
        pause = threading.Event()
        while time.monotonic() < deadline:
            last = self._answers.last
            if last is not None and last.stamp_ns > before and not self._late():
                return
            pause.wait(_POLL_PERIOD)
        self._abandoned |= {name: len(self._followers[name]) for name in self._late()}

    def _late(self) -> list[str]:
        """Awaited followers that lag; an abandoned one is awaited again after its next message."""
        now_ns = self._observer.time_ns()
        return [
            name
            for name, feed in self._followers.items()
            if len(feed) > self._abandoned.get(name, 0)
            and now_ns - feed.last.stamp_ns > self._lag_ns
        ]

    def release(self) -> None:
        """Resume the simulator."""
        self._observer.node.destroy_client(self._client)
        self._observer.call(topics.SIM_PAUSE, False)
