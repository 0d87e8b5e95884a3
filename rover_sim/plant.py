"""The plant contract: what every simulated plant takes, gives and promises.

A plant turns a state and a command into the state one control tick later. States are values: a
step never changes the one it is given, and the same state, command and tick give the same result.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from rover_sim.scenario import Scenario


class Outcome(enum.Enum):
    """How a step went."""

    CONVERGED = "converged"
    HALVED = "halved"  # converged, some of its time steps after halving
    DIVERGED = "diverged"  # stopped at the last good state
    TETHER_BROKEN = "tether_broken"  # stopped when the tether parted


class Phase(enum.Enum):
    """What the rover is doing, or why nothing moves any more."""

    HELD = "held"  # standing, held by the ground
    FLIGHT = "flight"
    LANDED = "landed"  # held again where it came down
    FREE = "free"  # no rover, or one that was never held
    DIVERGED = "diverged"
    TETHER_BROKEN = "tether_broken"

    @property
    def final(self) -> bool:
        """Whether further steps leave the state as it is."""
        return self in (Phase.DIVERGED, Phase.TETHER_BROKEN)


@dataclass(frozen=True)
class JumpMotorCommand:
    """Nut of the jump motor: compress the spring to `compression`, where the latch trips."""

    compression: float  # setpoint [m], >= 0; reaching one above 0 releases the spring
    rate: float  # speed of the nut [m/s], > 0


@dataclass(frozen=True)
class WheelMotorCommand:
    """Wheel motor, for plants that have one."""

    position: float  # [rad]
    velocity: float  # [rad/s]
    effort: float  # [N m]


@dataclass(frozen=True)
class WinchCommand:
    """Winch, for plants that have a drum."""

    length: float  # [m]
    velocity: float  # [m/s]
    tension: float  # [N]


@dataclass(frozen=True)
class Command:
    """What the actuators are asked to do during one tick; None leaves a motor off."""

    jump: JumpMotorCommand | None = None
    winch: WinchCommand | None = None
    wheel: WheelMotorCommand | None = None


@dataclass(frozen=True)
class Energies:
    """Where the energy is [J], and what came and went since the start of the run.

    Gravity's potential is zero at the level of the tether's root.
    """

    kinetic: float
    gravity: float
    axial: float
    bending: float
    spring: float
    input: float = 0.0  # by the jump drive and take-offs
    dissipated: float = 0.0  # by damping, and in holding the rover after a landing
    initial: float = 0.0  # stored at the start of the run

    @property
    def stored(self) -> float:
        """Kinetic and potential energy together [J]."""
        return self.kinetic + self.gravity + self.axial + self.bending + self.spring

    @property
    def drift(self) -> float:
        """What the energy balance misses [J]: stored - initial - input + dissipated."""
        return self.stored - self.initial - self.input + self.dissipated


@dataclass(frozen=True)
class Event:
    """Something that happened at an instant inside a step."""

    name: str  # take_off, apex, touchdown, tether_broken, diverged
    time: float  # [s]
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StepResult:
    """What a step reports besides the new state."""

    outcome: Outcome
    energies: Energies
    constraint_drift: float  # largest violation of a joint [m]
    newton_iterations: int  # in all time steps of the tick together
    smallest_step: float  # [s]; infinite if no time step was made
    events: tuple[Event, ...]
    peak_tension: float  # largest tension in the tether during the tick [N]


class State(Protocol):
    """What every plant's state has."""

    @property
    def time(self) -> float:
        """[s]."""

    @property
    def phase(self) -> Phase:
        """What the rover is doing."""


S = TypeVar("S", bound=State)


class Plant(Protocol[S]):
    """A simulated plant whose states are of type S."""

    @property
    def scenario(self) -> Scenario:
        """What is simulated."""

    def initial_state(self) -> S:
        """The state at the start of the scenario.

        Raises:
            StaticsError: the scenario asks for an equilibrium that does not exist.
        """

    def step(self, state: S, command: Command, dt: float) -> tuple[S, StepResult]:
        """Advance by one control tick.

        `state` is left as it is; the computation releases the interpreter's lock. A step that
        diverges returns the last good state with `Phase.DIVERGED`, and further steps return that
        unchanged; a broken tether likewise with `Phase.TETHER_BROKEN`.

        Args:
            state: where to start.
            command: what the actuators are asked to do.
            dt: length of the tick [s], above 0; time steps are the scenario's integration.h, the
                last one shorter if dt is no multiple of it.

        Raises:
            ValueError: dt or a number of the command is not finite or out of its range.
        """

    def energies(self, state: S) -> Energies:
        """Energies of the state, with the balance since the start of the run."""
