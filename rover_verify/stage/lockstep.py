"""Simulated time that goes on only when a node has answered the last tick.

A machine that is too busy for its nodes to keep up in real time is slow then, and not wrong.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from msg_schemas import topics
from msg_schemas.codecs import message_class
from msg_schemas.table import SERVICES
from rover_verify.stage.observer import Observer
from rover_verify.stage.processes import PATIENCE

_LOOK = 0.0005  # [s]


class Lockstep:
    """Steps a simulator by its service, from its pause on until `release`.

    Args:
        observer: that hears and calls.
        answer: topic by which the node answers each tick.
    """

    _ANSWER = 5.0  # a tick's answer is waited for so long [s]

    def __init__(self, observer: Observer, answer: str) -> None:
        self._observer = observer
        self._answers = observer.listen(answer)
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
            if last is not None and last.stamp_ns > before:
                return
            pause.wait(_LOOK)

    def release(self) -> None:
        """Let time run by itself again."""
        self._observer.node.destroy_client(self._client)
        self._observer.call(topics.SIM_PAUSE, False)
