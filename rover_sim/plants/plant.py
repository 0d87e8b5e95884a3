"""The protocol of simulated plants: states, commands, step results.

A plant advances a state under a command by one control tick. States are immutable and a step is
deterministic: equal state, command and tick give equal results.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_sim.scenarios.scenario import AnyScenario


class Outcome(enum.Enum):
    """Outcome of a step."""

    CONVERGED = "converged"
    HALVED = "halved"  # converged, with some time steps halved
    DIVERGED = "diverged"  # stopped at the last converged state
    TETHER_BROKEN = "tether_broken"  # stopped when the tether broke


@dataclass(frozen=True)
class JumpMotorCommand:
    """Nut of the jump motor: drive to a compression of the spring, where the latch trips.

    Below 0 the nut is clear of the latch, for plants whose nut has a free travel.
    """

    compression: float  # setpoint [m]; at a setpoint above 0 the latch releases the spring
    rate: float  # largest speed of the nut [m/s], > 0
    max_force: float = math.inf  # of the nut [N], > 0; inf: the motor's own limit
    trips: bool = True  # False: the nut stays at the setpoint, the latch holds


@dataclass(frozen=True)
class FlywheelCommand:
    """Jump motor as a reaction wheel, while the nut is free of the latch."""

    torque: float  # at the shaft [N m], > 0 drives the nut down


@dataclass(frozen=True)
class FlywheelRateCommand:
    """Rate control of that reaction wheel, for its quick stop."""

    rate: float  # of the shaft relative to Body 1 [rad/s], > 0 drives the nut down


@dataclass(frozen=True)
class WheelRateCommand:
    """Rate control of the wheel motor."""

    rate: float  # of the left wheel [rad/s], > 0 forward
    max_torque: float = math.inf  # at the wheel [N m], > 0; inf: the motor's own limit


@dataclass(frozen=True)
class WheelTorqueCommand:
    """Torque control of the wheel motor."""

    torque: float  # at the wheel [N m], > 0 forward


@dataclass(frozen=True)
class WinchCommand:
    """Rate control of the winch's drum."""

    length: float  # setpoint of the length controller, not used by the drive [m], >= 0
    rate: float  # payout rate [m/s], > 0 lengthens the tether
    feed_forward: float = 0.0  # tension fed forward to the motor [N], >= 0
    brake_released: bool = True  # power the brake open
    max_tension: float = math.inf  # of the motor [N], > 0; inf: its own limit


@dataclass(frozen=True)
class PlantCommand:
    """Commands of the actuators for one tick.

    None switches a motor off; without a winch command the brake closes.
    """

    jump: JumpMotorCommand | FlywheelCommand | FlywheelRateCommand | None = None
    winch: WinchCommand | None = None
    wheel: WheelRateCommand | WheelTorqueCommand | None = None


@dataclass(frozen=True)
class Energies:
    """Energies of the system [J], and the energy balance since the start of the run.

    The gravitational potential is zero at the level of the tether's root. `rotors`, `contact`,
    `twist`, `driven_ends` and `air_drag` belong to the spatial plant.
    """

    kinetic: float
    gravity: float
    axial: float
    bending: float
    spring: float  # of the jump mechanism, with its end stops
    input: float = 0.0  # by motors, driven ends, take-offs, and tether paid out at the fairlead
    dissipated: float = 0.0  # by damping, friction, air, and stopping the rover after a landing
    initial: float = 0.0  # stored at the start of the run
    rotors: float = 0.0  # kinetic energy of flywheel, wheels, motors and drum
    contact: float = 0.0  # elastic, in contacts with the ground
    twist: float = 0.0  # of the tether
    driven_ends: float = 0.0  # part of input: by what drives the tether's ends
    air_drag: float = 0.0  # part of dissipated: by the air; negative where wind drives the tether

    @property
    def stored(self) -> float:
        """Sum of kinetic and potential energies [J]."""
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
        """Residual of the energy balance [J]: stored - initial - input + dissipated."""
        return self.stored - self.initial - self.input + self.dissipated


@dataclass(frozen=True)
class Event:
    """An event at an instant inside a step."""

    name: PlantEvent
    time: float  # [s]
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Forces:
    """Forces and currents in the last time step of a tick; zero without drives."""

    fairlead_tension: float = 0.0  # [N]
    rover_tension: float = 0.0  # of the tether at its tip [N]
    left_wheel: float = 0.0  # normal force of the ground [N]
    right_wheel: float = 0.0
    body: float = 0.0  # normal force on corners and tail of both bodies [N]
    jump_current: float = 0.0  # [A]
    wheel_current: float = 0.0
    winch_current: float = 0.0
    screw_hard_limit: int = 0  # -1 / +1: at the upper / lower end of the screw


@dataclass(frozen=True)
class StepResult:
    """Result of a step besides the new state."""

    outcome: Outcome
    energies: Energies
    constraint_drift: float  # largest violation of a joint [m]
    newton_iterations: int  # sum over all time steps of the tick
    smallest_step: float  # [s]; infinite without a time step
    events: tuple[Event, ...]
    peak_tension: float  # largest tension in the tether during the tick [N]
    forces: Forces = Forces()


class State(Protocol):
    """Properties common to the states of all plants."""

    @property
    def time(self) -> float:
        """[s]."""

    @property
    def phase(self) -> PlantPhase:
        """Phase of the rover's motion."""


S = TypeVar("S", bound=State)


class Plant(Protocol[S]):
    """A simulated plant whose states are of type S."""

    @property
    def scenario(self) -> AnyScenario:
        """What is simulated."""

    def initial_state(self) -> S:
        """Return the state at the start of the scenario.

        Raises:
            StaticsError: the static equilibrium at the start does not exist.
        """

    def step(self, state: S, command: PlantCommand, dt: float) -> tuple[S, StepResult]:
        """Advance by one control tick.

        `state` is not changed; the computation releases the interpreter's lock. A step that
        diverges returns the last converged state with `PlantPhase.DIVERGED`, and further steps
        return it unchanged; a broken tether likewise with `PlantPhase.TETHER_BROKEN`.

        Args:
            state: at the start of the tick.
            command: of the actuators.
            dt: length of the tick [s], above 0; time steps are the scenario's integration.h, the
                last one shorter if dt is not a multiple of it.

        Raises:
            ValueError: dt or a value of the command is not finite or out of range.
        """

    def energies(self, state: S) -> Energies:
        """Return the energies of a state, with the balance since the start of the run."""
