"""The record of the spatial plant: constants, moving parts and work arrays of one thread."""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.ground.rover_contact import (
    RoverContact,
    RoverContactStep,
    anchor_rows,
    make_rover_contact_step,
)
from rover_sim.physics.ground.terrain import Terrain
from rover_sim.physics.ground.tether_contact import (
    TetherContact,
    TetherContactLaw,
    make_tether_contact,
)
from rover_sim.physics.integrators.initial_guess import History, make_history
from rover_sim.physics.mechanisms.drum import Drum
from rover_sim.physics.mechanisms.jump_drive import JumpDrive
from rover_sim.physics.mechanisms.slider import Slider
from rover_sim.physics.mechanisms.wheel_drive import WheelDrive
from rover_sim.physics.numerics.compiled import checked
from rover_sim.physics.numerics.record import Record, store
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    Rover,
    RoverStep,
    make_rover_step,
)
from rover_sim.physics.tether.air_drag import AirDrag
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import (
    Workspace,
    make_workspace,
)
from rover_sim.physics.tether.newton import CONVERGENCE_SIZE
from rover_sim.physics.tether.tether import Tether, row_width
from rover_sim.physics.tether.variable_length import (
    ExitElement,
    make_exit,
)


class Model(NamedTuple):
    """Constants of a run, for compiled functions."""

    tether: Tether  # its `elements` is not used: the memory's entry ELEMENTS holds the number
    has_winch: bool  # else the root is pinned at the fairlead and the length is constant
    drum: Drum
    has_rover: bool  # else a point mass hangs at the tip
    tip_mass: float  # [kg]
    rover: Rover
    slider: Slider
    jump: JumpDrive
    wheels: WheelDrive
    rover_contact: RoverContact
    has_ground: bool
    terrain: Terrain
    tether_contact: TetherContactLaw
    drag: AirDrag
    torsion: float  # GJ of the tether [N m^2]
    swivel_torque: float  # at which the swivel slips [N m]; 0: free, inf: clamped
    breaking_load: float  # [N]
    step: float  # h [s]
    tolerance: float  # [m]
    max_halvings: int


class MotionArrays(NamedTuple):
    """Arrays of the moving parts; see `rover_sim.physics.integrators.spatial`."""

    q: Array  # (6, width)
    v: Array  # (6, width)
    fairlead_slope: Array  # slope and slope rate at the fairlead, (2, 3)
    body: Array  # (BODY_SIZE,)
    rover_anchors: Array  # (anchor_rows(corners), 3)
    tether_anchors: Array  # (points, 3)


class Solver(NamedTuple):
    """Work arrays; their contents are valid within one call only."""

    work: Workspace
    rover: RoverStep
    exit_element: ExitElement
    rover_contact: RoverContactStep
    tether_contact: TetherContact
    after: MotionArrays  # the state after an attempted step; its tether anchors are not used
    origin: Array  # position of the fairlead, zeros (3,)
    zero_increment: Array  # zeros (4,)
    extra_increments: Array  # increments th, ds and of the exit slope, (7,)
    history: History
    convergence: Array  # see `newton`


class Session(NamedTuple):
    """All that one thread steps, for kernels a `Record`: constants, state and work arrays."""

    model: Model
    motion: MotionArrays
    solver: Solver
    memory: Array  # see `integrator_memory`
    report: Array
    events: Array


@checked
def _fill(session: Session, buffer: Array) -> None:
    store(session, buffer)


def as_record(session: Session) -> Record:
    """The session as the argument of kernels."""
    return Record(session, _fill)


def make_session(
    model: Model, capacity: int, memory: Array, report: Array, events: Array
) -> Session:
    """Allocate for a tether of at most `capacity` elements."""
    corners = len(model.rover_contact.corners)
    return Session(
        model,
        _make_motion(capacity, corners),
        _make_solver(capacity, corners),
        memory,
        report,
        events,
    )


def _make_motion(capacity: int, corners: int) -> MotionArrays:
    width = row_width(capacity, 3)
    return MotionArrays(
        np.zeros((6, width)),
        np.zeros((6, width)),
        np.zeros((2, 3)),
        np.zeros(BODY_SIZE),
        np.zeros((anchor_rows(corners), 3)),
        np.zeros((2 * capacity, 3)),
    )


def _make_solver(capacity: int, corners: int) -> Solver:
    """Allocate for a tether of at most `capacity` elements and a rover with `corners` corners."""
    width = row_width(capacity, 3)
    return Solver(
        make_workspace(capacity, 3),
        make_rover_step(),
        make_exit(3),
        make_rover_contact_step(corners),
        make_tether_contact(capacity),
        _make_motion(capacity, corners),
        np.zeros(3),
        np.zeros(4),
        np.zeros(7),
        make_history(6, width, 7),
        np.zeros(CONVERGENCE_SIZE),
    )
