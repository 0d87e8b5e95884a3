"""The spatial plant as a rig for the winch: its tether, drum, rover and ground."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cache

from rover_sim import (
    Command,
    Event,
    JumpMotorCommand,
    Outcome,
    WheelRateCommand,
    WinchCommand,
    load_scenario,
)
from rover_sim.spatial_plant import SpatialPlant
from rover_verify.checks.winch_rig import Readings
from rover_verify.checks.winch_trials import TrialPlan
from tether_winch.servo import DriveCommand

WEIGHT = 16.2  # of the default rover on the Moon [N]
_SCENARIO = "free_hang"
TALLEST = 0.44  # from the tether's attachment down to the wheels [m]
_WALL_RADIUS = 30.0  # of the hole in the trials [m]
_SHAFT = 0.24  # diameter of the shaft under which the rover is caught [m]
# Softer than rock: the rover may be some centimetres within the lip where it appears [N/m^1.5].
_LIP_STIFFNESS = 1.0e5
_LIP_ROOM = 0.3 * _SHAFT  # largest offset of the tether when a lip appears [m]
_PULLS = 1.15  # fraction of the weight
_APART = 0.5  # wall contacts within this time count as one [s]
_NEAR_FLOOR = 0.3  # a contact below this height is with the floor [m]


@cache
def _plant(overrides: str) -> SpatialPlant:
    return SpatialPlant(load_scenario(_SCENARIO, json.loads(overrides)))


def spatial_plant(overrides: Mapping[str, object]) -> SpatialPlant:
    """The default machine hanging, with other values by dotted path; one plant for each set."""
    return _plant(json.dumps(overrides, sort_keys=True))


def on_floor(depth: float) -> dict[str, object]:
    """Overrides for a bare floor of rock, which a rover reaches on so much tether [m]."""
    return {"environment.floor": {"height": -(depth + TALLEST), "material": "rock"}}


def winch_command(order: DriveCommand) -> WinchCommand:
    """What the plant's drive is told when a winch's controller gives an order."""
    return WinchCommand(
        order.length, order.rate, order.feed_forward, order.release_brake, order.limit
    )


class SpatialRig:
    """A spatial plant under a winch controller.

    Args:
        overrides: values of the scenario by dotted path.

    Attributes:
        jump: command to the jump motor.
        wheel: command to the wheel motor.
        events: of the plant, since the start.
    """

    def __init__(self, overrides: Mapping[str, object] | None = None) -> None:
        self._overrides = {"sensors.error_model": "ideal", **(overrides or {})}
        self._plant = spatial_plant(self._overrides)
        self.state = self._plant.initial_state()
        self.peak_tension = 0.0
        self.jump: JumpMotorCommand | None = None
        self.wheel: WheelRateCommand | None = None
        self.events: list[Event] = []
        self.is_supported = False
        self.is_caught = False
        self.touches = 0  # wall contacts while the tether carries the rover
        self._last_touch = -math.inf
        self._has_lip = False

    def step(self, command: DriveCommand | None, dt: float) -> Readings:
        """Advance under a command; None = the drive has none.

        Raises:
            RuntimeError: the plant cannot go on.
        """
        sent = None if command is None else winch_command(command)
        self.state, result = self._plant.step(self.state, Command(self.jump, sent, self.wheel), dt)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.state.time:.3g} s")
        self.events += result.events
        forces = result.forces
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        touch = forces.left_wheel + forces.right_wheel + forces.body
        weight = self._plant.scenario.tip_mass * self._plant.scenario.gravity
        # A swinging rover knocks against a lip; a caught one pulls at it.
        pulls = forces.rover_tension > _PULLS * weight
        self.is_caught = self._has_lip and touch > 0.1 * weight and pulls
        self.is_supported = not self._has_lip and forces.rover_tension < 0.5 * weight < touch * 2.0
        if touch > 0.0 and not self._has_lip and self._is_above_floor:
            self.touches += self.state.time - self._last_touch > _APART
            self._last_touch = self.state.time
        drum = self.state.drives.drum
        return Readings(
            self.state.length,
            self._plant.payout_rate(self.state),
            not drum.braked,
            forces.winch_current,
            forces.fairlead_tension,
        )

    @property
    def depth(self) -> float:
        """Of the tether's attachment below the fairlead [m]."""
        return -float(self.state.nodes[-1, 0, 2])

    @property
    def slack(self) -> float:
        """Length by which the tether is longer than its way [m]."""
        x, y, z = self.state.nodes[-1, 0]
        return max(0.0, self.state.length - math.sqrt(x * x + y * y + z * z))

    @property
    def _is_above_floor(self) -> bool:
        environment = self._plant.scenario.environment
        if environment.hole is None or environment.hole.depth is None:
            return False
        # From the fairlead to the attachment of a standing rover.
        floor = environment.hole.depth + environment.hole.fairlead_height - TALLEST
        return self.depth < floor - _NEAR_FLOOR

    @property
    def has_room_for_lip(self) -> bool:
        """Whether the tether is so near the plumb line that a lip may appear about it."""
        return math.hypot(*self.state.nodes[-1, 0, :2]) < _LIP_ROOM

    def place_lip(self, depth: float) -> None:
        """Place a lip at a depth [m], which catches the rover; far above it has no effect.

        Raises:
            RuntimeError: the tether hangs too far aside for it.
        """
        if depth < 0.0:
            self._plant = spatial_plant(self._overrides)
            self._has_lip = False
            return
        if not self.has_room_for_lip:
            raise RuntimeError("the tether hangs aside, a lip would cut through it")
        # A shaft too narrow for the rover, widening below the lip like a funnel.
        shaft = {
            "diameter": _SHAFT,
            "depth": depth + 30.0,
            "overhang": 20.0,
            "overhang_depth": depth - 1.0,
            "wall_distance": 0.5 * _SHAFT,
            "fairlead_height": 0.5,
            "rim_radius": 0.05,
        }
        caught = {
            **self._overrides,
            "environment.floor": {"material": "rock"},
            "environment.rock.stiffness": _LIP_STIFFNESS,
            "environment.hole": shaft,
        }
        self._plant = SpatialPlant(load_scenario(_SCENARIO, caught))
        self._has_lip = True


def trial_rig(plan: TrialPlan) -> SpatialRig:
    """The spatial plant of one trial, in a hole along whose wall the rover swings."""
    hole = {
        "diameter": 2.0 * _WALL_RADIUS,
        "depth": plan.floor_depth + TALLEST - 1.0,
        "wall_distance": plan.wall_distance,
        "fairlead_height": 1.0,
        "rim_radius": 0.3,
    }
    return SpatialRig(
        {
            "tether.length": round(plan.start_length, 6),
            "start.swing_angle": math.degrees(plan.swing),
            "rover.m1": 6.0 * plan.payload,
            "rover.m2": 4.0 * plan.payload,
            "winch.friction.coulomb": 0.05 * plan.friction,
            "winch.friction.breakaway": 0.07 * plan.friction,
            "winch.friction.viscous": 0.005 * plan.friction,
            "environment.floor": {"material": "rock"},
            "environment.hole": hole,
        }
    )
