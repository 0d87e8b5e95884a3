"""Contact of the tether with the ground: floor, boulders, wall and rim.

Each element has two contact points, at its Gauss points, each for half of its length: the law of
`contact` per metre of tether, times that length. An element adds two unknowns per direction, so two
points detect every shape of the chain that penetrates the ground.

Forces have the discrete gradient form of `contact`. On curved ground the change of depth differs
from the normal times the travel u, and between regolith and rock the stiffness changes during the
step; both are corrected along u (Gonzalez 1996, J. Nonlinear Science 6),

    F = N (n + c u/u.u) + F_t + b u/u.u,
    c = -(d1 - d0) - n.u,    b = -(k1 - k0) 2/5 d0^(5/2),

with normal n and stiffness k1 at the step's end. So on every ground F.u is minus the change of the
stored energy minus the dissipation. c and b are of second order in u; the tangent omits their
derivatives.

A step calls `begin_tether_contact`; each Newton iteration calls `add_tether_contact` between
`assemble` and `solve_increment`; an accepted step calls `end_tether_contact`. Only points near the
ground at the step's start are evaluated.

The state is the deflection of each point's parking anchor, `anchors` (2 n or more, 3): rows 2 e and
2 e + 1 belong to element e.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.ground.contact import (
    NO_VECTOR,
    TOUCH,
    ContactLaw,
    advance_bristle,
    contact_energy,
    contact_force,
    friction_coefficient,
    normal_force,
)
from rover_sim.physics.ground.terrain import Terrain, depth_and_normal
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.named_parameters import from_parameters
from rover_sim.physics.numerics.simd import load, store
from rover_sim.physics.numerics.vectors import Matrix, Vector
from rover_sim.physics.tether.ancf import Array, shape_functions
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.tether import Tether

POINTS = 2  # on each element
NEAR = 0.02  # clearance, plus the travel of a step, within which points are evaluated [m]

_XI = np.array([0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0)])
_SHAPES = shape_functions(_XI, 1.0)  # of an element of unit length, (2, 4)
_POSITION_ROWS = np.zeros((POINTS, 2, 8))  # of the point's shape functions, by side
_POSITION_ROWS[:, :, :3] = _SHAPES[:, [0, 2], None]
_SLOPE_ROWS = np.zeros((POINTS, 2, 8))
_SLOPE_ROWS[:, :, 3:6] = _SHAPES[:, [1, 3], None]
_EXACT_CLEARANCE = 0.25  # clearance beyond which `terrain` gives no exact depth [m]
_SMALL_TRAVEL = 1.0e-5  # travel below which the corrections along u fade out [m]
_LARGEST_TILT = 0.5  # limit of the correction c u/u.u [-]


class TetherContactLaw(NamedTuple):
    """Contact laws for compiled functions; stiffnesses are per metre of tether."""

    regolith: ContactLaw
    rock: ContactLaw


@dataclass(frozen=True)
class TetherContactParameters(Configuration):
    """Contact parameters of a tether on regolith and rock, per metre of tether.

    Both materials have the same anchor stiffness, so that the stored energy does not change when
    the tether slides from one to the other. With the default, 5 g/m slips after about 0.1 mm under
    lunar gravity.
    """

    rock_stiffness: float = quantity("N/m^1.5/m", "k on rock", 1.0e5, above=0.0)
    regolith_stiffness: float = quantity("N/m^1.5/m", "k on regolith", 2.0e4, above=0.0)
    damping: float = quantity("s/m", "c of 1 + 1.5 c d'", 0.5, minimum=0.0)
    rock_static_friction: float = quantity("-", "mu at rest on rock", 0.6, minimum=0.0, maximum=5.0)
    rock_kinetic_friction: float = quantity(
        "-", "mu sliding on rock", 0.5, minimum=0.0, maximum=5.0
    )
    regolith_static_friction: float = quantity("-", "mu at rest", 0.6, minimum=0.0, maximum=5.0)
    regolith_kinetic_friction: float = quantity("-", "mu sliding", 0.5, minimum=0.0, maximum=5.0)
    stribeck_speed: float = quantity("m/s", "Stribeck velocity", 0.05, above=0.0)
    slip_speed: float = quantity("m/s", "of the friction's regularisation", 0.002, above=0.0)
    anchor_stiffness: float = quantity("N/m/m", "of the parking anchor", 50.0, minimum=0.0)

    def check(self) -> None:
        """Refuse a friction at rest below that of sliding."""
        for name in ("rock", "regolith"):
            law = self._material(name)
            if law.static_friction < law.kinetic_friction:
                raise ConfigurationError(
                    f"{name}_static_friction",
                    law.static_friction,
                    f"should be at least the {name}_kinetic_friction of {law.kinetic_friction:g}",
                )

    def _material(self, name: str) -> ContactLaw:
        return from_parameters(
            ContactLaw,
            self,
            stiffness=getattr(self, f"{name}_stiffness"),
            static_friction=getattr(self, f"{name}_static_friction"),
            kinetic_friction=getattr(self, f"{name}_kinetic_friction"),
        )

    def law(self) -> TetherContactLaw:
        """The parameters for compiled functions."""
        return TetherContactLaw(self._material("regolith"), self._material("rock"))


class TetherContact(NamedTuple):
    """Work arrays of the contact, for the largest number of elements.

    The first group is indexed by point, the second by position in the list of near points.
    """

    start: Array  # position at the step's start [m], (points, 3)
    depth: Array  # d0 [m], (points,)
    rock: Array  # rock [-] at the step's start, (points,)
    near_count: NDArray[np.int64]  # number of near points, (1,)
    queried: NDArray[np.int64]  # indices of the points of which the terrain is queried

    near: NDArray[np.int64]  # indices of the near points
    position: Array  # position at the step's end [m], (points, 3)
    travel: Array  # u [m], (points, 3)
    ground: Array  # depth d1 [m], normal n, rock [-] at the step's end, (points, 5)
    slip: Array  # tangential travel in the previous iteration [m], (points, 3)
    touches: NDArray[np.int64]  # 1 where there is a force
    force: Array  # columns of dF/du, then F, each written twice, (points, 4, 8)


class TetherContactTotals(NamedTuple):
    """Energies of the contact in a step."""

    dissipated: float  # [J]
    stored_change: float  # of the energy in ground and anchors [J]


def make_tether_contact(elements: int) -> TetherContact:
    """Allocate the arrays for a tether of at most `elements` elements."""
    points = POINTS * elements
    return TetherContact(
        np.zeros((points, 3)),
        np.zeros(points),
        np.zeros(points),
        np.zeros(1, np.int64),
        np.zeros(points, np.int64),
        np.zeros(points, np.int64),
        np.zeros((points, 3)),
        np.zeros((points, 3)),
        np.zeros((points, 5)),
        np.zeros((points, 3)),
        np.zeros(points, np.int64),
        np.zeros((points, 4, 8)),
    )


@inner
def _interpolate(rows: Array, length: float, e: int, g: int, d: int) -> float:
    """Direction d of S e at point g of element e."""
    return (
        _SHAPES[g, 0] * rows[d, e]
        + _SHAPES[g, 2] * rows[d, e + 1]
        + length * (_SHAPES[g, 1] * rows[3 + d, e] + _SHAPES[g, 3] * rows[3 + d, e + 1])
    )


@inner
def query_terrain(terrain: Terrain, points: Array, count: int, ground: Array) -> None:
    """Depth, normal and rock at the first `count` points: the module's only terrain query."""
    for s in range(count):
        depth, nx, ny, nz, rock = depth_and_normal(
            terrain, points[s, 0], points[s, 1], points[s, 2]
        )
        ground[s, 0] = depth
        ground[s, 1], ground[s, 2], ground[s, 3] = nx, ny, nz
        ground[s, 4] = rock


@inner
def place_points(tether: Tether, q: Array, contact: TetherContact) -> None:
    """Positions of all points at the step's start."""
    for e in range(tether.elements):
        for g in range(POINTS):
            for d in range(3):
                contact.start[POINTS * e + g, d] = _interpolate(q, tether.element_length, e, g, d)


@inner
def _is_near(
    tether: Tether, h: float, v: Array, anchors: Array, p: int, contact: TetherContact
) -> bool:
    """Whether a point may come into contact in a step of length h."""
    depth = contact.depth[p]
    if depth > -NEAR or anchors[p, 0] != 0.0 or anchors[p, 1] != 0.0 or anchors[p, 2] != 0.0:
        return True
    if depth <= -_EXACT_CLEARANCE:
        return False
    speed = 0.0
    for d in range(3):
        speed += _interpolate(v, tether.element_length, p // POINTS, p % POINTS, d) ** 2
    return depth > -(NEAR + math.sqrt(speed) * h)


@inner
def begin_tether_contact(
    terrain: Terrain,
    tether: Tether,
    h: float,
    q: Array,
    v: Array,
    anchors: Array,
    follows: bool,
    contact: TetherContact,
) -> int:
    """Find the points that may come into contact in a step of length h from (q, v).

    Both points of an element are near if one is.

    Args:
        terrain: the ground.
        tether: with its number of elements.
        h: [s].
        q: rows of the chain's nodes, (6, width).
        v: their rates.
        anchors: deflections of the points' anchors [m], (points, 3).
        follows: whether `end_tether_contact` ended the step before with these arrays, so that they
            hold the depths of the points that were near in it.
        contact: filled.

    Returns:
        Number of these near points.
    """
    place_points(tether, q, contact)
    points = POINTS * tether.elements
    unknown = 0
    after_near = 0
    known = contact.near_count[0] if follows else 0
    for p in range(points):
        if after_near < known and contact.near[after_near] == p:
            after_near += 1
            continue
        contact.queried[unknown] = p
        for d in range(3):
            contact.position[unknown, d] = contact.start[p, d]
        unknown += 1
    query_terrain(terrain, contact.position, unknown, contact.ground)
    for s in range(unknown):
        p = contact.queried[s]
        contact.depth[p], contact.rock[p] = contact.ground[s, 0], contact.ground[s, 4]
    count = 0
    for first in range(0, points, POINTS):
        near = False
        for p in range(first, first + POINTS):
            near = near or _is_near(tether, h, v, anchors, p, contact)
        if not near:
            continue
        for p in range(first, first + POINTS):
            contact.near[count] = p
            contact.slip[count, 0], contact.slip[count, 1], contact.slip[count, 2] = NO_VECTOR
            count += 1
    contact.near_count[0] = count
    return count


@inner
def point_law(law: TetherContactLaw, weight: float, rock: float) -> ContactLaw:
    """Contact law of a point that represents `weight` metres of tether."""
    a, b = law.regolith, law.rock
    return ContactLaw(
        weight * (a.stiffness + rock * (b.stiffness - a.stiffness)),
        a.damping,
        a.static_friction + rock * (b.static_friction - a.static_friction),
        a.kinetic_friction + rock * (b.kinetic_friction - a.kinetic_friction),
        a.stribeck_speed,
        a.slip_speed,
        weight * a.anchor_stiffness,
    )


@inner
def _has_reversed(contact: TetherContact, s: int, slip: Vector, width: float) -> bool:
    """Whether the slip has reversed since the previous iteration; stores the slip.

    Friction is regularised below the slip `width` [m].
    """
    previous = contact.slip
    reverses = slip[0] * previous[s, 0] + slip[1] * previous[s, 1] + slip[2] * previous[s, 2] < 0.0
    large = slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2 > 4.0 * width * width
    if reverses and large:
        previous[s, 0], previous[s, 1], previous[s, 2] = 0.0, 0.0, 0.0
        return True
    previous[s, 0], previous[s, 1], previous[s, 2] = slip
    return False


@inner
def _friction_from_rest(
    law: ContactLaw, depth0: float, depth1: float, normal: Vector, slip: Vector, h: float
) -> tuple[Vector, Matrix]:
    """Force and tangent with friction linearised at zero slip.

    The friction of a light tether reverses within a slip of v_s h, and Newton's method can
    alternate between both signs without end. From zero slip it converges monotonically, because
    friction is concave there. So where the slip has reversed, this iteration uses linear friction
    with the slope at rest.
    """
    load, stiffness = normal_force(law, depth0, depth1, h)
    slope = friction_coefficient(law, 0.0)[0] * load / (law.slip_speed * h)
    nx, ny, nz = normal
    over = slope - stiffness
    return (
        (load * nx - slope * slip[0], load * ny - slope * slip[1], load * nz - slope * slip[2]),
        (
            over * nx * nx - slope,
            over * nx * ny,
            over * nx * nz,
            over * ny * nx,
            over * ny * ny - slope,
            over * ny * nz,
            over * nz * nx,
            over * nz * ny,
            over * nz * nz - slope,
        ),
    )


@inner
def _evaluate(
    terrain: Terrain,
    law: TetherContactLaw,
    tether: Tether,
    h: float,
    anchors: Array,
    work: Workspace,
    contact: TetherContact,
) -> int:
    """Forces and tangents at the near points for the increment in `work`.

    Returns:
        Number of points at which `_friction_from_rest` replaces the law.
    """
    linearised = 0
    count = contact.near_count[0]
    weight = tether.element_length / POINTS
    for s in range(count):
        p = contact.near[s]
        for d in range(3):
            move = _interpolate(work.increment, tether.element_length, p // POINTS, p % POINTS, d)
            contact.travel[s, d] = move
            contact.position[s, d] = contact.start[p, d] + move
    query_terrain(terrain, contact.position, count, contact.ground)
    for s in range(count):
        p = contact.near[s]
        depth0 = contact.depth[p]
        depth1 = contact.ground[s, 0]
        if not (depth0 > TOUCH or depth1 > TOUCH):
            contact.touches[s] = 0
            for c in range(4):
                for k in range(6):
                    contact.force[s, c, k] = 0.0
            continue
        contact.touches[s] = 1
        nx, ny, nz = contact.ground[s, 1], contact.ground[s, 2], contact.ground[s, 3]
        ux, uy, uz = contact.travel[s, 0], contact.travel[s, 1], contact.travel[s, 2]
        rock = contact.ground[s, 4]
        here = point_law(law, weight, rock)
        along = ux * nx + uy * ny + uz * nz
        wx, wy, wz = ux - along * nx, uy - along * ny, uz - along * nz
        if _has_reversed(contact, s, (wx, wy, wz), h * here.slip_speed):
            linearised += 1
            force, tangent = _friction_from_rest(
                here, depth0, depth1, (nx, ny, nz), (wx, wy, wz), h
            )
        else:
            force, tangent = contact_force(
                here,
                depth0,
                depth1,
                (nx, ny, nz),
                (ux, uy, uz),
                h,
                (anchors[p, 0], anchors[p, 1], anchors[p, 2]),
            )
        normal = force[0] * nx + force[1] * ny + force[2] * nz
        square = ux * ux + uy * uy + uz * uz
        inverse = 1.0 / (square + _SMALL_TRAVEL * _SMALL_TRAVEL)
        tilt = (depth0 - depth1 - along) * inverse
        if tilt * tilt * square > _LARGEST_TILT * _LARGEST_TILT:
            tilt = math.copysign(_LARGEST_TILT / math.sqrt(square), tilt)
        along = normal * tilt
        change = rock - contact.rock[p]
        if change != 0.0:
            stiffer = change * weight * (law.rock.stiffness - law.regolith.stiffness)
            along -= stiffer * 0.4 * depth0 * depth0 * math.sqrt(max(depth0, 0.0)) * inverse
        out = contact.force
        for k in range(0, 6, 3):
            for d in range(3):
                for c in range(3):
                    out[s, c, k + d] = tangent[3 * d + c]
            out[s, 3, k] = force[0] + along * ux
            out[s, 3, k + 1] = force[1] + along * uy
            out[s, 3, k + 2] = force[2] + along * uz
    return linearised


@inner
def add_tether_contact(
    terrain: Terrain,
    law: TetherContactLaw,
    tether: Tether,
    h: float,
    anchors: Array,
    work: Workspace,
    contact: TetherContact,
) -> int:
    """Add the ground's forces for the increment in `work` to the elements' residual and tangent.

    Returns:
        Number of points at which friction is linearised (`_friction_from_rest`); unless it is 0,
        another iteration must follow.
    """
    if contact.near_count[0] == 0:
        return 0
    linearised = _evaluate(terrain, law, tether, h, anchors, work, contact)
    for s in range(0, contact.near_count[0], POINTS):
        if contact.touches[s] != 0 or contact.touches[s + 1] != 0:
            _subtract_element(tether, contact.near[s] // POINTS, s, contact.force, work.blocks)
    return int(linearised)


@inner
def _node_rows(tether: Tether, g: int, side: int) -> Any:
    """Weights of point g's force in the rows of a node, position and slope, as a packet."""
    tag = tether.gravity
    rows = load(tag, _POSITION_ROWS, (g, side, 0))
    return rows + tether.element_length * load(tag, _SLOPE_ROWS, (g, side, 0))


@inner
def _subtract_element(tether: Tether, element: int, s: int, force: Array, blocks: Array) -> None:
    """Subtract force and tangent of an element's points, s and s + 1 in the list of near points.

    `block_elimination` describes the blocks.
    """
    tag = tether.gravity
    length = tether.element_length
    e = element + 1
    for side in range(2):
        rows0, rows1 = _node_rows(tether, 0, side), _node_rows(tether, 1, side)
        k, other = 2 * side, 2 - 2 * side
        for c in range(3):
            first = rows0 * load(tag, force, (s, c, 0))
            second = rows1 * load(tag, force, (s + 1, c, 0))
            change = _SHAPES[0, k] * first + _SHAPES[1, k] * second
            _subtract(tag, blocks, e, side, c, change)
            change = _SHAPES[0, k + 1] * first + _SHAPES[1, k + 1] * second
            _subtract(tag, blocks, e, side, 3 + c, length * change)
            change = _SHAPES[0, other] * first + _SHAPES[1, other] * second
            _subtract(tag, blocks, e, side, 7 + c, change)
            change = _SHAPES[0, other + 1] * first + _SHAPES[1, other + 1] * second
            _subtract(tag, blocks, e, side, 10 + c, length * change)
        change = rows0 * load(tag, force, (s, 3, 0)) + rows1 * load(tag, force, (s + 1, 3, 0))
        _subtract(tag, blocks, e, side, 6, change)


@inner
def _subtract(tag: Any, blocks: Array, e: int, side: int, column: int, change: Any) -> None:
    """Subtract a packet from a column of an element's side."""
    store(blocks, (e, side, column, 0), load(tag, blocks, (e, side, column, 0)) - change)


@inner
def end_tether_contact(
    law: TetherContactLaw,
    tether: Tether,
    h: float,
    anchors: Array,
    work: Workspace,
    contact: TetherContact,
) -> TetherContactTotals:
    """Update the anchors after an accepted step, whose increment is in `work`.

    The depths of the near points become those at its end. The forces are those of the last
    iteration's linearised equations, force plus tangent times its increment, because these balance
    the motion.
    """
    weight = tether.element_length / POINTS
    stored_change = 0.0
    work_on_ground = 0.0
    for s in range(contact.near_count[0]):
        p = contact.near[s]
        depth = contact.ground[s, 0]
        for d in range(3):
            travel = _interpolate(work.increment, tether.element_length, p // POINTS, p % POINTS, d)
            contact.position[s, d] = (
                travel - contact.travel[s, d]
            )  # increment of the last iteration
            contact.travel[s, d] = travel
            depth -= contact.position[s, d] * contact.ground[s, 1 + d]
        bristle = (anchors[p, 0], anchors[p, 1], anchors[p, 2])
        before = point_law(law, weight, contact.rock[p])
        stored_change -= contact_energy(before, contact.depth[p], bristle)
        after = point_law(law, weight, contact.ground[s, 4])
        bristle = advance_bristle(
            after,
            contact.depth[p],
            depth,
            (contact.ground[s, 1], contact.ground[s, 2], contact.ground[s, 3]),
            (contact.travel[s, 0], contact.travel[s, 1], contact.travel[s, 2]),
            h,
            bristle,
        )
        anchors[p, 0], anchors[p, 1], anchors[p, 2] = bristle
        stored_change += contact_energy(after, depth, bristle)
        contact.depth[p], contact.rock[p] = depth, contact.ground[s, 4]
        if contact.touches[s] != 0:
            for d in range(3):
                force = contact.force[s, 3, d]
                for c in range(3):
                    force += contact.force[s, c, d] * contact.position[s, c]
                work_on_ground -= force * contact.travel[s, d]
    return TetherContactTotals(work_on_ground - stored_change, stored_change)
