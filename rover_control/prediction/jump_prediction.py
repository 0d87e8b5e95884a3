"""Request and result of a jump prediction. Pure; independent of the simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import machine
from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class PredictionParameters:
    """Model that predicts jumps, and limits that a predicted jump must meet."""

    prediction_scenario: str = parameter(
        "floor_rubble", "-", "scenario with the machine, its tether and gravity"
    )
    floor_depth: float = parameter(
        5.0, "m", "depth of the floor below the fairlead, where the odometry gives none", 0.5, 1e3
    )
    attachment_height: float = parameter(
        0.43, "m", "height of the tether attachment above the floor, rover standing", 0.0, 10.0
    )
    rollouts: int = parameter(32, "-", "simulated jumps per prediction", 8, 256)
    prediction_time_step: float = parameter(
        4.0e-3, "s", "largest time step of the model", 1e-4, 5e-3
    )
    prediction_elements: int = parameter(
        12, "-", "approximate number of tether elements of the model", 4, 100
    )
    prediction_timeout: float = parameter(
        60.0, "s", "time limit of a prediction, and of giving slack, by the node's clock",
        1.0, 600.0,
    )  # fmt: skip
    stance_tilt_std: float = parameter(
        3.0e-3, "rad", "standard deviation of the modelled tilt on the floor, per axis", 0.0, 0.2
    )
    clearance_risk: float = parameter(
        0.10, "-", "probability that a jump stays below the requested clearance", 0.01, 0.5
    )
    min_upright_probability: float = parameter(
        0.9, "-", "least probability of landing upright", 0.0, 1.0
    )
    upright_tilt: float = parameter(
        0.8, "rad", "tilt against the floor up to which a landed rover is upright", 0.1, 1.6
    )
    max_peak_tension: float = parameter(
        50.0, "N", "largest tether tension that a jump may cause", 0.1, 1e4
    )
    slack_margin: float = parameter(
        0.3, "m", "slack beyond the predicted need of a jump", 0.0, 10.0
    )
    max_slack: float = parameter(3.0, "m", "largest slack given for a jump", 0.0, 20.0)
    spring_travel: float = parameter(
        0.20, "m", "largest compression that the mechanism allows", 0.01, machine.MAX_STROKE
    )


class RoverStance(NamedTuple):
    """Pose of a standing rover and its tether."""

    x: float  # of base_link in map [m]
    y: float
    heading: float  # [rad]
    up: tuple[float, float, float]  # up direction in base_link, any length
    length: float  # paid-out tether length [m]; nan = unknown: long enough
    drop: float = 0.0  # depth of the tether attachment below the fairlead [m]; 0 = unknown

    @property
    def tilt(self) -> float:
        """Inclination of base_link z [rad]."""
        x, y, z = self.up
        return math.atan2(math.hypot(x, y), z)


class PredictionRequest(NamedTuple):
    """Request for a prediction."""

    stance: RoverStance
    height: float  # required clearance [m], reached except for `clearance_risk`
    seed: int  # of the random numbers


class Interval(NamedTuple):
    """Median and central 90 % interval."""

    median: float
    low: float
    high: float


class JumpPrediction(NamedTuple):
    """Predicted jump."""

    stroke: float  # selected stroke [m]
    slack: float  # required tether length beyond the chord [m]
    extra_slack: float  # part of it that the winch must give [m]; 0 = none
    height: Interval  # [m]
    range: Interval  # horizontal distance from release to rest [m]
    turn: Interval  # about the vertical [rad]
    peak_tension: Interval  # [N]
    upright: float  # probability of landing upright
    ratio: float  # of the heights to the nominal ones
    spread: float  # standard deviation of log height, without the spring's
    rollouts: int
    rejection: str  # why not to jump; empty = accepted


NO_INTERVAL = Interval(0.0, 0.0, 0.0)


def rejected_prediction(reason: str) -> JumpPrediction:
    """A prediction of a jump that is impossible."""
    return JumpPrediction(
        0.0,
        0.0,
        0.0,
        NO_INTERVAL,
        NO_INTERVAL,
        NO_INTERVAL,
        NO_INTERVAL,
        0.0,
        1.0,
        0.0,
        0,
        reason,
    )
