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
from rover_sim.physics.integrators.drive_states import DRIVES_SIZE
from rover_sim.physics.integrators.initial_guess import History, make_history
from rover_sim.physics.integrators.integrator_memory import (
    EVENT_SIZE,
    MAX_EVENTS,
    MEMORY_SIZE,
    REPORT_SIZE,
)
from rover_sim.physics.mechanisms.drum import Drum
from rover_sim.physics.mechanisms.jump_drive import JumpDrive
from rover_sim.physics.mechanisms.prescribed_rotors import PrescribedRotors
from rover_sim.physics.mechanisms.slider import Slider
from rover_sim.physics.mechanisms.wheel_drive import WheelDrive
from rover_sim.physics.numerics.compiled import checked
from rover_sim.physics.numerics.record import Record, store
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    RoverStep,
    SpatialRover,
    make_rover_step,
)
from rover_sim.physics.tether.air_drag import AirDrag
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.driven_end import DrivenEnd
from rover_sim.physics.tether.energy_momentum import Workspace, make_workspace
from rover_sim.physics.tether.natural_curvature import (
    BendingRelaxation,
    NaturalCurvature,
    make_natural_curvature,
)
from rover_sim.physics.tether.newton import CONVERGENCE_SIZE
from rover_sim.physics.tether.point_masses import PointMasses
from rover_sim.physics.tether.tether import Tether, row_width
from rover_sim.physics.tether.variable_length import ExitElement, make_exit

# Parts of the state vector. The slope is (2, 3), anchors are (anchor_rows, 3).
MEMORY = slice(0, MEMORY_SIZE)
DRIVES = slice(MEMORY.stop, MEMORY.stop + DRIVES_SIZE)
BODY = slice(DRIVES.stop, DRIVES.stop + BODY_SIZE)
SLOPE = slice(BODY.stop, BODY.stop + 6)
ANCHORS = slice(SLOPE.stop, None)


class Model(NamedTuple):
    """Constants of a run, for compiled functions."""

    tether: Tether  # its `elements` is not used: the memory's entry ELEMENTS holds the number
    has_winch: bool  # else the root is pinned or driven, and the length is constant
    root_motion: DrivenEnd  # of the root, or of the fairlead with its winch
    tip_motion: DrivenEnd  # without a rover
    drum: Drum
    has_rover: bool  # else a point mass hangs at the tip
    tip_mass: float  # [kg]
    rover: SpatialRover
    slider: Slider
    jump: JumpDrive
    wheels: WheelDrive
    rotors: PrescribedRotors
    rover_contact: RoverContact
    has_ground: bool
    terrain: Terrain
    tether_contact: TetherContactLaw
    drag: AirDrag
    masses: PointMasses  # on the chain; without a winch
    torsion: float  # GJ of the tether [N m^2]
    curvature: Array  # natural, in the tether's material frame, at places one element apart
    # counted from the tip [1/m], (2, >= 1)
    relaxation: BendingRelaxation  # without a winch
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


class EndState(NamedTuple):
    """State of fairlead and rover after an attempted step; see `MotionArrays`."""

    fairlead_slope: Array
    body: Array
    rover_anchors: Array


class Solver(NamedTuple):
    """Work arrays; their contents are valid within one call only."""

    work: Workspace
    rover: RoverStep
    exit_element: ExitElement
    rover_contact: RoverContactStep
    tether_contact: TetherContact
    after: EndState
    fairlead: Array  # its position and velocity, and its travel in the step, (3, 3)
    zero_increment: Array  # zeros (4,)
    extra_increments: Array  # increments th, ds and of the exit slope, (7,)
    history: History
    convergence: Array  # see `newton`


class Session(NamedTuple):
    """All that one thread steps, for kernels a `Record`: constants, state and work arrays.

    The state consists of `vector`, `rows`, the tether's anchors and, with natural curvature or
    relaxation, the tether's frames and relaxed curvature in `natural`; `memory`, `drives` and the
    other arrays of `motion` are views of these.
    """

    model: Model
    vector: Array  # memory, drives, body, slope at the fairlead, rover anchors: see `MEMORY`
    rows: Array  # coordinates, then rates, of the chain's nodes, (12, width)
    memory: Array  # see `integrator_memory`
    drives: Array  # see `drive_states`
    motion: MotionArrays
    natural: NaturalCurvature
    solver: Solver
    report: Array  # results of a call, see `integrator_memory`
    events: Array  # of a call, see `integrator_memory`


@checked
def _fill(session: Session, buffer: Array) -> None:
    store(session, buffer)


def as_record(session: Session) -> Record:
    """The session as the argument of kernels."""
    return Record(session, _fill)


def vector_size(corners: int) -> int:
    """Size of the state vector of a rover with `corners` corners."""
    return ANCHORS.start + 3 * anchor_rows(corners)


def make_session(model: Model, capacity: int) -> Session:
    """Allocate for a tether of at most `capacity` elements."""
    corners = len(model.rover_contact.corners)
    vector = np.zeros(vector_size(corners))
    rows = np.zeros((12, row_width(capacity, 3)))
    natural = make_natural_curvature(
        rows.shape[1],
        model.torsion,
        model.curvature,
        guided=not model.has_winch,
        relaxation=model.relaxation,
    )
    return Session(
        model,
        vector,
        rows,
        vector[MEMORY],
        vector[DRIVES],
        MotionArrays(
            rows[:6],
            rows[6:],
            vector[SLOPE].reshape(2, 3),
            vector[BODY],
            vector[ANCHORS].reshape(-1, 3),
            np.zeros((2 * capacity, 3)),
        ),
        natural,
        _make_solver(capacity, corners),
        np.zeros(REPORT_SIZE),
        np.zeros((MAX_EVENTS, EVENT_SIZE)),
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
        EndState(np.zeros((2, 3)), np.zeros(BODY_SIZE), np.zeros((anchor_rows(corners), 3))),
        np.zeros((3, 3)),
        np.zeros(4),
        np.zeros(7),
        make_history(6, width, 7),
        np.zeros(CONVERGENCE_SIZE),
    )
