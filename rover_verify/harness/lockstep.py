"""Simulated time that goes on only when a node has answered the last tick.

A machine that is too busy for its nodes to keep up in real time is slow then, and not wrong.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from msg_schemas import topics
from msg_schemas.codecs import message_class
from msg_schemas.table import SERVICES
from rover_verify.harness.observer import Observer
from rover_verify.harness.processes import PATIENCE

_LOOK = 0.0005  # [s]


class Lockstep:
    """Steps a simulator by its service, from its pause on until `release`.

    Args:
        observer: that hears and calls.
        answer: topic by which the node answers each tick.
        followers: topics of nodes that answer less often, once they have begun.
        lag: by which stamps of these may be behind [s].
    """

    _ANSWER = 5.0  # a tick's answer is waited for so long [s]

    def __init__(
        self, observer: Observer, answer: str, followers: Iterable[str] = (), lag: float = 0.0
    ) -> None:
        self._observer = observer
        self._answers = observer.listen(answer)
        self._followers = {name: observer.listen(name) for name in followers}
        self._gone: dict[str, int] = {}  # messages that had come when one was given up
        self._lag_ns = round(lag * 1e9)
        self._kind = message_class(SERVICES[topics.SIM_STEP].service)
        self._client = observer.node.create_client(self._kind, topics.SIM_STEP)
        observer.wait_until(self._client.service_is_ready, "the simulator cannot be stepped")
        observer.call(topics.SIM_PAUSE, True)

    def run_until(self, condition: Callable[[], bool], limit: float) -> None:
        """Step until a condition holds; AssertionError after so much simulated time [s]."""
        end = self._observer.time_ns() + round(limit * 1e9)
        while not condition():
            assert self._observer.time_ns() < end, f"not within {limit:g} s of simulated time"
            self.step()

    def step(self) -> None:
        """Make one tick, and wait for its answer."""
        heard = self._answers.last
        before = 0 if heard is None else heard.stamp_ns
        done = threading.Event()
        future = self._client.call_async(self._kind.Request())
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE), f"{topics.SIM_STEP} gave no answer in {PATIENCE:g} s"
        give_up = time.monotonic() + self._ANSWER
        pause = threading.Event()
        while time.monotonic() < give_up:
            last = self._answers.last
            if last is not None and last.stamp_ns > before and not self._late():
                return
            pause.wait(_LOOK)
        self._gone |= {name: len(self._followers[name]) for name in self._late()}

    def _late(self) -> list[str]:
        """Followers that are waited for; who was given up is no more, until it is heard again."""
        now_ns = self._observer.time_ns()
        return [
            name
            for name, feed in self._followers.items()
            if len(feed) > self._gone.get(name, 0) and now_ns - feed.last.stamp_ns > self._lag_ns
        ]

    def release(self) -> None:
        """Let time run by itself again."""
        self._observer.node.destroy_client(self._client)
        self._observer.call(topics.SIM_PAUSE, False)
