"""The drives of a plant, as its scenario equips it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from msg_schemas.events import PlantEvent
from rover_sim.scenarios.spatial_scenario import SpatialScenario


@dataclass(frozen=True)
class Nut:
    """The nut of the jump motor's screw."""

    spring_rate: float  # of the jump spring [N/m]
    stroke: float = math.inf  # largest compression [m]
    free_travel: float = 0.0  # above the latch [m]
    holds: bool = False  # whether the drive holds the nut against the spring
    needs_ground: bool = False  # whether it works only while the ground holds the rover
    trip_event: PlantEvent = PlantEvent.TAKE_OFF  # plant event when the latch trips


@dataclass(frozen=True)
class QuickStopDecelerations:
    """Quick-stop decelerations of the drives; inf: without mechanics the drive stops at once."""

    winch: float = math.inf  # of the payout rate [m/s^2]
    wheels: float = math.inf  # of the left wheel [rad/s^2]
    flywheel: float = math.inf  # of the jump motor's shaft [rad/s^2]
    nut: float = math.inf  # the same along the screw [m/s^2]


@dataclass(frozen=True)
class Equipment:
    """The drives of a plant."""

    scenario: str  # name of the scenario
    nut: Nut | None = None
    flywheel: bool = False
    wheels: bool = False
    fixed_length: float | None = None  # of a drum without a motor [m]; None: it has a motor
    quick_stop: QuickStopDecelerations = field(default_factory=QuickStopDecelerations)


def spatial_equipment(scenario: SpatialScenario) -> Equipment:
    """Return the drives of a spatial scenario's rover and winch."""
    rover, winch = scenario.rover, scenario.winch
    nut, stop = None, QuickStopDecelerations()
    if rover is not None:
        jump = rover.jump_drive
        nut = Nut(
            rover.slider.spring_rate,
            0.0 if rover.is_single_body else jump.stroke,
            jump.free_travel,
            holds=True,
            trip_event=PlantEvent.LATCH_RELEASED,
        )
        stop = QuickStopDecelerations(
            math.inf if winch is None else winch.quick_stop_deceleration,
            rover.wheel_drive.quick_stop_deceleration,
            jump.quick_stop_deceleration,
            jump.quick_stop_deceleration * jump.lead / math.tau,
        )
    elif winch is not None:
        stop = QuickStopDecelerations(winch.quick_stop_deceleration)
    return Equipment(
        scenario.name,
        nut=nut,
        flywheel=nut is not None,
        wheels=nut is not None,
        fixed_length=scenario.tether.length if winch is None else None,
        quick_stop=stop,
    )
