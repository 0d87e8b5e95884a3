"""The jump's phases, limits and times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas.parameters import parameter
from msg_schemas.table import MAX_FREE_TRAVEL, MAX_NUT_FORCE, MAX_NUT_SPEED, MAX_STROKE


class JumpPhase(StrEnum):
    """What the sequence is doing; the words of the contract."""

    STANDBY = "standby"
    PREDICTING = "predicting"
    GIVING_SLACK = "giving_slack"
    COMPRESSING = "compressing"
    SETTLING = "settling"
    RELEASING = "releasing"
    FLIGHT = "flight"
    LANDED = "landed"
    HOOKING = "hooking"
    LETTING_DOWN = "letting_down"
    FAULT = "fault"


@dataclass(frozen=True)
class JumpParameters:
    """Limits and times of a jump."""

    largest_stroke: float = parameter(
        0.20, "m", "largest compression of the spring that a request may ask for", 0.005, MAX_STROKE
    )
    nut_speed: float = parameter(
        0.05, "m/s", "nut speed if the request names none", 1e-3, MAX_NUT_SPEED
    )
    let_down_speed: float = parameter(
        0.05, "m/s", "nut speed while letting the spring down", 1e-3, MAX_NUT_SPEED
    )
    nut_force: float = parameter(
        400.0, "N", "largest force that the nut may use", 1.0, MAX_NUT_FORCE
    )
    nut_zero: float = parameter(1e-3, "m", "a compression below this counts as none", 1e-5, 0.02)
    nut_tolerance: float = parameter(
        5e-4, "m", "a nut so near to where it was sent has arrived", 1e-5, 0.01
    )
    hook_check: float = parameter(
        0.02, "m", "compression from which on a hooked latch must feel the spring", 1e-3, MAX_STROKE
    )
    hook_force: float = parameter(
        5.0, "N", "that a hooked latch feels there at least", 0.0, MAX_NUT_FORCE
    )
    hooked_at: float = parameter(
        -0.03, "m", "where the nut waits above the latch once that is hooked", -MAX_FREE_TRAVEL, 0.0
    )
    sensor_timeout: float = parameter(
        0.25, "s", "a sensor whose last sample is older is lost", 0.02, 5.0
    )
    compress_margin: float = parameter(
        4.0, "s", "longer than way / speed that the nut may take", 0.1, 60.0
    )
    contact_loss_time: float = parameter(
        0.10, "s", "contact open with the spring held for this long: lifted, not taken off",
        0.0, 5.0,
    )  # fmt: skip
    hold_time: float = parameter(
        0.30, "s", "quiet with the spring held for this long before the release", 0.0, 10.0
    )
    hold_limit: float = parameter(5.0, "s", "longest time to become so quiet", 0.5, 60.0)
    release_limit: float = parameter(
        1.0, "s", "longest time from the order to trip until the latch lets go", 0.1, 10.0
    )
    take_off_limit: float = parameter(
        2.0, "s", "longest time from the release until the rover leaves the ground", 0.2, 10.0
    )
    flight_limit: float = parameter(20.0, "s", "longest flight", 0.5, 120.0)
    settle_time: float = parameter(
        0.30, "s", "on the ground and quiet for this long: landed for good", 0.0, 10.0
    )
    settle_limit: float = parameter(5.0, "s", "longest time to come to rest", 0.5, 60.0)
    quiet_force: float = parameter(
        0.15, "-", "quiet: specific force within this part of that before the jump", 0.01, 1.0
    )
    quiet_rate: float = parameter(
        0.05, "rad/s", "quiet before the release: angular velocity below this", 1e-3, 1.0
    )
    largest_tilt: float = parameter(
        0.35, "rad", "largest tilt at which the spring is released", 0.0, math.pi
    )
    toppled_tilt: float = parameter(
        0.8, "rad", "tilt beyond which a landed rover has toppled", 0.1, math.pi
    )
    largest_pull: float = parameter(
        2.0, "N", "largest pull of the tether at which the spring is released", 0.0, 1e3
    )
