"""Initial pose of tether and rover in a spatial scenario: hanging, straight, or on the ground.

A hanging tether is straight along its load. Its tension at the undeformed arc length s is
T = M a + rho A a (L - s) with the acceleration a along the tether and the mass M at its end; the
stretch x' follows from Green's strain, EA (x'^2 - 1)/2 x' = T, and the nodes from the integral of
x'. The error of a node's position by the cubic element is of fourth order in the strain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rover_sim.physics.ground.ray import distance_to_ground
from rover_sim.physics.ground.terrain import Terrain, floor_heights, wall_radius
from rover_sim.physics.numerics.roots_and_splines import bracketed_root
from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.starting_shapes import arc_nodes
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.plants.end_motion import carried_directors
from rover_sim.plants.spatial_state import FRAME_ROWS, rotation_matrix
from rover_sim.scenarios.hardware import RoverSettings, rest_slide
from rover_sim.scenarios.scenario_parts import ScenarioError
from rover_sim.scenarios.spatial_scenario import SpatialScenario

_DOWN = np.array([0.0, 0.0, -1.0])
_UP = np.array([0.0, 0.0, 1.0])
# How deep in the ground a start may be: a hanging one, which touches it, and a straight one, whose
# contacts may carry the rover [m].
_TOUCHES, _RESTS = 1.0e-9, 0.05


@dataclass(frozen=True)
class StartPose:
    """Pose and motion of tether and rover; in world axes, except `spin`."""

    nodes: Array  # of the chain, (n + 1, 2, 3)
    node_rates: Array
    fairlead_slope: Array  # slope and slope rate at the fairlead, (2, 3)
    tension: float  # at the fairlead [N]
    orientation: Array  # (w, x, y, z)
    spin: Array  # in base_link [rad/s], (3,)
    slide: float  # s [m]
    payout_rate: float = 0.0  # [m/s]


def arc_lengths(scenario: SpatialScenario) -> Array:
    """Return the undeformed arc length from the fairlead to the chain's nodes [m], (n + 1,)."""
    count, first = scenario.chain
    return np.asarray(
        first + scenario.tether.nominal_length * np.arange(count + 1.0), dtype=np.float64
    )


# ------------------------------------------------------------------------------------ start kinds


def hanging(scenario: SpatialScenario) -> StartPose:
    """Return the hanging equilibrium with the scenario's swing, motion and tilt."""
    start, g = scenario.start, scenario.gravity
    angle, heading = math.radians(start.swing_angle), math.radians(start.swing_heading)
    outward = np.array([math.cos(heading), math.sin(heading), 0.0])
    direction = math.sin(angle) * outward - math.cos(angle) * _UP
    rate = math.radians(start.swing_rate) * np.cross(outward, _UP)
    rate = rate + math.radians(start.cone_rate) * _UP
    whirl = float(np.sum(np.cross(rate, direction) ** 2))
    length = scenario.tether.length
    pull = g * math.cos(angle) + whirl * length
    nodes, fairlead_slope, tension = _stretched(scenario, direction, max(pull, 0.0))
    orientation, slide = np.array([1.0, 0.0, 0.0, 0.0]), 0.0
    spin = np.zeros(3)
    if scenario.rover is not None:
        orientation, slide = _hanging_pose(
            scenario.rover, direction, pull, math.radians(start.heading)
        )
        tilt = quaternion_of(np.radians(start.tilt))
        orientation = product(orientation, tilt)
        if any(start.tilt):
            axis = rotation_matrix(orientation)[:, 2]
            slide = rest_slide(scenario.rover, scenario.rover.m2 * pull * float(-axis @ direction))
        spin = rotation_matrix(orientation).T @ rate + np.radians(start.body_rate)
    node_rates = np.cross(rate, nodes)
    node_rates[:, 0] += start.payout_rate * fairlead_slope
    return StartPose(
        nodes=nodes,
        node_rates=node_rates,
        fairlead_slope=np.array([fairlead_slope, np.cross(rate, fairlead_slope)]),
        tension=tension,
        orientation=orientation,
        spin=spin,
        slide=slide,
        payout_rate=start.payout_rate,
    )


def check_clear(scenario: SpatialScenario, pose: StartPose, terrain: Terrain) -> None:
    """Refuse a hanging start whose rover or tip is in the ground, and a straight one deep in it.

    Raises:
        ScenarioError: it is; states where.
    """
    points, rover = pose.nodes[-1:, 0], scenario.rover
    if rover is not None:
        arms = _contact_points(rover) - np.array(rover.attachment)
        points = points + arms @ rotation_matrix(pose.orientation).T
    allowed = _RESTS if scenario.start.kind == "straight" else _TOUCHES
    for x, y, z in points.tolist():
        if distance_to_ground(terrain, (x, y, z + allowed), (0.0, 0.0, 1.0), 0.0) == 0.0:
            raise ScenarioError(
                "tether.length",
                scenario.tether.length,
                f"makes the start reach into the ground, at ({x:.3g}, {y:.3g}, {z:.3g}) m; should"
                " be less, or the ground farther away, or the tether in another direction",
            )


def straight(scenario: SpatialScenario) -> StartPose:
    """Return an unstretched straight tether with velocities proportional to arc length."""
    start = scenario.start
    direction = np.array(start.direction, dtype=np.float64)
    direction /= np.linalg.norm(direction)
    s = arc_lengths(scenario)
    nodes = np.empty((s.size, 2, 3))
    nodes[:, 0] = s[:, None] * direction
    nodes[:, 1] = direction
    per_length = np.array(start.tip_velocity) / scenario.tether.length
    rates = np.empty_like(nodes)
    rates[:, 0] = s[:, None] * per_length
    rates[:, 1] = per_length
    orientation = quaternion_of(np.array(start.attitude))
    slide = 0.0 if scenario.rover is None else scenario.rover.slider.free_length
    return StartPose(
        nodes=nodes,
        node_rates=rates,
        fairlead_slope=np.array([direction, per_length]),
        tension=0.0,
        orientation=orientation,
        spin=rotation_matrix(orientation).T @ np.array(start.angular_velocity),
        slide=slide,
    )


def on_ground(scenario: SpatialScenario, terrain: Terrain) -> StartPose:
    """Return the rover on the floor at its position with a slack tether, not yet settled."""
    rover, start = scenario.rover, scenario.start
    assert rover is not None
    x, y = start.position
    _check_inside(rover, terrain, x, y)
    turned, height = _grounded_pose(rover, terrain, x, y, math.radians(start.heading))
    matrix = rotation_matrix(turned)
    tip = np.array([x, y, height]) + matrix @ np.array(rover.attachment)
    s = arc_lengths(scenario)
    nodes, fairlead_slope = _slack(terrain, tip, scenario.tether.length, s)
    weight = rover.m2 * scenario.gravity * float(matrix[2, 2])
    return StartPose(
        nodes=nodes,
        node_rates=np.zeros_like(nodes),
        fairlead_slope=np.array([fairlead_slope, np.zeros(3)]),
        tension=0.0,
        orientation=turned,
        spin=np.zeros(3),
        slide=rest_slide(rover, weight),
    )


# ------------------------------------------------------------------------------------ the tether


def stretch(section: TetherSection, tension: Array) -> Array:
    """Return the stretch x' >= 1 [-] at tensions >= 0 [N]: x'^3 - x' = 2 T/EA, by Newton."""
    load = 2.0 * tension / section.axial_stiffness
    x = np.maximum(1.0 + 0.5 * load, np.cbrt(load))
    for _ in range(50):
        x = x - (x**3 - x - load) / (3.0 * x**2 - 1.0)
    return np.asarray(x)


def frames_along(scenario: SpatialScenario, pose: StartPose, twist: float) -> Array:
    """Return the frames of a tether with natural curvature, twisted evenly by `twist` [rad].

    As `SpatialState.frames`: empty for a straight tether. Nothing has relaxed.
    """
    if not scenario.tether.has_frames:
        return np.zeros((FRAME_ROWS, 0))
    s, length = arc_lengths(scenario), scenario.tether.length
    slopes = np.vstack([_DOWN, pose.fairlead_slope[0], pose.nodes[:, 1]])
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    directors = carried_directors(slopes)[2:]
    angles = (twist / length * s)[:, None]
    turned = np.cos(angles) * directors + np.sin(angles) * np.cross(slopes[2:], directors)
    spans = np.append(np.diff(s), s[0])
    return np.vstack([turned.T, twist / length * spans, np.zeros((2, len(s)))])


def _stretched(
    scenario: SpatialScenario, direction: Array, pull: float
) -> tuple[Array, Array, float]:
    """Return chain nodes, and slope and tension at the fairlead, of a straight hanging tether."""
    section, length = scenario.tether.section, scenario.tether.length
    end = scenario.tip_mass * pull
    weight = section.line_density * pull

    def slope(s: Array) -> Array:
        return stretch(section, end + weight * (length - s))

    s = arc_lengths(scenario)
    bounds = s if s[0] == 0.0 else np.concatenate([[0.0], s])
    spans = np.diff(bounds)
    inside = bounds[:-1, None] + spans[:, None] * ancf.GAUSS_POINTS
    grown = np.cumsum(spans * (slope(inside) @ ancf.GAUSS_WEIGHTS))
    places = grown if s[0] > 0.0 else np.concatenate([[0.0], grown])
    nodes = np.empty((s.size, 2, 3))
    nodes[:, 0] = places[:, None] * direction
    nodes[:, 1] = slope(s)[:, None] * direction
    return nodes, float(slope(np.zeros(1))[0]) * direction, end + weight * length


def _slack(terrain: Terrain, tip: Array, length: float, s: Array) -> tuple[Array, Array]:
    """Return chain nodes at the arc lengths s and the slope at the fairlead of a slack tether."""
    distance = float(np.linalg.norm(tip))
    if distance >= length:
        raise ScenarioError(
            "tether.length", length, f"should be above {distance:.4g} m, the distance to the rover"
        )

    def excess(slack: float) -> float:
        return _length(_path(terrain, tip, slack)) - length

    most = 1.0
    while excess(most) < 0.0:
        most *= 1.5
        if most > 1e4:
            raise ScenarioError("tether.length", length, "is too long to lay out")
    if excess(-1.0) < 0.0:
        path = _path(terrain, tip, bracketed_root(excess, -1.0, most, xtol=1e-6))
    else:  # too short to reach the floor
        path = arc_nodes(np.zeros(3), tip, 2000, length, _DOWN)[:, 0]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    places = s * along[-1] / length
    nodes = np.empty((s.size, 2, 3))
    tangents = np.gradient(path, along, axis=0)
    for d in range(3):
        nodes[:, 0, d] = np.interp(places, along, path[:, d])
        nodes[:, 1, d] = np.interp(places, along, tangents[:, d])
    nodes[:, 1] /= np.linalg.norm(nodes[:, 1], axis=1, keepdims=True)
    nodes[-1, 0] = tip
    if s[0] == 0.0:
        nodes[0, 0] = 0.0
    fairlead_slope = tangents[0] / np.linalg.norm(tangents[0])
    return nodes, fairlead_slope


_RISE_DISTANCE = 0.4  # from the rover, where the tether leaves the floor [m]
_ROUNDING = 0.25  # length of the rounded corners [m]
_SPACING = 0.02  # of the path's points [m]


def _path(terrain: Terrain, tip: Array, slack: float) -> Array:
    """Return a path from the fairlead to the tip, (k, 3), whose length increases with `slack`.

    At 0 it follows the plumb line to the floor, a straight line along it, and rises to the tip.
    Above 0 the line on the floor becomes an arc with the sagitta `slack`; below 0 the path meets
    the floor farther ahead, at -1 in front of the rover.
    """
    away = tip[:2]
    run = float(np.linalg.norm(away))
    ahead = away / run if run > 1e-9 else np.array([1.0, 0.0])
    rise_at = max(run - _RISE_DISTANCE, 0.0) if run > _RISE_DISTANCE else run
    lift_off = ahead * rise_at
    cut = max(-slack, 0.0)
    corner = ahead * rise_at * cut
    count = max(8, round((run + 4.0 * max(slack, 0.0)) / _SPACING))
    t = np.linspace(0.0, 1.0, count)
    plan = corner + (lift_off - corner) * t[:, None]
    side = np.array([-ahead[1], ahead[0]])
    plan = plan + max(slack, 0.0) * np.sin(math.pi * t)[:, None] ** 2 * side
    floor = np.column_stack([plan, floor_heights(terrain, plan[:, 0], plan[:, 1]) + 1e-3])
    down = np.linspace(np.zeros(3), floor[0], max(8, round(float(-floor[0, 2]) / _SPACING)))[:-1]
    up = np.linspace(
        floor[-1], tip, max(4, round(float(np.linalg.norm(tip - floor[-1])) / _SPACING))
    )
    return _rounded(np.vstack([down, floor, up[1:]]))


def _rounded(path: Array) -> Array:
    """Return the path with rounded corners and the same ends."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    count = max(16, round(along[-1] / _SPACING))
    even = np.linspace(0.0, along[-1], count)
    points = np.column_stack([np.interp(even, along, path[:, d]) for d in range(3)])
    half = max(1, round(_ROUNDING / (2.0 * along[-1] / count)))
    for _ in range(2):
        ends = np.vstack(
            [
                2.0 * points[0] - points[half:0:-1],
                points,
                2.0 * points[-1] - points[-2 : -half - 2 : -1],
            ]
        )
        total = np.cumsum(np.vstack([np.zeros(3), ends]), axis=0)
        window = 2 * half + 1
        points = (total[window:] - total[:-window]) / window
    return np.asarray(points)


def _length(path: Array) -> float:
    return float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))


# ------------------------------------------------------------------------------------- the rover


def _hanging_pose(
    rover: RoverSettings, direction: Array, pull: float, heading: float
) -> tuple[Array, float]:
    """Return orientation and slide of a rover at rest on a tether with the given direction."""
    turned = quaternion_of(heading * _UP)
    slide = rover.slider.free_length
    orientation = turned
    for _ in range(50):
        hang = rover.centre_of_mass(slide) - np.array(rover.attachment)
        lever = rotation_matrix(turned) @ hang
        orientation = product(_between(lever, direction), turned)
        axis = rotation_matrix(orientation)[:, 2]
        slide = rest_slide(rover, rover.m2 * pull * float(-axis @ direction))
    return orientation, slide


def _check_inside(rover: RoverSettings, terrain: Terrain, x: float, y: float) -> None:
    """Refuse a place of a rover on the floor of a hole that is in the wall."""
    if not terrain.has_hole:
        return
    reach = float(np.max(np.linalg.norm(_contact_points(rover)[:, :2], axis=1)))
    most = float(wall_radius(terrain, terrain.floor_height)[0]) - reach
    if not math.hypot(x - terrain.axis_x, y) < most:
        raise ScenarioError(
            "start.position",
            [x, y],
            f"is in the wall of the hole; should be within {most:.4g} m of its axis at"
            f" ({terrain.axis_x:g}, 0)",
        )


def _grounded_pose(
    rover: RoverSettings, terrain: Terrain, x: float, y: float, heading: float
) -> tuple[Array, float]:
    """Return orientation and height of a rover whose wheels and tail touch the floor.

    Each of the three points is on the ground below it, boulders included. If another point would
    be below the ground, the rover is raised; settling does the rest.
    """
    supports = _supports(rover)
    orientation = quaternion_of(heading * _UP)
    place = np.array([x, y, 0.0])
    for _ in range(20):
        matrix = rotation_matrix(orientation)
        points = np.array([place + matrix @ support for support in supports])
        ground = floor_heights(terrain, points[:, 0], points[:, 1])
        place[2] += float(np.max(ground - points[:, 2]))
        down = np.column_stack([points[:, :2], ground])
        normal = np.cross(down[0] - down[2], down[1] - down[2])
        normal *= np.sign(normal[2]) / np.linalg.norm(normal)
        own = np.cross(points[0] - points[2], points[1] - points[2])
        own *= np.sign(own[2]) / np.linalg.norm(own)
        orientation = product(_between(own, normal), orientation)
    matrix = rotation_matrix(orientation)
    place[2] += _depth(terrain, place + _contact_points(rover) @ matrix.T)
    return orientation, float(place[2])


def _supports(rover: RoverSettings) -> list[Array]:
    """Return the three points in base_link on which a level rover stands: wheels, tail or rear."""
    wheels = rover.wheels
    supports = [np.array(wheels.left), np.array(wheels.right)]
    for support in supports:
        support[2] -= wheels.tip_radius
    third = (
        rover.tail if rover.tail is not None else (-0.5 * rover.body1_size[0], 0.0, supports[0][2])
    )
    return [*supports, np.array(third)]


def _contact_points(rover: RoverSettings) -> Array:
    """Return Body 1's corners and the supports in base_link, (n, 3)."""
    corners, first = rover.corners
    return np.vstack([corners[:first], _supports(rover)])


def _depth(terrain: Terrain, points: Array) -> float:
    """Return the depth of the deepest of some points below the ground, < 0: none is [m]."""
    return float(np.max(floor_heights(terrain, points[:, 0], points[:, 1]) - points[:, 2]))


# ------------------------------------------------------------------------------------- rotations


def quaternion_of(vector: ArrayLike) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation vector [rad]."""
    turn = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return np.concatenate([[math.cos(0.5 * angle)], math.sin(0.5 * angle) / angle * turn])


def product(p: Array, q: Array) -> Array:
    """Return the quaternion of the rotation q followed by p."""
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], vector])


def _between(before: Array, after: Array) -> Array:
    """Return the quaternion of the smallest rotation from one direction to another."""
    a, b = before / np.linalg.norm(before), after / np.linalg.norm(after)
    scalar = 1.0 + float(a @ b)
    if scalar < 1e-12:  # opposite: half a turn about any perpendicular axis
        axis = np.cross(a, [1.0, 0.0, 0.0] if abs(a[0]) < 0.9 else [0.0, 1.0, 0.0])
        return np.concatenate([[0.0], axis / np.linalg.norm(axis)])
    quaternion = np.concatenate([[scalar], np.cross(a, b)])
    return np.asarray(quaternion / np.linalg.norm(quaternion))
