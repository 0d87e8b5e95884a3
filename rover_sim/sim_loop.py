"""The simulation as it runs tick by tick: plant, clock, commands, pace. No ROS, no waiting."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic

from msg_schemas.samples import JointSample, Level
from rover_sim.actuators import Actuators, stopped
from rover_sim.planar_plant import PlanarPlant, PlanarState
from rover_sim.plant import Event, Outcome, Phase, S, StepResult

NANO = 1_000_000_000


@dataclass(frozen=True)
class Happening:
    """Something to tell: an event of the plant or of the simulation, at its simulated time."""

    name: str
    message: str
    stamp_ns: int
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Tick(Generic[S]):
    """What one tick did: the states around it, their times, and what happened."""

    before: S
    after: S
    dt: float  # [s]
    stamp_ns: int  # simulated time of `after`
    result: StepResult
    happenings: tuple[Happening, ...]


class Schedule:
    """Which topics are due after a tick, each at its rate in simulated time.

    Args:
        rates: topic -> rate [Hz], above 0.
    """

    def __init__(self, rates: Mapping[str, float]) -> None:
        self._rates = dict(rates)

    def due(self, before_ns: int, after_ns: int) -> list[str]:
        """Topics whose next instant lies in (before, after]."""
        return [
            name
            for name, rate in self._rates.items()
            if _count(after_ns, rate) > _count(before_ns, rate)
        ]


def _count(stamp_ns: int, rate: float) -> int:
    # The small addend keeps 0.29 s at 100 Hz on its 29th instant, however it was rounded.
    return math.floor(stamp_ns * rate / NANO + 1e-6)


class Pacer:
    """Holds simulated time to wall time by absolute deadlines.

    A delay is caught up as long as it is short; a longer one is given up, and
    counted, so that the simulation does not rush afterwards.

    Args:
        factor: simulated seconds per wall second; 0 = as fast as possible.
    """

    CATCH_UP = 0.2  # longest delay that is caught up [s]
    WINDOW = 2.0  # the measured factor's window [s]

    def __init__(self, factor: float) -> None:
        self.factor = factor
        self.given_up = 0.0  # wall time that could not be caught up [s]
        # Simulated per wall seconds over the last two wall seconds; None = not yet known.
        self.measured: float | None = None
        self._anchor: tuple[float, int] | None = None
        self._marks: deque[tuple[float, int]] = deque()
        self._late_until = -math.inf

    def set_factor(self, factor: float) -> None:
        """Go on at another factor."""
        self.factor = factor
        self.restart()

    def restart(self) -> None:
        """Start anew from the next tick on: after a pause, a reset or another factor."""
        self._anchor = None
        self.measured = None
        self._marks.clear()
        self._late_until = -math.inf

    def wait(self, wall: float, stamp_ns: int) -> float:
        """How long to wait before the next tick [s].

        Args:
            wall: monotonic wall time [s].
            stamp_ns: simulated time reached.
        """
        self._mark(wall, stamp_ns)
        if self.factor == 0.0:
            return 0.0
        if self._anchor is None:
            self._anchor = (wall, stamp_ns)
        start, start_ns = self._anchor
        deadline = start + (stamp_ns - start_ns) / NANO / self.factor
        late = wall - deadline
        if late > self.CATCH_UP:
            self.given_up += late
            self._late_until = wall + self.WINDOW
            self._anchor = (wall, stamp_ns)
        return max(0.0, -late)

    def _mark(self, wall: float, stamp_ns: int) -> None:
        self._marks.append((wall, stamp_ns))
        while len(self._marks) > 2 and wall - self._marks[1][0] > self.WINDOW:
            self._marks.popleft()
        past, past_ns = self._marks[0]
        if wall > past:
            self.measured = (stamp_ns - past_ns) / NANO / (wall - past)

    def keeps_up(self, wall: float) -> bool:
        """Whether no delay had to be given up within the window."""
        return wall > self._late_until


class Simulation:
    """A plant that runs: its state, simulated time, the drives' commands, and totals.

    Args:
        plant: the plant.
        tick: control tick [s].
    """

    def __init__(self, plant: PlanarPlant, tick: float) -> None:
        self.plant = plant
        self.tick_ns = round(tick * NANO)
        self._actuators = Actuators(plant.scenario)
        self._start = plant.initial_state()
        self.state = self._start
        self.stamp_ns = 0
        self.ticks = 0
        self.halved_ticks = 0
        self.peak_tension = 0.0
        self.last: StepResult | None = None

    @property
    def phase(self) -> Phase:
        """The plant's phase."""
        return self.state.phase

    def reset(self) -> None:
        """Start again: state, clock and totals."""
        self.reset_plant()
        self.stamp_ns = 0

    def reset_plant(self) -> None:
        """Put the plant back to its start; simulated time stays."""
        self._actuators.clear()
        self.state = self._start
        self.ticks = 0
        self.halved_ticks = 0
        self.peak_tension = 0.0
        self.last = None

    def command_jump(self, sample: JointSample) -> None:
        """Take a command for the jump motor; raises Refusal."""
        self._actuators.command_jump(
            sample, self.state.phase, self.state.compression, self.stamp_ns
        )

    def command_winch(self, sample: JointSample) -> None:
        """Take a command for the winch; raises Refusal."""
        self._actuators.command_winch(sample, self.state.phase)

    def tick(self) -> Tick[PlanarState]:
        """Advance by one tick."""
        before, before_ns = self.state, self.stamp_ns
        happenings = []
        silence = self._actuators.silenced(before_ns, before.compression)
        if silence is not None:
            happenings.append(_stopped_nut(silence, before.compression, before_ns))
        dt = self.tick_ns / NANO
        after, result = self.plant.step(before, self._actuators.command, dt)
        for event in result.events:
            stamp_ns = before_ns + round((event.time - before.time) * NANO)
            if event.name == "take_off":
                self._actuators.note_take_off(stamp_ns)
            happenings.append(_happening(event, stamp_ns, after, result, self.plant))
        if after.phase.final:
            self._actuators.clear()
        self.state = after
        self.stamp_ns += self.tick_ns
        self.ticks += 1
        self.halved_ticks += result.outcome is Outcome.HALVED
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self.last = result
        return Tick(before, after, dt, self.stamp_ns, result, tuple(happenings))


def _stopped_nut(silence: float, compression: float, stamp_ns: int) -> Happening:
    return Happening(
        "jump_motor_silent",
        f"no command for {silence:.3g} s while the nut moved: it stops at {compression:.4g} m",
        stamp_ns,
        Level.WARN,
        {"silence": silence, "compression": compression},
    )


def _happening(
    event: Event, stamp_ns: int, after: PlanarState, result: StepResult, plant: PlanarPlant
) -> Happening:
    values: dict[str, object] = dict(event.values)
    level = Level.OK
    if event.name == "diverged":
        level = Level.ERROR
        integration = plant.scenario.integration
        values |= {
            "plant_time": after.time,
            "newton_iterations": result.newton_iterations,
            "h": integration.h,
            "tolerance": integration.tolerance,
            "max_halvings": integration.max_halvings,
        }
        message = (
            f"{stopped(Phase.DIVERGED)}; the last good state, at {after.time:.6g} s, is kept; "
            "a smaller integration.h, a larger integration.max_halvings or a tether with damping "
            "may help"
        )
    elif event.name == "tether_broken":
        level = Level.ERROR
        message = f"{stopped(Phase.TETHER_BROKEN)}; tension {values['tension']:.4g} N"
    elif event.name == "take_off":
        message = f"the latch has tripped: the rover takes off at {values['speed']:.4g} m/s"
    elif event.name == "apex":
        message = f"highest at {values['height']:.4g} m over the start"
    elif event.name == "touchdown":
        message = (
            f"down after {values['flight_time']:.4g} s: height {values['height']:.4g} m, "
            f"attitude changed by {values['attitude_variation']:+.4g} rad, "
            f"travelled {values['travel']:+.4g} m"
        )
    else:
        message = event.name
    return Happening(event.name, message, stamp_ns, level, values)
