"""The plant contract: what every simulated plant takes, gives and promises.

A plant turns a state and a command into the state one control tick later. States are values: a
step never changes the one it is given, and the same state, command and tick give the same result.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from rover_sim.scenario import AnyScenario


class Outcome(enum.Enum):
    """How a step went."""

    CONVERGED = "converged"
    HALVED = "halved"  # converged, some of its time steps after halving
    DIVERGED = "diverged"  # stopped at the last good state
    TETHER_BROKEN = "tether_broken"  # stopped when the tether parted


class Phase(enum.Enum):
    """What the rover is doing, or why nothing moves any more.

    The planar model's ground holds the rover (HELD, LANDED) until it takes off. The spatial one
    has contact: its rover is GROUNDED while a wheel or a body touches the ground, HANGING while
    nothing does and the tether carries it, and in FLIGHT while neither holds.
    """

    HELD = "held"  # standing, held by the ground
    FLIGHT = "flight"
    LANDED = "landed"  # held again where it came down
    FREE = "free"  # no rover, or one that was never held
    HANGING = "hanging"
    GROUNDED = "grounded"
    DIVERGED = "diverged"
    TETHER_BROKEN = "tether_broken"

    @property
    def final(self) -> bool:
        """Whether further steps leave the state as it is."""
        return self in (Phase.DIVERGED, Phase.TETHER_BROKEN)


@dataclass(frozen=True)
class JumpMotorCommand:
    """Nut of the jump motor: go to `compression` of the spring, where the latch trips.

    Below 0 the nut stands clear of the latch, for plants whose nut has a free travel.
    """

    compression: float  # setpoint [m]; reaching one above 0 releases the spring if it trips
    rate: float  # largest speed of the nut [m/s], > 0
    max_force: float = math.inf  # that the nut may use [N], > 0; inf: the motor's own limit
    trips: bool = True  # False: the nut stays at the setpoint, the latch holds


@dataclass(frozen=True)
class FlywheelCommand:
    """Jump motor as a reaction wheel, for plants that have one: while the nut is free."""

    torque: float  # at the shaft [N m], > 0 drives the nut down


@dataclass(frozen=True)
class WheelRateCommand:
    """Wheel motor holds a rate."""

    rate: float  # of the left wheel [rad/s], > 0 forward
    max_torque: float = math.inf  # at the wheel [N m], > 0; inf: the motor's own limit


@dataclass(frozen=True)
class WheelTorqueCommand:
    """Wheel motor gives a torque."""

    torque: float  # at the wheel [N m], > 0 forward


@dataclass(frozen=True)
class WinchCommand:
    """Winch, for plants that have a drum: its drive holds the payout rate."""

    length: float  # setpoint of what watches over the drive, not used by it [m], >= 0
    rate: float  # payout rate [m/s], > 0 lengthens the tether
    feed_forward: float = 0.0  # tension that the motor is told to carry [N], >= 0
    brake_released: bool = True  # power the brake open
    max_tension: float = math.inf  # that the motor may use [N], > 0; inf: its own limit


@dataclass(frozen=True)
class Command:
    """What the actuators are asked to do during one tick.

    None leaves a motor without current, and the winch's brake closed.
    """

    jump: JumpMotorCommand | FlywheelCommand | None = None
    winch: WinchCommand | None = None
    wheel: WheelRateCommand | WheelTorqueCommand | None = None


@dataclass(frozen=True)
class Energies:
    """Where the energy is [J], and what came and went since the start of the run.

    Gravity's potential is zero at the level of the tether's root. The parts that have a default
    belong to the spatial plant.
    """

    kinetic: float
    gravity: float
    axial: float
    bending: float
    spring: float  # of the jump mechanism, with its end stops
    input: float = 0.0  # by motors, take-offs, and tether that came through the fairlead
    dissipated: float = 0.0  # by damping and friction, and in holding the rover after a landing
    initial: float = 0.0  # stored at the start of the run
    rotors: float = 0.0  # kinetic energy of flywheel, wheels, motors and drum
    contact: float = 0.0  # elastic, in what touches the ground
    twist: float = 0.0  # of the tether

    @property
    def stored(self) -> float:
        """Kinetic and potential energy together [J]."""
        return (
            self.kinetic
            + self.rotors
            + self.gravity
            + self.axial
            + self.bending
            + self.twist
            + self.spring
            + self.contact
        )

    @property
    def drift(self) -> float:
        """What the energy balance misses [J]: stored - initial - input + dissipated."""
        return self.stored - self.initial - self.input + self.dissipated


@dataclass(frozen=True)
class Event:
    """Something that happened at an instant inside a step.

    Names: take_off, apex, touchdown, tether_broken, diverged; of the spatial plant also drum_stop
    and latch_free, latch_hooking, latch_engaged, latch_compressing, latch_released.
    """

    name: str
    time: float  # [s]
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Forces:
    """Forces, currents and limits in the last time step of a tick, of plants that have drives."""

    fairlead: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the tether on the fairlead [N]
    fairlead_tension: float = 0.0  # [N]
    rover_tension: float = 0.0  # of the tether at its tip [N]
    left_wheel: float = 0.0  # normal force of the ground [N]
    right_wheel: float = 0.0
    body: float = 0.0  # on corners and tail of both bodies
    grounded_points: int = 0  # of the tether that touch the ground
    nut: float = 0.0  # on Body 2 [N]
    jump_torque: float = 0.0  # of the motors, at their shafts [N m]
    wheel_torque: float = 0.0
    winch_torque: float = 0.0
    jump_current: float = 0.0  # [A]
    wheel_current: float = 0.0
    winch_current: float = 0.0
    flywheel_saturated: bool = False
    screw_soft_limit: int = 0  # -1 / +1: near the upper / lower end of the free travel
    screw_hard_limit: int = 0  # -1 / +1: at the upper / lower end of the screw
    ratchet: int = 0  # rover_sim.physics.wheel_drive.Ratchet
    drum_stuck: bool = False
    drum_stop: int = 0  # -1: fully reeled in, +1: nothing left


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
    forces: Forces = Forces()


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
    def scenario(self) -> AnyScenario:
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
