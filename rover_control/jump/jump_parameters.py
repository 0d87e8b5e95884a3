"""Phases and parameters of the jump sequence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas import machine
from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class JumpParameters:
    """Limits and times of the jump sequence."""

    max_stroke: float = parameter(
        0.20,
        "m",
        "largest spring compression that a request may ask for",
        0.005,
        machine.MAX_STROKE,
    )
    nut_speed: float = parameter(
        0.05, "m/s", "nut speed of a request that gives none", 1e-3, machine.MAX_NUT_SPEED
    )
    let_down_speed: float = parameter(
        0.05, "m/s", "nut speed while the spring is let down", 1e-3, machine.MAX_NUT_SPEED
    )
    max_nut_force: float = parameter(
        400.0, "N", "force limit sent with each nut command", 1.0, machine.MAX_NUT_FORCE
    )
    nut_zero_tolerance: float = parameter(
        1e-3, "m", "compression up to which the spring counts as let down", 1e-5, 0.02
    )
    nut_position_tolerance: float = parameter(
        5e-4, "m", "position error at which the nut has reached its setpoint", 1e-5, 0.01
    )
    hook_check_stroke: float = parameter(
        0.02, "m", "compression above which the nut must carry the spring's force",
        1e-3, machine.MAX_STROKE,
    )  # fmt: skip
    hook_check_force: float = parameter(
        5.0, "N", "least force on the nut there; below it the latch has not hooked", 0.0,
        machine.MAX_NUT_FORCE,
    )  # fmt: skip
    nut_park_position: float = parameter(
        -0.03, "m", "position of the nut above the hooked latch", -machine.MAX_FREE_TRAVEL, 0.0
    )
    sensor_timeout: float = parameter(
        0.25, "s", "age of the last sample at which a sensor is stale", 0.02, 5.0
    )
    nut_time_margin: float = parameter(
        4.0, "s", "time limit of a nut travel beyond distance / speed", 0.1, 60.0
    )
    contact_loss_time: float = parameter(
        0.10, "s", "open contact with the spring held after which the rover counts as lifted",
        0.0, 5.0,
    )  # fmt: skip
    hold_time: float = parameter(
        0.30, "s", "quiet time with the spring held before the release", 0.0, 10.0
    )
    hold_timeout: float = parameter(5.0, "s", "time limit for becoming quiet", 0.5, 60.0)
    release_timeout: float = parameter(
        1.0, "s", "time limit from the trip command until the latch releases", 0.1, 10.0
    )
    take_off_timeout: float = parameter(
        2.0, "s", "time limit from the release until the rover leaves the ground", 0.2, 10.0
    )
    flight_timeout: float = parameter(20.0, "s", "time limit of a flight", 0.5, 120.0)
    settle_time: float = parameter(
        0.30, "s", "quiet time on the ground after which the rover is at rest", 0.0, 10.0
    )
    settle_timeout: float = parameter(
        5.0, "s", "time limit for coming to rest after a landing", 0.5, 60.0
    )
    quiet_force_fraction: float = parameter(
        0.15, "-", "quiet: deviation of the specific force, as a fraction of that before the jump",
        0.01, 1.0,
    )  # fmt: skip
    quiet_rate: float = parameter(
        0.05, "rad/s", "quiet: largest angular rate before the release", 1e-3, 1.0
    )
    max_tilt: float = parameter(
        0.35, "rad", "largest tilt at which the latch is released", 0.0, math.pi
    )
    toppled_tilt: float = parameter(
        0.8, "rad", "tilt above which a landed rover has toppled", 0.1, math.pi
    )
    max_tether_tension: float = parameter(
        2.0, "N", "largest tether tension at which the latch is released", 0.0, 1e3
    )
