"""Flights of the hanging rover: starts, disturbances, pictures and the true motion.

Plant, winch and descent fly as the launch file ``descent`` starts them, in the scenario
``free_hang``. Only the checks use the ground truth.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent
from msg_schemas.samples import JointSample, Sample
from rover_control.hanging.descent import DescentController
from rover_control.hanging.descent_node import DescentNode
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_runtime.delays import Delays
from rover_sim import SpatialScenario, SpatialState, load_spatial
from rover_sim.interface.spatial_interface import SpatialInterface
from rover_sim.node.sim_loop import Tick
from rover_sim.physics.rover import spatial_rover
from rover_verify.checks.mission_places import machine_off
from rover_verify.harness.flight import DESCENT, Flight

_EXPOSURE = 0.1  # of the camera [s]
_KEPT = 200  # ticks for which the true state is kept
_ARMING = 0.4  # time before the winch is armed, and after it [s]


@dataclass(frozen=True)
class HangingStart:
    """How a flight starts, and what the controllers do not know of the machine.

    Attributes:
        length: of the tether [m].
        major, minor: amplitudes of the swing [deg].
        plane: of the major axis [deg].
        heading: of the rover [deg].
        tilt: of the rover against the tether, about its x and y [deg].
        mass: of the rover over what the controllers take it for.
        friction: of all drives over the same.
        swivel_friction: largest torque that the swivel passes on [N m]; None: the scenario's.
        turns: by which the tether is wound, as turns on the floor do.
        yaw_bias: of the gyro about z, in standard deviations; None: by the seed.
        seed: of the sensors' errors.
    """

    length: float
    major: float
    minor: float = 0.0
    plane: float = 0.0
    heading: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    mass: float = 1.0
    friction: float = 1.0
    swivel_friction: float | None = None
    turns: float = 0.0
    yaw_bias: float | None = None
    seed: int = 0

    def overrides(self) -> dict[str, object]:
        """Values of the scenario by dotted path."""
        frequency = HangingParameters().swing_frequency(self.length)
        # Sideways at the plane's end, without turning about the tether.
        cone = math.degrees(frequency) * self.minor / self.major if self.major > 0.0 else 0.0
        changed: dict[str, object] = {
            "tether.length": self.length,
            "start.swing_angle": self.major,
            "start.swing_heading": self.plane,
            "start.cone_rate": cone,
            "start.body_rate": [0.0, 0.0, -cone],
            "start.heading": self.heading,
            "start.tilt": [*self.tilt, 0.0],
            "start.twist": -360.0 * self.turns,
            **machine_off(_nominal(), self.mass, self.friction),
        }
        if self.swivel_friction is not None:
            changed["tether.swivel_friction"] = self.swivel_friction
        return changed


@cache
def _nominal() -> SpatialScenario:
    return load_spatial("free_hang")


def tilt_of(state: SpatialState) -> tuple[float, float]:
    """Return the true tilt against the tether's end, about base_link x and y [rad]."""
    tangent = state.nodes[-1, 1]
    up = -state.rotation.T @ (tangent / np.linalg.norm(tangent))
    return (math.atan2(float(up[1]), float(up[2])), math.atan2(-float(up[0]), float(up[2])))


class TrueSwing(NamedTuple):
    """True swing of the rover."""

    major: float  # [rad]
    minor: float
    twist: float  # heading about the plumb line [rad]


class Picture(NamedTuple):
    """A picture with its true tilt."""

    smear: float  # by the camera's report [px]
    tilt: tuple[float, float]  # RMS during the exposure [rad]


class HangingFlight(Flight):
    """A rover on the tether, with winch and descent.

    Args:
        start: how it starts.
        parameters: of descent_node, where they differ from the shipped ones.
        delays: of the messages.

    Attributes:
        pictures: those taken so far.
        spent: first time outside its budget, by rotor [s].
    """

    def __init__(
        self,
        start: HangingStart,
        parameters: Mapping[str, object] | None = None,
        delays: Delays | None = None,
    ) -> None:
        super().__init__(
            DESCENT,
            "free_hang",
            start.overrides(),
            seed=start.seed,
            parameters={"descent_node": dict(parameters or {})},
            delays=delays,
        )
        if start.yaw_bias is not None:
            interface = self.simulation.interface
            assert isinstance(interface, SpatialInterface)
            assert interface.sensors is not None
            bias = start.yaw_bias * self.plant.scenario.sensors.gyro.bias
            interface.sensors = interface.sensors.with_yaw_bias(bias)
        self.descent.controller.turn.add(math.tau * start.turns, start.length)
        self.pictures: list[Picture] = []
        self.spent: dict[str, float] = {}
        self._states: deque[tuple[float, SpatialState]] = deque(maxlen=_KEPT)
        self.sim.observers.append(self._watch)
        self.host.exchange.listen(self._on_observation, topics.DESCENT_OBSERVATION)

    # --- requests --------------------------------------------------------------------------------

    def begin(self) -> None:
        """Run until the sensors are received, and arm the winch."""
        self.run(_ARMING)
        response = self.call(topics.WINCH_REARM)
        assert response.success, response.message
        self.run(_ARMING)

    def stop_at(self, depth: float, *, observes: bool = True) -> None:
        """Request a stop at a depth [m]."""
        joint = machine.OBSERVATION_STOP if observes else machine.PLAIN_STOP
        self.request(topics.DESCENT_REQUEST, joint, depth)

    def turn(self, angle: float) -> None:
        """Request a turn about the plumb line by an angle [rad]."""
        self.request(topics.DESCENT_REQUEST, machine.HEADING_TURN, angle)

    def run_until_idle(self, limit: float) -> bool:
        """Run until no stop is left, for a time [s] at most; whether none is left."""
        self.run(0.5)  # the requests arrive
        return self.run(limit, lambda: self.descent.controller.profile.is_idle)

    def disturb(self, angle: float, heading: float) -> None:
        """Disturb the rover: add the velocity of a swing amplitude [rad].

        Tether and rover turn about the fairlead as one.
        """
        state = self.state
        frequency = HangingParameters().swing_frequency(state.length)
        outward = np.array([math.cos(heading), math.sin(heading), 0.0])
        spin = angle * frequency * np.cross([0.0, 0.0, -1.0], outward)
        rover = self.plant.scenario.rover
        assert rover is not None
        body = state.body.copy()
        for at, place in (
            (spatial_rover.VELOCITY1, state.G1),
            (spatial_rover.VELOCITY2, state.centre2(rover)),
        ):
            body[at : at + 3] += np.cross(spin, place)
        body[spatial_rover.SPIN : spatial_rover.SPIN + 3] += state.rotation.T @ spin
        fairlead_slope = state.fairlead_slope.copy()
        fairlead_slope[1] += np.cross(spin, fairlead_slope[0])
        self.simulation.state = state.replaced(
            node_rates=state.node_rates + np.cross(spin, state.nodes),
            fairlead_slope=fairlead_slope,
            body=body,
        )

    def spin(self, change: tuple[float, float, float]) -> None:
        """Change the rover's angular velocity [rad/s], in base_link."""
        body = self.state.body.copy()
        body[spatial_rover.SPIN : spatial_rover.SPIN + 3] += change
        self.simulation.state = self.state.replaced(body=body)

    # --- what the controllers know ---------------------------------------------------------------

    @property
    def descent(self) -> DescentController:
        """Controllers of the descent."""
        node = self.host["descent_node"]
        assert isinstance(node, DescentNode)
        return node.descent

    @property
    def swing(self) -> SwingEstimate:
        """Estimate of the swing."""
        swing = self.descent.controller.swing
        assert swing is not None, "no sample was received"
        return swing

    @property
    def ended_stops(self) -> list[Mapping[str, str]]:
        """Values of the events of the ended stops."""
        return [
            each.values
            for each in self.events
            if each.name in (DescentEvent.STOP_COMPLETED, DescentEvent.STOP_FAILED)
        ]

    # --- ground truth ----------------------------------------------------------------------------

    def _watch(self, _tick: Tick[Any]) -> None:
        state = self.state
        self._states.append((self.time, state))
        rotors = self.descent.controller.parameters.rotors
        jump = self.plant.model.jump
        travel = abs(state.nut + 0.5 * jump.free_travel) / jump.pitch
        over = {
            "wheels about y": max(map(abs, state.wheel_rates))
            > (1.0 + rotors.wheel_rate_fraction) * abs(rotors.wheel_pump_bias),
            "flywheel about x": abs(state.flywheel_rate) > rotors.flywheel_rate
            or travel > rotors.screw_travel,
        }
        for name, is_over in over.items():
            if is_over:
                self.spent.setdefault(name, self.time)

    def _on_observation(self, _name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, JointSample)
        began = sample.stamp_ns * 1e-9
        tilts = [tilt_of(each) for time, each in self._states if 0.0 <= time - began <= _EXPOSURE]
        x, y = np.sqrt(np.mean(np.square(tilts), axis=0))
        reported = sample.joints.get(machine.SMEAR)
        smear = math.inf if reported is None else reported.position
        self.pictures.append(Picture(smear, (float(x), float(y))))

    def true_momentum(self) -> tuple[float, float]:
        """Momenta about the plumb line [N m s]: of the swing, and of the spin with the rotors."""
        rover = self.plant.scenario.rover
        assert rover is not None
        state = self.state
        swing = sum(
            mass * float(place[0] * rate[1] - place[1] * rate[0])
            for mass, place, rate in (
                (rover.m1, state.G1, state.G1_rate),
                (rover.m2, state.centre2(rover), state.G2_rate),
            )
        )
        inertia = np.add(rover.inertia1, rover.inertia2)
        flywheel, wheels = state.body[spatial_rover.ROTORS : spatial_rover.ROTORS + 2]
        spin = state.rotation @ (inertia * state.omega + np.array([flywheel, wheels, 0.0]))
        return swing, float(spin[2])

    def true_swing(self) -> TrueSwing:
        """Ellipse of the centre of mass about the plumb line."""
        rover = self.plant.scenario.rover
        assert rover is not None
        state = self.state
        share = rover.m2 / rover.mass
        place: NDArray[np.float64] = (1.0 - share) * state.G1 + share * state.centre2(rover)
        rate = (1.0 - share) * state.G1_rate + share * state.G2_rate
        reach = -float(place[2])
        frequency = math.sqrt(self.plant.scenario.gravity / reach)
        z = complex(place[0], place[1]) / reach
        turned = complex(rate[0], rate[1]) / (1j * frequency * reach)
        ahead, back = abs(0.5 * (z + turned)), abs(0.5 * (z - turned))
        x, y = state.rotation[:2, 0]
        return TrueSwing(ahead + back, ahead - back, math.atan2(y, x))
