"""Run a simulation in a thread of its own, paced; other threads send it requests.

Only this thread accesses the simulation. It serves requests (commands, pause, reset ...) between
two ticks, also while it waits for the next one. No ROS.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from msg_schemas import topics
from msg_schemas.events import EventReport, SimulationEvent
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample
from rover_sim.sim_loop import NANO, Pacer, Simulation, Tick

T = TypeVar("T")

# A plant that has stopped computes nothing: simulated time then runs in real time.
_FACTOR_WHEN_STOPPED = 1.0
_POLL_PERIOD = 0.5  # [s]


class SimulationListener(Protocol):
    """Callbacks of the simulation, called in its thread."""

    def on_tick(self, tick: Tick[Any], before_ns: int) -> None:
        """Handle a tick."""

    def on_restart(self) -> None:
        """Handle a state without a preceding tick: at the start and after a reset."""

    def on_event(self, report: EventReport) -> None:
        """Handle an event outside the ticks."""

    def on_finish(self) -> None:
        """Handle the end of the duration, or an earlier stop of the plant; time is paused."""

    def on_crash(self, error: Exception) -> None:
        """Handle an unexpected error that has ended the thread."""


@dataclass(frozen=True)
class _Request(Generic[T]):
    act: Callable[[], T]
    answer: Future[T]

    def serve(self) -> None:
        if not self.answer.set_running_or_notify_cancel():
            return
        try:
            self.answer.set_result(self.act())
        except Refusal as refusal:
            self.answer.set_exception(refusal)
        except Exception as error:
            self.answer.set_exception(error)
            raise


class SimRunner:
    """Runs a simulation at its real-time factor until it is stopped.

    Args:
        simulation: to run; no other thread may access it while the thread lives.
        factor: simulated seconds per wall second; 0 = as fast as possible.
        listener: receives the callbacks.
        paused: whether time is paused at first.
        duration: simulated time at which the run ends [s]; 0 = never.
    """

    def __init__(
        self,
        simulation: Simulation[Any],
        factor: float,
        listener: SimulationListener,
        *,
        paused: bool = False,
        duration: float = 0.0,
    ) -> None:
        self.simulation = simulation
        self.pacer = Pacer(factor)
        self.paused = paused
        self._factor = factor
        self._listener = listener
        self._duration_ns = round(duration * NANO)
        self._finished = False
        self._requests: queue.Queue[_Request[Any] | None] = queue.Queue()
        self._thread: threading.Thread | None = None

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]; any thread may read it."""
        return self.simulation.stamp_ns

    # --- from other threads ----------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self.pacer.restart()
        self._requests = queue.Queue()
        self._thread = threading.Thread(target=self._run, name="plant")
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the current tick; it may be started again."""
        if self._thread is not None:
            self._requests.put(None)
            self._thread.join()
            self._thread = None

    def call(self, act: Callable[[], T]) -> T:
        """Call a function in the thread, between two ticks, and return its result.

        Raises:
            Refusal: from ``act``; or the simulation is not running.
        """
        request = _Request(act, Future[T]())
        self._requests.put(request)
        while True:
            alive = self._thread is not None and self._thread.is_alive()
            # A thread that has just ended may have answered before.
            wait([request.answer], timeout=_POLL_PERIOD if alive else 0.0)
            if request.answer.done():
                return request.answer.result()
            if not alive:
                request.answer.cancel()
                raise Refusal("simulation", RefusalCode.NOT_ACTIVE, "the simulation is not running")

    def command(self, topic: str, sample: JointSample) -> None:
        """Pass a command to a drive; raises Refusal."""
        self.call(lambda: self.simulation.accept_command(topic, sample))

    def set_factor(self, factor: float) -> None:
        """Continue at another real-time factor."""

        def act() -> None:
            self._factor = factor
            self.pacer.set_factor(factor)

        self.call(act)

    def pause(self, pause: bool) -> str:
        """Pause or resume simulated time; returns a message."""
        return self.call(lambda: self._pause(pause))

    def step(self) -> str:
        """Simulate one tick while paused; raises Refusal."""
        return self.call(self._step)

    def reset(self, *, clock: bool) -> str:
        """Reset the plant to its start and, with ``clock``, simulated time to zero."""
        return self.call(lambda: self._reset(clock))

    # --- in the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._listener.on_restart()
            due_in = 0.0
            while True:
                request = self._next_request(due_in)
                if request is _TICK:
                    self._advance()
                elif request is None:
                    return
                else:
                    request.serve()
                due_in = self.pacer.wait(time.monotonic(), self.stamp_ns)
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self._listener.on_crash(error)

    def _next_request(self, due_in: float) -> _Request[Any] | None:
        """Return the next request (None = stop), or ``_TICK`` when it is time for a tick."""
        if self.paused:
            return self._requests.get()
        # No SimpleQueue: preempted, its get() may compute a negative timeout, which waits for ever.
        try:
            return self._requests.get(block=due_in > 0.0, timeout=due_in)
        except queue.Empty:
            return _TICK

    def _advance(self) -> None:
        before_ns = self.stamp_ns
        tick = self.simulation.tick()
        self._listener.on_tick(tick, before_ns)
        stopped = tick.after.phase.final
        if stopped and self.pacer.factor == 0.0:
            self.pacer.set_factor(_FACTOR_WHEN_STOPPED)
        over = self._duration_ns > 0 and (stopped or self.stamp_ns >= self._duration_ns)
        if over and not self._finished:
            self._finished = self.paused = True
            self._listener.on_finish()

    def _pause(self, pause: bool) -> str:
        if pause == self.paused:
            return f"already {'paused' if pause else 'running'}"
        self.paused = pause
        self.pacer.restart()
        name = "paused" if pause else "resumed"
        event = SimulationEvent.PAUSED if pause else SimulationEvent.RESUMED
        at = f"at {self.stamp_ns / NANO:g} s"
        text = f"simulated time {name} {at}"
        self._listener.on_event(EventReport(event, text, stamp_ns=self.stamp_ns))
        return f"{name} {at}"

    def _step(self) -> str:
        if not self.paused:
            raise Refusal(
                topics.SIM_STEP,
                RefusalCode.WRONG_PHASE,
                f"simulated time is running; pause it first ({topics.SIM_PAUSE})",
            )
        self._advance()
        return f"at {self.stamp_ns / NANO:g} s"

    def _reset(self, clock: bool) -> str:
        before = self.stamp_ns / NANO
        if clock:
            self.simulation.reset()
        else:
            self.simulation.reset_plant()
        self._finished = False
        self.pacer.set_factor(self._factor)
        name = SimulationEvent.RESET if clock else SimulationEvent.PLANT_RESET
        what = "plant and clock" if clock else "the plant"
        message = f"reset {what} to the start, at {before:g} s"
        self._listener.on_event(EventReport(name, message, stamp_ns=self.stamp_ns))
        self._listener.on_restart()
        return message


_TICK: _Request[None] = _Request(lambda: None, Future())
