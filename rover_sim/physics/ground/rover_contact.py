"""Contact of the rover with the ground in an implicit step: corners of both bodies, two wheels.

A corner is a contact point (module `contact`). A wheel has three contact slots: the floor and up to
two rocks (modules `wheel_ground_geometry` and `wheel_contact`). A rock keeps its slot, and so its
anchor, as long as it is one of the two; the last two rows of the anchors hold the rocks' keys. The
wheel's force acts on the body at the wheel's centre plus the arm to the contact point; the ground's
torque about the axle is -M, which changes the wheel's spin in the wheel drive and reaches the body
through the rotors' momentum. Forces are averages over the step; points of action, normals and axles
are those at its end.

The spins are not unknowns of the iteration: for each iterate of the rover's motion they are those
at which drive and ground agree, and the tangent has their response.
"""

import math
from typing import NamedTuple

import numpy as np

from rover_sim.physics.ground.contact import (
    NO_VECTOR,
    ContactLaw,
    advance_bristle,
    blend_laws,
    contact_energy,
    contact_force,
)
from rover_sim.physics.ground.terrain import Terrain, depth_and_normal
from rover_sim.physics.ground.wheel_contact import (
    WheelForce,
    WheelLaw,
    advance_rock_bristle,
    advance_soil_bristle,
    rock_force,
    soil_energy,
    soil_force,
    wheel_moment,
)
from rover_sim.physics.ground.wheel_ground_geometry import (
    NO_ROCK,
    WheelContactGeometry,
    deepest_rocks,
    wheel_on_floor,
    wheel_on_rock,
)
from rover_sim.physics.mechanisms.wheel_drive import WheelResponse
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import (
    Vector,
    add,
    axpy,
    cayley_tangent,
    cross,
    dot,
    product,
    rotate,
    scale,
)
from rover_sim.physics.rover.spatial_rover import (
    POSITION,
    SPIN,
    VELOCITY1,
    VELOCITY2,
    Pose,
    RoverStep,
    add_point_load,
    levers,
    point_travel,
    set_vector_at,
    vector_at,
)
from rover_sim.physics.tether.ancf import Array

# A corner or wheel farther from the ground than this at a step's start, or than its travel in the
# step, cannot reach it [m].
_NEAR = 0.05
_FLOOR_SLOT = 0  # the other slots are for rocks
CONTACTS_PER_WHEEL = 3
"""Contact slots of a wheel: the floor and two rocks."""


class RoverContact(NamedTuple):
    """Contact model of the rover: corner points, wheels and materials."""

    corners: Array  # points in base_link, Body 2's as at s = 0 [m], (c, 3)
    first_body2_corner: int  # corners from this index on are Body 2's
    left_wheel: Vector  # centre in base_link [m]
    right_wheel: Vector
    radius: float  # of the rims [m]
    tip_radius: float  # with grousers, on which a wheel stands on rock [m]
    reach: float  # distance of the farthest point from the origin of base_link [m]
    regolith: ContactLaw  # of the corners
    rock: ContactLaw  # of the corners and of the wheels
    wheel: WheelLaw  # on regolith


class RoverContactStep(NamedTuple):
    """Arrays of one step's contacts."""

    near: Array  # 1 where a contact is evaluated: corners, then [wheel, slot], (c + 6,)
    depth0: Array  # at the step's start [m], (c + 6,)
    depth1: Array  # at its end
    rock: Array  # 0 regolith .. 1 rock, of the corners, (c,)
    normal: Array  # (c + 6, 3)
    forward: Array  # of the wheels' contacts, (6, 3)
    arm: Array  # of the wheels' contacts [m], (6, 3)
    travel: Array  # of corners and wheels' centres [m], (c + 6, 3)
    force: Array  # on the rover [N], (c + 6, 3)
    tangent: Array  # of the wheels' contacts: d force / d travel [N/m], rows, (6, 9)
    torque: Array  # M against the spin [N m] and dM/dw [N m s], (6, 2)
    force_by_spin: Array  # d force / dw of the wheels' contacts [N s], (6, 3)
    torque_by_travel: Array  # dM / d travel [N], (6, 3)
    spin: Array  # of the wheels, mean of the step, relative to Body 1 [rad/s], (2,)
    ground_torque: Array  # of the ground on the wheels, forward positive [N m], (2,)
    wheel: Array  # of each wheel, see `roll_wheels`, (2, 4)
    rock_key: Array  # rock in each slot of a wheel, see `wheel_ground_geometry`, (2, slots)
    dropped_energy: Array  # stored by rocks that lost their slot, minus by new ones [J], (1,)


def anchor_rows(corners: int) -> int:
    """Number of rows of the anchors of a rover with `corners` corners."""
    return corners + 2 * CONTACTS_PER_WHEEL + 2


def make_rover_contact_step(corners: int) -> RoverContactStep:
    """Allocate the arrays."""
    wheels = 2 * CONTACTS_PER_WHEEL
    c = corners + wheels
    return RoverContactStep(
        near=np.zeros(c),
        depth0=np.zeros(c),
        depth1=np.zeros(c),
        rock=np.zeros(corners),
        normal=np.zeros((c, 3)),
        forward=np.zeros((wheels, 3)),
        arm=np.zeros((wheels, 3)),
        travel=np.zeros((c, 3)),
        force=np.zeros((c, 3)),
        tangent=np.zeros((wheels, 9)),
        torque=np.zeros((wheels, 2)),
        force_by_spin=np.zeros((wheels, 3)),
        torque_by_travel=np.zeros((wheels, 3)),
        spin=np.zeros(2),
        ground_torque=np.zeros(2),
        wheel=np.zeros((2, 4)),
        rock_key=np.zeros((2, CONTACTS_PER_WHEEL)),
        dropped_energy=np.zeros(1),
    )


@inner
def _corner_ground(terrain: Terrain, point: Vector) -> tuple[float, float, float, float, float]:
    """Depth, normal and rock at a point."""
    return depth_and_normal(terrain, point[0], point[1], point[2])


@inner
def _wheel_geometry(
    contact: RoverContact,
    terrain: Terrain,
    slot: int,
    rock_key: float,
    centre: Vector,
    axle: Vector,
) -> WheelContactGeometry:
    """Deepest point of a wheel in the floor or in a rock."""
    if slot != _FLOOR_SLOT:
        return wheel_on_rock(terrain, centre, axle, contact.tip_radius, rock_key)
    radius = contact.tip_radius if terrain.floor_rock > 0.5 else contact.radius
    return wheel_on_floor(terrain, centre, axle, radius)


@inner
def _wheel_centre(contact: RoverContact, wheel: int) -> Vector:
    return contact.left_wheel if wheel == 0 else contact.right_wheel


@inner
def _find_rocks(
    contact: RoverContact, terrain: Terrain, wheel: int, hub: Vector, axle: Vector, anchors: Array,
    step: RoverContactStep,
) -> None:  # fmt: skip
    """Assign the two rocks that a wheel is deepest in to slots; a rock keeps its previous slot."""
    corners = contact.corners.shape[0]
    first, key1, second, key2 = deepest_rocks(terrain, hub, axle, contact.tip_radius)
    previous_keys = anchors[corners + 2 * CONTACTS_PER_WHEEL + wheel]
    swap = (key1 != NO_ROCK and key1 == previous_keys[2]) or (
        key2 != NO_ROCK and key2 == previous_keys[1]
    )
    if swap:
        first, key1, second, key2 = second, key2, first, key1
    for slot in range(1, CONTACTS_PER_WHEEL):
        k = corners + CONTACTS_PER_WHEEL * wheel + slot
        rock, depth = (key1, first) if slot == 1 else (key2, second)
        step.rock_key[wheel, slot] = rock
        step.depth0[k] = depth
        if previous_keys[slot] not in (NO_ROCK, rock):
            # Three rocks in contact: the energy of the dropped one is lost, the new one's is added.
            before = wheel_on_rock(
                terrain, hub, axle, contact.tip_radius, previous_keys[slot]
            ).depth
            if before > 0.0:
                step.dropped_energy[0] += contact_energy(
                    contact.rock, before, vector_at(anchors[k], 0)
                )
            if depth > 0.0:
                step.dropped_energy[0] -= contact_energy(contact.rock, depth, NO_VECTOR)


@inner
def _anchor(corners: int, k: int, anchors: Array, step: RoverContactStep) -> Vector:
    """Deflection of a contact's anchor at the step's start [m]; zero for a new rock."""
    w = k - corners
    if w >= 0:
        wheel, slot = w // CONTACTS_PER_WHEEL, w % CONTACTS_PER_WHEEL
        previous_keys = anchors[corners + 2 * CONTACTS_PER_WHEEL + wheel]
        if slot != _FLOOR_SLOT and step.rock_key[wheel, slot] != previous_keys[slot]:
            return NO_VECTOR
    return vector_at(anchors[k], 0)


@inner
def _largest_speed(contact: RoverContact, body: Array) -> float:
    """Speed that no point of the rover exceeds [m/s]."""
    v1, v2, spin = vector_at(body, VELOCITY1), vector_at(body, VELOCITY2), vector_at(body, SPIN)
    return math.sqrt(max(dot(v1, v1), dot(v2, v2))) + contact.reach * math.sqrt(dot(spin, spin))


@inner
def begin_rover_contact(
    contact: RoverContact,
    terrain: Terrain,
    h: float,
    pose: Pose,
    body: Array,
    anchors: Array,
    step: RoverContactStep,
) -> bool:
    """Compute the depths at the step's start; returns whether any contact is near the ground.

    Args:
        contact: contact model of the rover.
        terrain: the ground.
        h: length of the step [s].
        pose: of the step; only its start is used.
        body: the rover's state.
        anchors: at the step's start [m], (anchor_rows, 3).
        step: filled.
    """
    centre = vector_at(body, POSITION)
    corners = contact.corners.shape[0]
    found = False
    near = max(_NEAR, h * _largest_speed(contact, body))
    step.dropped_energy[0] = 0.0
    for k in range(corners + 2 * CONTACTS_PER_WHEEL):
        set_vector_at(step.force[k], 0, NO_VECTOR)
    for w in range(2 * CONTACTS_PER_WHEEL):
        step.torque[w, 0], step.torque[w, 1] = 0.0, 0.0
    for k in range(corners):
        lever = rotate(pose.start, vector_at(contact.corners[k], 0))
        if k >= contact.first_body2_corner:
            lever = axpy(pose.s0, pose.axis0, lever)
        depth = _corner_ground(terrain, add(centre, lever))[0]
        step.depth0[k] = depth
        step.near[k] = 1.0 if depth > -near else 0.0
        found = found or depth > -near
    for wheel in range(2):
        hub = add(centre, rotate(pose.start, _wheel_centre(contact, wheel)))
        floor = corners + CONTACTS_PER_WHEEL * wheel
        step.depth0[floor] = _wheel_geometry(
            contact, terrain, _FLOOR_SLOT, NO_ROCK, hub, pose.start[1]
        ).depth
        _find_rocks(contact, terrain, wheel, hub, pose.start[1], anchors, step)
        for k in range(floor, floor + CONTACTS_PER_WHEEL):
            depth = step.depth0[k]
            step.near[k] = 1.0 if depth > -near else 0.0
            found = found or depth > -near
    return found


@inner
def _wheel_force(
    contact: RoverContact,
    on_soil: bool,
    k: int,
    w: int,
    spin: float,
    h: float,
    anchor: Vector,
    step: RoverContactStep,
) -> WheelForce:
    """Force on wheel contact w (entry k of the common arrays)."""
    normal = vector_at(step.normal[k], 0)
    forward = vector_at(step.forward[w], 0)
    travel = vector_at(step.travel[k], 0)
    depth0, depth1 = step.depth0[k], step.depth1[k]
    if on_soil:
        return soil_force(contact.wheel, depth0, depth1, normal, forward, travel, spin, h, anchor)
    return rock_force(
        contact.rock, contact.tip_radius, depth0, depth1, normal, forward, travel, spin, h, anchor
    )


@inner
def add_corner_contact(
    contact: RoverContact,
    terrain: Terrain,
    attachment: Vector,
    h: float,
    pose: Pose,
    body: Array,
    dr: Vector,
    anchors: Array,
    rover_step: RoverStep,
    step: RoverContactStep,
) -> None:
    """Add the corners' forces to the rover's loads.

    Args:
        contact: contact model of the rover.
        terrain: the ground.
        attachment: p [m].
        h: length of the step [s].
        pose: of the step.
        body: the rover's state at the step's start.
        dr: travel of the last node [m].
        anchors: deflections at the step's start [m], (anchor_rows, 3).
        rover_step: added to.
        step: from `begin_rover_contact`, filled.
    """
    node1 = add(add(vector_at(body, POSITION), pose.attachment0), dr)
    for k in range(contact.corners.shape[0]):
        if step.near[k] == 0.0:
            continue
        point = vector_at(contact.corners[k], 0)
        sliding = k >= contact.first_body2_corner
        lever, travel = point_travel(pose, dr, point, attachment, sliding)
        depth, nx, ny, nz, rock = _corner_ground(terrain, add(node1, lever))
        normal = (nx, ny, nz)
        force, tangent = contact_force(
            blend_laws(contact.regolith, contact.rock, rock),
            step.depth0[k],
            depth,
            normal,
            travel,
            h,
            vector_at(anchors[k], 0),
        )
        step.depth1[k], step.rock[k] = depth, rock
        set_vector_at(step.normal[k], 0, normal)
        set_vector_at(step.travel[k], 0, travel)
        set_vector_at(step.force[k], 0, force)
        if step.depth0[k] > 0.0 or depth > 0.0:
            add_point_load(rover_step, pose, attachment, point, sliding, force, tangent)


@inner
def place_wheels(
    contact: RoverContact,
    terrain: Terrain,
    attachment: Vector,
    pose: Pose,
    body: Array,
    dr: Vector,
    step: RoverContactStep,
) -> None:
    """Locate the wheels' contacts at the step's end; arguments as for `add_corner_contact`."""
    corners = contact.corners.shape[0]
    node1 = add(add(vector_at(body, POSITION), pose.attachment0), dr)
    axle = rotate(pose.start, _turned_axle(pose))
    for wheel in range(2):
        lever, travel = point_travel(pose, dr, _wheel_centre(contact, wheel), attachment, False)
        hub = add(node1, lever)
        for slot in range(CONTACTS_PER_WHEEL):
            w = CONTACTS_PER_WHEEL * wheel + slot
            k = corners + w
            if step.near[k] == 0.0:
                continue
            geometry = _wheel_geometry(
                contact, terrain, slot, step.rock_key[wheel, slot], hub, axle
            )
            step.depth1[k] = geometry.depth
            set_vector_at(step.normal[k], 0, geometry.normal)
            set_vector_at(step.forward[w], 0, geometry.forward)
            set_vector_at(step.arm[w], 0, geometry.arm)
            set_vector_at(step.travel[k], 0, travel)


@inner
def _touches(k: int, step: RoverContactStep) -> bool:
    return step.near[k] != 0.0 and (step.depth0[k] > 0.0 or step.depth1[k] > 0.0)


@inner
def roll_wheels(
    contact: RoverContact,
    terrain: Terrain,
    h: float,
    pose: Pose,
    anchors: Array,
    step: RoverContactStep,
) -> None:
    """Compute the forces on the wheels at the spins `step.spin`.

    Fills `step.wheel` too: the torque M of each wheel's contacts [N m], its slope dM/dw [N m s],
    the slope of its secant to a rolling wheel, and the smallest slip of its contacts, at least that
    which friction resolves [m/s].
    """
    corners = contact.corners.shape[0]
    for wheel in range(2):
        spin = step.spin[wheel] + pose.th[1] / h
        total, slope, secant, resolved = 0.0, 0.0, 0.0, np.inf
        for slot in range(CONTACTS_PER_WHEEL):
            w = CONTACTS_PER_WHEEL * wheel + slot
            k = corners + w
            if not _touches(k, step):
                set_vector_at(step.force[k], 0, NO_VECTOR)
                step.torque[w, 0], step.torque[w, 1] = 0.0, 0.0
                continue
            on_soil = slot == _FLOOR_SLOT and terrain.floor_rock <= 0.5
            anchor = _anchor(corners, k, anchors, step)
            result = _wheel_force(contact, on_soil, k, w, spin, h, anchor, step)
            set_vector_at(step.force[k], 0, result.force)
            for r in range(9):
                step.tangent[w, r] = result.tangent[r]
            slope_here = max(result.torque_slope, 0.0)
            step.torque[w, 0], step.torque[w, 1] = result.torque, slope_here
            set_vector_at(step.force_by_spin[w], 0, result.force_by_spin)
            set_vector_at(step.torque_by_travel[w], 0, result.torque_by_travel)
            forward = vector_at(step.forward[w], 0)
            radius, width = contact.tip_radius, contact.rock.slip_speed
            if on_soil:
                radius, width = contact.wheel.table.system.shear_radius, contact.wheel.slip_speed
            slip = dot(vector_at(step.travel[k], 0), forward) / h - radius * spin
            slip = np.sqrt(slip * slip + width * width)
            total += result.torque
            slope += slope_here
            secant += radius * abs(result.torque) / slip
            resolved = min(resolved, slip)
        step.wheel[wheel, 0], step.wheel[wheel, 1] = total, slope
        step.wheel[wheel, 2], step.wheel[wheel, 3] = max(secant, slope), resolved


@inner
def shift_spin(contact: RoverContact, wheel: int, spin: float, step: RoverContactStep) -> None:
    """Refer a wheel's forces to another spin, to first order."""
    corners = contact.corners.shape[0]
    change = spin - step.spin[wheel]
    step.spin[wheel] = spin
    for w in range(CONTACTS_PER_WHEEL * wheel, CONTACTS_PER_WHEEL * (wheel + 1)):
        if _touches(corners + w, step):
            step.torque[w, 0] += step.torque[w, 1] * change
            for d in range(3):
                step.force[corners + w, d] += step.force_by_spin[w, d] * change


class _WheelsPose(NamedTuple):
    """Geometry of the wheels' contacts in a step."""

    pose: Pose
    axle: Vector
    left: Vector  # lever of the left wheel's centre from the last node at the end [m]
    left_mean: Vector  # mean of start and end
    right: Vector
    right_mean: Vector


@inner
def add_wheel_contact(
    contact: RoverContact,
    attachment: Vector,
    h: float,
    pose: Pose,
    response: WheelResponse,
    carried: float,
    rover_step: RoverStep,
    step: RoverContactStep,
) -> None:
    """Add the wheels' forces, and the response of their spins, to the rover's loads.

    Args:
        contact: contact model of the rover.
        attachment: p [m].
        h: length of the step [s].
        pose: of the step.
        response: of the wheel drive.
        carried: torque on each wheel per change of th_y [N m], by the change of Body 1's rate.
        rover_step: added to.
        step: from `roll_wheels`.
    """
    left0, left1 = levers(pose, contact.left_wheel, attachment, False)
    right0, right1 = levers(pose, contact.right_wheel, attachment, False)
    wheels = _WheelsPose(
        pose,
        rotate(pose.start, _turned_axle(pose)),
        left1,
        scale(0.5, add(left0, left1)),
        right1,
        scale(0.5, add(right0, right1)),
    )
    corners = contact.corners.shape[0]
    touching = False
    for w in range(2 * CONTACTS_PER_WHEEL):
        touching = touching or _touches(corners + w, step)
    for c in range(7):
        if c == 3 or not (touching or c == 1):  # only Body 1's th_y turns wheels in the air
            continue
        unit = (
            1.0 if c in (0, 4) else 0.0,
            1.0 if c in (1, 5) else 0.0,
            1.0 if c in (2, 6) else 0.0,
        )
        _add_wheel_column(corners, h, wheels, c, unit, response, carried, rover_step, step)
    for w in range(2 * CONTACTS_PER_WHEEL):
        k = corners + w
        if not _touches(k, step):
            continue
        force = vector_at(step.force[k], 0)
        moment = _moment(w, wheels, force, step.torque[w, 0], step)
        for d in range(3):
            rover_step.load[d] += force[d]
            rover_step.load[3 + d] += moment[d]


@inner
def _moment(
    w: int, wheels: _WheelsPose, force: Vector, torque: float, step: RoverContactStep
) -> Vector:
    """Moment of force and torque M of wheel contact w about the last node [N m]."""
    lever = _of_wheel(w, wheels.left_mean, wheels.right_mean)
    arm = vector_at(step.arm[w], 0)
    return add(cross(lever, force), wheel_moment(arm, wheels.axle, force, torque))


@inner
def _spin_change(
    corners: int,
    h: float,
    wheels: _WheelsPose,
    column: int,
    unit: Vector,
    response: WheelResponse,
    carried: float,
    step: RoverContactStep,
) -> tuple[float, float, float]:
    """Changes of the wheels' spins in space and of their momentum per unknown.

    With the drive's compliance D to the ground's torques -M, and these torques' slopes M_w, the
    spins change by D (1 + M_w D)^-1 t, where t is the torque at constant spins.
    """
    rolled = 1.0 / h if column == 1 else 0.0
    left = carried if column == 1 else 0.0
    right = left
    for w in range(2 * CONTACTS_PER_WHEEL):
        k = corners + w
        if not _touches(k, step):
            continue
        move = _contact_move(k, column, unit, wheels, w, step)
        change = dot(vector_at(step.torque_by_travel[w], 0), move) + step.torque[w, 1] * rolled
        if w < CONTACTS_PER_WHEEL:
            left -= change
        else:
            right -= change
    left, right = solve_torques(response, step.wheel[0, 1], step.wheel[1, 1], left, right)
    momentum = response.momentum_left * left + response.momentum_right * right
    if column == 1:
        momentum -= 2.0 * carried * h
    return (
        response.left * left + response.cross * right + rolled,
        response.cross * left + response.right * right + rolled,
        momentum,
    )


@inner
def solve_torques(
    response: WheelResponse, left_slope: float, right_slope: float, left: float, right: float
) -> tuple[float, float]:
    """Solution x of (1 + M_w D) x = t for the slopes M_w and the torques t of both wheels."""
    b00, b01 = 1.0 + left_slope * response.left, left_slope * response.cross
    b10, b11 = right_slope * response.cross, 1.0 + right_slope * response.right
    inverse = 1.0 / (b00 * b11 - b01 * b10)
    return inverse * (b11 * left - b01 * right), inverse * (b00 * right - b10 * left)


@inner
def _add_wheel_column(
    corners: int,
    h: float,
    wheels: _WheelsPose,
    column: int,
    unit: Vector,
    response: WheelResponse,
    carried: float,
    rover_step: RoverStep,
    step: RoverContactStep,
) -> None:
    """Add the derivative of the wheels' loads by one unknown."""
    left, right, momentum = _spin_change(corners, h, wheels, column, unit, response, carried, step)
    for d in range(3):
        rover_step.load_tangent[3 + d, column] -= momentum / h * wheels.axle[d]
    for w in range(2 * CONTACTS_PER_WHEEL):
        k = corners + w
        if not _touches(k, step):
            continue
        spin = left if w < CONTACTS_PER_WHEEL else right
        move = _contact_move(k, column, unit, wheels, w, step)
        force = axpy(spin, vector_at(step.force_by_spin[w], 0), product(step.tangent[w], move))
        torque = dot(vector_at(step.torque_by_travel[w], 0), move) + step.torque[w, 1] * spin
        moment = _moment(w, wheels, force, torque, step)
        if column < 3:
            turn = rotate(wheels.pose.start, cayley_tangent(wheels.pose.th, unit))
            swept = scale(0.5, cross(turn, _of_wheel(w, wheels.left, wheels.right)))
            moment = add(moment, cross(swept, vector_at(step.force[k], 0)))
        for d in range(3):
            rover_step.load_tangent[d, column] += force[d]
            rover_step.load_tangent[3 + d, column] += moment[d]


@inner
def _of_wheel(w: int, left: Vector, right: Vector) -> Vector:
    """The left wheel's value or the right one's, of wheel contact w."""
    return left if w < CONTACTS_PER_WHEEL else right


@inner
def _contact_move(
    k: int, column: int, unit: Vector, wheels: _WheelsPose, w: int, step: RoverContactStep
) -> Vector:
    """Travel of a wheel's centre per unknown, with that of its contact point along the normal."""
    if column > 3:
        return unit
    turn = rotate(wheels.pose.start, cayley_tangent(wheels.pose.th, unit))
    normal = vector_at(step.normal[k], 0)
    deeper = dot(normal, cross(turn, vector_at(step.arm[w], 0)))
    return axpy(deeper, normal, cross(turn, _of_wheel(w, wheels.left, wheels.right)))


@inner
def _turned_axle(pose: Pose) -> Vector:
    """C e_y: the axle at the step's end in the axes of its start."""
    th = pose.th
    first = cross(th, (0.0, 1.0, 0.0))
    shrink = 1.0 / (1.0 + 0.25 * dot(th, th))
    return axpy(shrink, axpy(0.5, cross(th, first), first), (0.0, 1.0, 0.0))


@inner
def end_rover_contact(
    contact: RoverContact,
    terrain: Terrain,
    h: float,
    pose: Pose,
    anchors: Array,
    step: RoverContactStep,
    after: Array,
) -> tuple[float, float]:
    """Update the anchors after an accepted step.

    Args:
        contact: contact model of the rover.
        terrain: the ground.
        h: length of the step [s].
        pose: of the step.
        anchors: at the step's start [m], (anchor_rows, 3).
        step: of the last iteration.
        after: anchors at the step's end, filled.

    Returns:
        Work of the ground on bodies and wheels [J], and change of the energy that the contacts
        store [J]; the ground dissipates minus their sum.
    """
    corners = contact.corners.shape[0]
    work, stored = 0.0, -step.dropped_energy[0]
    turn = rotate(pose.start, pose.th)
    axle = rotate(pose.start, _turned_axle(pose))
    for wheel in range(2):
        set_vector_at(
            after[corners + 2 * CONTACTS_PER_WHEEL + wheel], 0, vector_at(step.rock_key[wheel], 0)
        )
    for k in range(corners + 2 * CONTACTS_PER_WHEEL):
        before = _anchor(corners, k, anchors, step)
        anchor = NO_VECTOR
        touched = step.near[k] != 0.0 and (step.depth0[k] > 0.0 or step.depth1[k] > 0.0)
        if touched:
            normal = vector_at(step.normal[k], 0)
            travel = vector_at(step.travel[k], 0)
            force = vector_at(step.force[k], 0)
            depth0, depth1 = step.depth0[k], step.depth1[k]
            work += dot(force, travel)
            if k < corners:
                law = blend_laws(contact.regolith, contact.rock, step.rock[k])
                anchor = advance_bristle(law, depth0, depth1, normal, travel, h, before)
                stored += contact_energy(law, depth1, anchor) - contact_energy(law, depth0, before)
            else:
                w = k - corners
                wheel = w // CONTACTS_PER_WHEEL
                spin = step.spin[wheel] + pose.th[1] / h
                forward = vector_at(step.forward[w], 0)
                moment = wheel_moment(vector_at(step.arm[w], 0), axle, force, step.torque[w, 0])
                work += dot(moment, turn) - step.torque[w, 0] * step.spin[wheel] * h
                if w % CONTACTS_PER_WHEEL == _FLOOR_SLOT and terrain.floor_rock <= 0.5:
                    anchor = advance_soil_bristle(
                        contact.wheel, depth0, depth1, normal, forward, travel, spin, h, before
                    )
                    stored += soil_energy(contact.wheel, depth1, anchor) - soil_energy(
                        contact.wheel, depth0, before
                    )
                else:
                    anchor = advance_rock_bristle(
                        contact.rock, contact.tip_radius, depth0, depth1, normal, forward, travel,
                        spin, h, before,
                    )  # fmt: skip
                    stored += contact_energy(contact.rock, depth1, anchor) - contact_energy(
                        contact.rock, depth0, before
                    )
        set_vector_at(after[k], 0, anchor)
    return work, stored
