"""The rocks that a wheel is in contact with: two at a time, each in its own slot."""

import math

import numpy as np
import pytest

from rover_sim.physics.ground.boulders import BoulderParameters
from rover_sim.physics.ground.contact import REGOLITH, ROCK, contact_energy
from rover_sim.physics.ground.rover_contact import (
    CONTACTS_PER_WHEEL,
    RoverContact,
    RoverContactStep,
    anchor_rows,
    begin_rover_contact,
    make_rover_contact_step,
)
from rover_sim.physics.ground.terrain import Terrain, boulder_list, build_terrain, cell_boulders
from rover_sim.physics.ground.terrain_parameters import TerrainParameters
from rover_sim.physics.ground.wheel_contact import WheelLaw
from rover_sim.physics.ground.wheel_ground_geometry import NO_ROCK, deepest_rocks, wheel_on_rock
from rover_sim.physics.ground.wheel_soil import Soil, Wheel, wheel_on_soil
from rover_sim.physics.ground.wheel_table import wheel_table
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    ORIENTATION,
    POSITION,
    VELOCITY1,
    VELOCITY2,
    Pose,
)

RADIUS = 0.16
AXLE = (0.0, 1.0, 0.0)
AHEAD = np.array([1.0, 0.0, 0.0])
CORNERS = 1
CONTACT = RoverContact(
    corners=np.array([[0.0, 0.0, 9.0]]),
    first_body2_corner=1,
    left_wheel=(0.0, 0.0, 0.0),
    right_wheel=(0.0, 0.0, 9.0),
    radius=0.15,
    tip_radius=RADIUS,
    reach=9.0 + RADIUS,
    regolith=REGOLITH.law(),
    rock=ROCK.law(),
    wheel=WheelLaw(wheel_table(wheel_on_soil(Wheel(), Soil()))),
)
ANCHOR = np.array([1e-5, 0.0, 0.0])


@pytest.fixture(scope="module")
def rubble() -> Terrain:
    boulders = BoulderParameters(density=2.0, smallest=0.3, largest=0.6)
    return build_terrain(TerrainParameters(floor_height=0.0, boulders=boulders), 3)


def begin(
    terrain: Terrain, hub: np.ndarray, anchors: np.ndarray, h: float = 1e-3, fall: float = 0.0
) -> tuple[RoverContactStep, bool]:
    """Begin a step of the rover's contacts, with its left wheel at a given position."""
    body = np.zeros(BODY_SIZE)
    body[POSITION : POSITION + 3] = hub
    body[ORIENTATION] = 1.0
    body[VELOCITY1 + 2] = body[VELOCITY2 + 2] = -fall
    level = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    none = (0.0, 0.0, 0.0)
    pose = Pose(
        level, none, none, none, level[2], level[2], none, none, none, none, none, 0.0, 0.0, 0.0
    )
    step = make_rover_contact_step(CORNERS)
    return step, begin_rover_contact(CONTACT, terrain, h, pose, body, anchors, step)


def begun(terrain: Terrain, hub: np.ndarray, anchors: np.ndarray) -> RoverContactStep:
    """Contacts at the start of a step whose left wheel is at a given position near the ground."""
    step, near = begin(terrain, hub, anchors)
    assert near
    return step


@pytest.mark.parametrize(("h", "near"), [(1e-3, False), (0.05, True)])
def test_ground_that_the_rover_reaches_in_the_step_is_near(h: float, near: bool):
    level = build_terrain(TerrainParameters(floor_height=0.0))
    hub = np.array([0.0, 0.0, RADIUS + 0.1])
    assert begin(level, hub, np.zeros((anchor_rows(CORNERS), 3)), h, fall=3.0)[1] == near


def remembered(step: RoverContactStep) -> np.ndarray:
    """Anchors after a step, each rock's deflected."""
    anchors = np.zeros((anchor_rows(CORNERS), 3))
    anchors[CORNERS + 1 : CORNERS + CONTACTS_PER_WHEEL] = ANCHOR
    anchors[CORNERS + 2 * CONTACTS_PER_WHEEL :] = step.rock_key
    return anchors


def wedge(terrain: Terrain) -> np.ndarray:
    """A hub between two boulders, one ahead and one behind, equally deep in both."""
    boulders = boulder_list(terrain)
    for i, one in enumerate(boulders):
        for other in boulders[:i]:
            offset = other[:2] - one[:2]
            gap = math.hypot(*offset)
            reach = 0.5 * (one[3] + other[3])
            if abs(offset[1]) > 0.3 * gap or not reach < gap < reach + RADIUS:
                continue
            hub = np.array([*0.5 * (one[:2] + other[:2]), 0.0])
            for _ in range(200):  # up until both are just touched, each time evenly
                hub[2] += 3e-3
                first, rock1, second, rock2 = deepest_rocks(terrain, tuple(hub), AXLE, RADIUS)
                if NO_ROCK in (rock1, rock2) or first > 5e-3:
                    continue
                low, high = -0.1, 0.1
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    place = tuple(hub + middle * AHEAD)
                    depths = [
                        wheel_on_rock(terrain, place, AXLE, RADIUS, rock).depth
                        for rock in sorted((rock1, rock2))
                    ]
                    low, high = (middle, high) if depths[0] > depths[1] else (low, middle)
                found = hub + middle * AHEAD
                second = deepest_rocks(terrain, tuple(found), AXLE, RADIUS)[2]
                sides = [
                    float(wheel_on_rock(terrain, tuple(found), AXLE, RADIUS, rock).normal[0])
                    for rock in (rock1, rock2)
                ]
                if second > 1e-4 and min(sides) < -0.1 and max(sides) > 0.1:
                    return found
    raise AssertionError("no wedge in this rubble")


def test_a_wheel_between_two_boulders_is_in_contact_with_both(rubble: Terrain):
    hub = wedge(rubble)
    step = begun(rubble, hub, np.zeros((anchor_rows(CORNERS), 3)))
    wheel = slice(CORNERS + 1, CORNERS + CONTACTS_PER_WHEEL)
    depths = step.depth0[wheel]
    assert depths[0] == pytest.approx(depths[1], abs=1e-9)
    assert np.all(step.near[wheel] == 1.0)


def test_a_rock_keeps_its_slot_when_the_other_one_becomes_the_deepest(rubble: Terrain):
    hub = wedge(rubble)
    before = begun(rubble, hub - 2e-4 * AHEAD, np.zeros((anchor_rows(CORNERS), 3)))
    after = begun(rubble, hub + 2e-4 * AHEAD, remembered(before))
    np.testing.assert_array_equal(after.rock_key, before.rock_key)
    wheel = slice(CORNERS + 1, CORNERS + CONTACTS_PER_WHEEL)
    turned = np.sign(np.diff(after.depth0[wheel])), np.sign(np.diff(before.depth0[wheel]))
    assert turned[0] == -turned[1]
    assert np.all(after.depth0[wheel] > 0.0)
    assert after.dropped_energy[0] == 0.0


def with_third(terrain: Terrain, hub: np.ndarray) -> tuple[Terrain, float]:
    """The same rubble with a boulder beside the deepest one, a little smaller; and its rock."""
    _, rock, _, other = deepest_rocks(terrain, tuple(hub), AXLE, RADIUS)
    table = terrain.table.copy()
    start, stop = cell_boulders(terrain, hub[0], hub[1])
    entries = {k: 1e4 + table[k] for k in range(start, stop, 5)}
    (deepest,) = (k for k, key in entries.items() if key == rock)
    spare = next(k for k, key in entries.items() if key not in (rock, other))
    table[spare : spare + 5] = table[deepest : deepest + 5]
    table[spare] += 1e-7
    table[spare + 3] -= 1e-5
    return terrain._replace(table=table), 1e4 + table[spare]


def test_the_energy_stored_by_a_third_rock_is_part_of_the_balance(rubble: Terrain):
    hub = wedge(rubble)
    first, second = begun(rubble, hub, np.zeros((anchor_rows(CORNERS), 3))).rock_key[0, 1:]
    crowded, third = with_third(rubble, hub)
    step = begun(crowded, hub, np.zeros((anchor_rows(CORNERS), 3)))
    assert {first, second} == set(step.rock_key[0, 1:])
    # The third rock had the first one's slot: its energy is dropped, the first one's is added.
    anchors = remembered(step)
    anchors[CORNERS + 2 * CONTACTS_PER_WHEEL, 1:] = [third, second]
    again = begun(crowded, hub, anchors)
    depth = wheel_on_rock(crowded, tuple(hub), AXLE, RADIUS, third).depth
    gone = contact_energy(CONTACT.rock, depth, tuple(ANCHOR))
    come = contact_energy(CONTACT.rock, float(again.depth0[CORNERS + 1]), (0.0, 0.0, 0.0))
    assert again.rock_key[0, 1] == first
    assert gone > 0.0
    assert again.dropped_energy[0] == pytest.approx(gone - come)


def test_rocks_in_contact_at_the_start_drop_no_energy(rubble: Terrain):
    step = begun(rubble, wedge(rubble), np.zeros((anchor_rows(CORNERS), 3)))
    assert np.all(step.depth0[CORNERS + 1 : CORNERS + CONTACTS_PER_WHEEL] > 0.0)
    assert step.dropped_energy[0] == 0.0
