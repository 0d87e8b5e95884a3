"""What is asked of a prediction of a jump, and what it answers. Pure; knows no simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from msg_schemas.table import MAX_STROKE


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
        0.20, "m", "largest compression that the mechanism allows", 0.01, MAX_STROKE
    )


class Situation(NamedTuple):
    """The rover as it stands."""

    x: float  # of base_link in map [m]
    y: float
    heading: float  # [rad]
    up: tuple[float, float, float]  # against gravity, in base_link, any length
    length: float  # of the tether paid out [m]; nan = not known: as the rover needs it
    drop: float = 0.0  # of the tether's attachment below the fairlead [m]; 0 = not known

    @property
    def tilt(self) -> float:
        """Of base_link z [rad]."""
        x, y, z = self.up
        return math.atan2(math.hypot(x, y), z)


class Question(NamedTuple):
    """A prediction that is wanted."""

    situation: Situation
    height: float  # [m]
    is_clearance: bool  # True: to be reached but for the parameters' risk; False: in the median
    seed: int  # of what is drawn


class Band(NamedTuple):
    """Median and the interval that holds 90 %."""

    middle: float
    low: float
    high: float


class Prediction(NamedTuple):
    """What is predicted of a jump."""

    stroke: float  # to be asked of the sequence [m]
    slack: float  # that the tether is to have beyond the chord [m]
    gives_slack: float  # of that, what the winch is to give [m]; 0 = there is enough
    height: Band  # [m]
    range: Band  # horizontal way from release to rest [m]
    turn: Band  # about the vertical [rad]
    peak_tension: Band  # [N]
    upright: float  # probability of landing so
    ratio: float  # of heights to those of the spring's formula
    spread: float  # standard deviation of log height that is not the spring's
    rollouts: int
    took: float  # wall time [s]
    refused: str  # why it is better not to jump; empty = go


NO_BAND = Band(0.0, 0.0, 0.0)


def refused_prediction(reason: str, took: float = 0.0) -> Prediction:
    """A prediction that could not be made, or of a jump that cannot be."""
    return Prediction(
        0.0, 0.0, 0.0, NO_BAND, NO_BAND, NO_BAND, NO_BAND, 0.0, 1.0, 0.0, 0, took, reason
    )
