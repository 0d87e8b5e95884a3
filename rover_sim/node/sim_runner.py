"""A simulation as a source of simulated time: pause, single steps, resets and its end. No ROS."""

from __future__ import annotations

from typing import Any, Protocol

from msg_schemas import topics
from msg_schemas.events import EventReport, SimulationEvent
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample
from rover_runtime.pacing import NANO, Stepper, TimeSource
from rover_sim.node.sim_loop import Simulation, Tick

# A plant that has stopped computes nothing: simulated time then runs in real time.
_FACTOR_WHEN_STOPPED = 1.0


class SimulationListener(Protocol):
    """Callbacks of the simulation, called by its stepper."""

    def on_tick(self, tick: Tick[Any], before_ns: int) -> None:
        """Handle a tick."""

    def on_restart(self) -> None:
        """Handle a state without a preceding tick: at the start and after a reset."""

    def on_event(self, report: EventReport) -> None:
        """Handle an event outside the ticks."""

    def on_finish(self) -> None:
        """Handle the end of the duration, or an earlier stop of the plant; time is paused."""

    def on_crash(self, error: Exception) -> None:
        """Handle an unexpected error that has ended simulated time."""


class TimeStepper(Protocol):
    """Returns what advances a source of time; ``Component.time_stepper``."""

    def __call__(self, source: TimeSource, factor: float) -> Stepper:
        """Advance the source at a real-time factor."""


class SimRunner:
    """Runs a simulation until it is stopped.

    Args:
        simulation: to run; nothing else may access it meanwhile.
        factor: simulated seconds per wall second; 0 = as fast as possible.
        listener: receives the callbacks.
        time_stepper: returns what advances the simulation.
        paused: whether time is paused at first.
        duration: simulated time at which the run ends [s]; 0 = never.
    """

    def __init__(
        self,
        simulation: Simulation[Any],
        factor: float,
        listener: SimulationListener,
        time_stepper: TimeStepper,
        *,
        paused: bool = False,
        duration: float = 0.0,
    ) -> None:
        self.simulation = simulation
        self.paused = paused
        self._factor = factor
        self._listener = listener
        self._duration_ns = round(duration * NANO)
        self._finished = False
        self._stepper = time_stepper(self, factor)
        self.pacer = self._stepper.pacer

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]; any thread may read it."""
        return self.simulation.stamp_ns

    @property
    def next_ns(self) -> int:
        """Simulated time after the next tick [ns]."""
        return self.simulation.stamp_ns + self.simulation.tick_ns

    # --- from other threads ----------------------------------------------------------------------

    def start(self) -> None:
        """Start simulated time."""
        self._stepper.start()

    def stop(self) -> None:
        """Stop simulated time after the current tick; it may be started again."""
        self._stepper.stop()

    def command(self, topic: str, sample: JointSample) -> None:
        """Pass a command to a drive; raises Refusal."""
        self._stepper.call(lambda: self.simulation.accept_command(topic, sample))

    def set_factor(self, factor: float) -> None:
        """Continue at another real-time factor."""

        def act() -> None:
            self._factor = factor
            self.pacer.set_factor(factor)

        self._stepper.call(act)

    def pause(self, pause: bool) -> str:
        """Pause or resume simulated time; returns a message."""
        return self._stepper.call(lambda: self._pause(pause))

    def step(self) -> str:
        """Simulate one tick while paused; raises Refusal."""
        return self._stepper.call(self._step)

    def reset(self, *, clock: bool) -> str:
        """Reset the plant to its start and, with ``clock``, simulated time to zero."""
        return self._stepper.call(lambda: self._reset(clock))

    # --- called by the stepper -----------------------------------------------------------------

    def begin(self) -> None:
        """Publish the state before the first tick."""
        self._listener.on_restart()

    def advance(self) -> None:
        """Simulate one tick."""
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

    def on_crash(self, error: Exception) -> None:
        """Report an unexpected error."""
        self._listener.on_crash(error)

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
        self.advance()
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
