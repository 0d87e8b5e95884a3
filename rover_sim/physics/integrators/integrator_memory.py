"""Integrator memory, report and events of the spatial plant: array indices, and writers of loads.

Compiled functions use arrays of floats with named entries: `memory` persists from call to call,
`report` holds the results of one call, and the rows of `events` its events.
"""

from rover_sim.physics.ground.rover_contact import CONTACTS_PER_WHEEL, RoverContactStep
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import dot
from rover_sim.physics.rover.spatial_rover import vector_at
from rover_sim.physics.tether.ancf import Array

# Entries of the array `memory`: state besides the motion and the drives, and energy sums.
(
    TIME,  # [s]
    ELEMENTS,  # number, of the tether's chain
    FAIRLEAD_TENSION,  # at the fairlead in the last step [N]
    LEFT_TORQUE,  # ground torque on the left wheel in the last step, forward positive [N m]
    RIGHT_TORQUE,
    TWIST,  # of the rover against the tether's twist-free frame [rad]
    SWIVEL_SLIP,  # of the swivel [rad]
    CONTACT_TIME,  # of the rover's last contact with the ground [s]
    AIRBORNE,  # 0 in contact with the ground, 1 in flight, SUSPENDED since the start
    TAKE_OFF_TIME,  # [s]
    TAKE_OFF_X,  # of G1 [m]
    TAKE_OFF_Y,
    TAKE_OFF_Z,
    TAKE_OFF_SPEED,  # of G1 [m/s]
    MAX_RISE,  # largest rise of G1 since take-off [m]
    DRIVE_KINETIC,  # of drum, flywheel and wheels [J]
    CONTACT_ENERGY,  # by contacts, relative to the start [J]
    INPUT_JUMP,  # work of the motors since the start [J]
    INPUT_WHEELS,
    INPUT_WINCH,
    INPUT_ENDS,  # work of what drives the tether's ends [J]
    INPUT_ROTORS,  # work on the rover by the drives of prescribed rotors [J]
    INPUT_TETHER,  # energy carried through the fairlead by paid-out tether [J]
    HEAT_TETHER,  # dissipated since the start [J]
    HEAT_SLIDER,
    HEAT_JUMP,
    HEAT_WHEELS,
    HEAT_WINCH,
    HEAT_ROVER_GROUND,
    HEAT_TETHER_GROUND,
    HEAT_SWIVEL,
    HEAT_AIR,  # work on the air [J]; negative where wind drives the tether
    INPUT_REMESHING,  # change of energy by splitting and merging elements [J]
    INITIAL_ENERGY,  # energy stored at the start of the run [J]
    DRIFT_REPORTED,  # 1 once a run's energy balance did not close
    PUSH_REPORTED,  # 1 once the tether pushed with more than it can carry
) = range(36)
MEMORY_SIZE = 36

# The rover hangs from the start of the run on: it has not taken off, and its swing has no apex.
SUSPENDED = 2.0

# Outcomes of `advance`.
OUTCOME_CONVERGED, OUTCOME_HALVED, OUTCOME_DIVERGED, OUTCOME_BROKEN = range(4)

# Rows of the event array: kind, time [s], position of G1 [m], its speed [m/s], its rise since the
# last take-off [m], tension [N], and a value specific to the kind: state of latch or drum stop.
# An energy drift has the energy turned over [J] in place of the tension, a push its limit [N].
(
    EVENT_TAKE_OFF,
    EVENT_APEX,
    EVENT_TOUCHDOWN,
    EVENT_BROKEN,
    EVENT_DIVERGED,
    EVENT_LATCH,
    EVENT_DRUM_STOP,
    EVENT_ENERGY_DRIFT,
    EVENT_TETHER_PUSH,
) = range(9)
EVENT_SIZE = 9
MAX_EVENTS = 64

# Entries of the array `report`; forces, currents and flags are of the last step.
(
    ITERATIONS,
    SMALLEST_STEP,  # [s]
    HALVINGS,
    ELAPSED,  # [s]
    PEAK_TENSION,  # [N]
    KINETIC,  # [J]; energies at the end of the call
    GRAVITY,
    AXIAL,
    BENDING,
    SPRING,
    CONTACT,
    TORSION,
    CONSTRAINT_DRIFT,  # |G1 + R p - r_n| [m]
    TIP_TENSION,  # [N]
    LEFT_LOAD,  # normal force of the ground on the left wheel [N]
    RIGHT_LOAD,
    BODY_LOAD,  # on the corners of both bodies
    JUMP_CURRENT,  # [A]
    SCREW_HARD_LIMIT,  # -1, 0, 1
    WHEEL_CURRENT,
    WINCH_CURRENT,
    DRUM_STOP,  # -1, 0, 1
    REMESH_COUNT,
    EVENT_COUNT,
) = range(24)
REPORT_SIZE = 24


@inner
def report_loads(corners: int, contact: RoverContactStep, near: bool, report: Array) -> float:
    """Report the normal forces on the rover's corners and wheels; returns their sum [N]."""
    report[LEFT_LOAD], report[RIGHT_LOAD], report[BODY_LOAD] = 0.0, 0.0, 0.0
    if not near:
        return 0.0
    for k in range(corners + 2 * CONTACTS_PER_WHEEL):
        if contact.near[k] == 0.0:
            continue
        load = dot(vector_at(contact.force[k], 0), vector_at(contact.normal[k], 0))
        if k < corners:
            report[BODY_LOAD] += load
        elif k < corners + CONTACTS_PER_WHEEL:
            report[LEFT_LOAD] += load
        else:
            report[RIGHT_LOAD] += load
    return report[LEFT_LOAD] + report[RIGHT_LOAD] + report[BODY_LOAD]


@inner
def record_wheel_torques(step: RoverContactStep, memory: Array) -> None:
    """Store the ground's torques on the wheels, from which the next step's iteration starts."""
    memory[LEFT_TORQUE] = step.ground_torque[0]
    memory[RIGHT_TORQUE] = step.ground_torque[1]
