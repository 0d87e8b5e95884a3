"""Rovers on the floor below the fairlead."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.samples import PoseEstimateSample
from rover_control.prediction.jump_spring import SpringParameters
from rover_launch.loop import Parameters
from rover_runtime.delays import Delays
from rover_sim import SpatialState
from rover_verify.harness.flight import Flight

_FLOOR = 5.0  # depth below the fairlead [m]
_ATTACHMENT = 0.43  # height of the tether attachment above the floor [m]
_NOMINAL = SpringParameters()


@dataclass(frozen=True)
class Stand:
    """Place of a rover on a smooth floor."""

    x: float = 2.0  # of base_link, from the plumb line [m]
    y: float = 0.0  # [m]
    heading: float = 0.0  # [rad]
    slope: float = 0.0  # of the floor [rad]
    downhill: float = 0.0  # downhill direction, from x towards y [rad]
    slack: float = 0.8  # tether length beyond the chord [m]
    spring: float = 1.0  # true spring rate over the nominal one

    def overrides(self) -> dict[str, object]:
        """Overrides of the scenario."""
        along = self.x * math.cos(self.downhill) + self.y * math.sin(self.downhill)
        depth = _FLOOR + math.tan(self.slope) * along
        chord = math.hypot(self.x, self.y, depth - _ATTACHMENT)
        return {
            "environment.relief": None,
            "environment.boulders": None,
            "environment.floor": {
                "height": -_FLOOR,
                "slope": round(math.degrees(self.slope), 6),
                "downhill": round(math.degrees(self.downhill), 6),
            },
            "rover.slider.spring_rate": round(_NOMINAL.spring_rate * self.spring, 3),
            "start.position": [self.x, self.y],
            "start.heading": round(math.degrees(self.heading), 6),
            "start.settling_time": 300.0,
            "tether.length": round(chord + self.slack, 3),
        }


def start_on_floor(
    controllers: Sequence[str],
    overrides: Mapping[str, object],
    number: int,
    parameters: Parameters | None = None,
) -> Flight:
    """Start a flight on the floor: the winch is armed, ``drive_node`` has been given the pose.

    Args:
        controllers: executables, ``drive_node`` among them.
        overrides: of the scenario.
        number: of the flight; seed of the sensors' errors and of the messages' delays.
        parameters: of the nodes, where they differ from the shipped ones.

    Raises:
        SettlingError: the rover does not settle there.
    """
    flight = Flight(
        controllers, "floor_rubble", overrides, seed=number, parameters=parameters,
        delays=Delays(number),
    )  # fmt: skip
    flight.run(0.5)
    flight.call(topics.WINCH_REARM)
    x, y, heading = true_pose(flight.state)
    turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
    flight.host.request(topics.DRIVE_START, PoseEstimateSample(flight.now_ns, (x, y, 0.0), turned))
    flight.run(0.5)
    return flight


def true_pose(state: SpatialState) -> tuple[float, float, float]:
    """Return the true place [m] and heading [rad] of base_link."""
    x, y = state.rotation[:2, 0]
    return float(state.G1[0]), float(state.G1[1]), math.atan2(y, x)
