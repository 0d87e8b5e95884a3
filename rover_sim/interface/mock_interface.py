"""Interface of the mock plant: all topics of the spatial plant, without sensor errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from msg_schemas import machine, topics
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import (
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    OdometrySample,
    Sample,
    WrenchSample,
)
from msg_schemas.table import TOPICS
from rover_sim.devices.actuators import DriveFeedback
from rover_sim.devices.equipment import Equipment, spatial_equipment
from rover_sim.interface.drawing import (
    as_quaternion,
    as_vector,
    bare_floor,
    nominal_tension,
    rover_solids,
    tether_line,
)
from rover_sim.interface.truth_samples import energy_sample, state_sample, tether_sample
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.mock_plant import MockPlant, MockState
from rover_sim.plants.plant import StepResult


class MockInterface:
    """Drives and topics of the mock plant.

    Args:
        plant: whose states are published.
    """

    available_after_tick: frozenset[str] = frozenset()

    def __init__(self, plant: MockPlant) -> None:
        self.plant = plant
        self._scenario, self._rover = plant.scenario, plant.rover
        self._last: tuple[MockState, int] | None = None
        self._makers: Mapping[str, Callable[[MockState, int], Sample]] = {
            topics.CLOCK: lambda _state, stamp_ns: ClockSample(stamp_ns),
            topics.TRUTH_BODY1: self._odometry,
            topics.TRUTH_BODY2: self._body2,
            topics.TRUTH_TETHER: self._tether,
            topics.TRUTH_ENERGY: self._energy,
            topics.TRUTH_STATE: lambda state, stamp_ns: state_sample(stamp_ns, state),
            topics.MARKERS: self._markers,
            topics.IMU: self._imu,
            topics.CONTACT: self._contact,
            topics.LOAD_CELL: self._load_cell,
            topics.ROVER_LOAD_CELL: self._rover_load_cell,
            topics.MOTOR_CURRENTS: self._currents,
            topics.CAMERA: self._camera,
            topics.JUMP_MOTOR_STATE: self._jump_motor,
            topics.FLYWHEEL_STATE: self._flywheel,
            topics.WHEEL_STATE: self._wheels,
            topics.WINCH_STATE: self._winch,
        }

    @property
    def topics(self) -> tuple[str, ...]:
        """All topics of the spatial plant."""
        return tuple(self._makers)

    @property
    def equipment(self) -> Equipment:
        """All drives; the drum's if the scenario has a winch."""
        return spatial_equipment(self._scenario)

    def drive_feedback(self, state: MockState) -> DriveFeedback:
        """Return the state of the drives."""
        held = state.nut > 0.0
        return DriveFeedback(
            state.phase,
            state.nut,
            not held,
            held,
            state.length,
            state.payout_rate,
            not state.brake_released,
            state.nut_rate,
            state.nut_rate / self.plant.pitch,
            state.wheel_rates[0],
        )

    def restart(self, state: MockState, stamp_ns: int) -> None:
        """Set a state without a preceding tick."""
        self._last = (state, stamp_ns)

    def measure(self, state: MockState, stamp_ns: int, result: StepResult) -> None:  # noqa: ARG002
        """Set the state at the end of a tick; see `plant_interface.PlantInterface.measure`."""
        self._last = (state, stamp_ns)

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of the last state for the topics that are due."""
        if self._last is None:
            raise AssertionError("no state was set yet")
        state, stamp_ns = self._last
        for name in due:
            yield name, self._makers[name](state, stamp_ns)

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        """Return the drawing of the level floor, if there is one."""
        height = self._scenario.environment.floor_height
        shapes = (bare_floor(height),) if math.isfinite(height) else ()
        return DrawingSample(stamp_ns, shapes)

    # --- truth -----------------------------------------------------------------------------------

    def _centre(self, state: MockState, point: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Return a point of the rover, given in base_link [m], in map."""
        lever = np.array(self._rover.attachment) - np.asarray(point)
        turned = _rotation(state.heading) @ lever
        attachment = np.array([state.x, state.y, -self.plant.drop(state)])
        return np.asarray(attachment - turned)

    def _odometry(
        self, state: MockState, stamp_ns: int, point: ArrayLike = (0.0, 0.0, 0.0)
    ) -> OdometrySample:
        return OdometrySample(
            stamp_ns,
            as_vector(self._centre(state, point)),
            as_quaternion(_quaternion(state.heading)),
            self.plant.velocity(state),
            (0.0, 0.0, state.yaw_rate),
        )

    def _body2(self, state: MockState, stamp_ns: int) -> Sample:
        centre = self._rover.body2_place(self.plant.slide(state))
        sample = self._odometry(state, stamp_ns, centre)
        vx, vy, vz = sample.linear
        x, y = self._rover.slider_offset
        slide_rate = -state.nut_rate if state.nut > 0.0 else 0.0
        linear = (vx - state.yaw_rate * y, vy + state.yaw_rate * x, vz + slide_rate)
        return OdometrySample(stamp_ns, sample.position, sample.orientation, linear, sample.angular)

    def _nodes(self, state: MockState) -> tuple[Array, Array, Array]:
        """Return nodes with slopes (n + 1, 2, 3), arc lengths and tensions (n + 1,)."""
        nominal = self._scenario.tether.nominal_length
        count = max(1, math.ceil(state.length / nominal - 1e-9))
        arcs = np.linspace(0.0, state.length, count + 1)
        end = np.array([state.x, state.y, -self.plant.drop(state)])
        slope = end / state.length
        nodes = np.stack([np.outer(arcs, slope), np.tile(slope, (count + 1, 1))], axis=1)
        return nodes, arcs, np.linspace(*self.plant.tension(state), count + 1)

    def _tether(self, state: MockState, stamp_ns: int) -> Sample:
        nodes, _, tension = self._nodes(state)
        return tether_sample(stamp_ns, nodes, tension)

    def _energy(self, state: MockState, stamp_ns: int) -> Sample:
        return energy_sample(stamp_ns, self.plant.energies(state))

    def _markers(self, state: MockState, stamp_ns: int) -> Sample:
        scenario = self._scenario
        nominal = nominal_tension(
            scenario.tip_mass,
            scenario.tether.section.line_density,
            state.length,
            scenario.gravity,
        )
        solids = rover_solids(
            self._rover,
            self._centre(state),
            self._centre(state, self._rover.body2_place(self.plant.slide(state))),
            _rotation(state.heading),
            _quaternion(state.heading),
        )
        return DrawingSample(stamp_ns, (tether_line(*self._nodes(state), nominal), *solids))

    # --- sensors ---------------------------------------------------------------------------------

    def _imu(self, state: MockState, stamp_ns: int) -> Sample:
        weight = 0.0 if state.phase is PlantPhase.FLIGHT else self._scenario.gravity
        force = (state.acceleration, 0.0, weight)
        return ImuSample(stamp_ns, (0.0, 0.0, state.yaw_rate), force)

    def _contact(self, state: MockState, stamp_ns: int) -> Sample:
        on_ground = JointValue(float(state.phase is PlantPhase.GROUNDED))
        joints = dict.fromkeys(
            (machine.FLOOR_SWITCH, machine.WHEEL_LEFT, machine.WHEEL_RIGHT), on_ground
        )
        return JointSample(stamp_ns, {**joints, machine.BODY_SWITCH: JointValue()})

    def _load_cell(self, state: MockState, stamp_ns: int) -> Sample:
        return WrenchSample(stamp_ns, (0.0, 0.0, -self.plant.tension(state)[0]))

    def _rover_load_cell(self, state: MockState, stamp_ns: int) -> Sample:
        return WrenchSample(stamp_ns, (0.0, 0.0, self.plant.tension(state)[1]))

    def _motor_tension(self, state: MockState) -> float:
        """Return the tension that the winch's motor carries [N]; 0 while the brake is closed."""
        return self.plant.tension(state)[0] if state.brake_released else 0.0

    def _currents(self, state: MockState, stamp_ns: int) -> Sample:
        joints = dict.fromkeys(
            (machine.JUMP_MOTOR, machine.WHEEL_MOTOR, machine.WINCH_MOTOR), JointValue()
        )
        winch = self._scenario.winch
        if winch is not None:
            # A positive torque pays out; the tension acts against it.
            torque = -self._motor_tension(state) * winch.radius / winch.gear_ratio
            joints[machine.WINCH_MOTOR] = JointValue(effort=torque / winch.motor.torque_constant)
        return JointSample(stamp_ns, joints)

    def _camera(self, state: MockState, stamp_ns: int) -> Sample:  # noqa: ARG002
        hole = self._scenario.environment.hole
        distance = machine.NO_WALL if hole is None else hole.wall_distance
        return JointSample(
            stamp_ns, {machine.WALL_DISTANCE: JointValue(distance), machine.SMEAR: JointValue()}
        )

    def _jump_motor(self, state: MockState, stamp_ns: int) -> Sample:
        force = self._rover.slider.spring_rate * max(state.nut, 0.0)
        value = JointValue(state.nut, state.nut_rate, force)
        return TOPICS[topics.JUMP_MOTOR_STATE].saturated(stamp_ns, {machine.JUMP_SCREW: value})

    def _flywheel(self, state: MockState, stamp_ns: int) -> Sample:
        value = JointValue(state.nut / self.plant.pitch, state.nut_rate / self.plant.pitch)
        return JointSample(stamp_ns, {machine.FLYWHEEL: value})

    def _wheels(self, state: MockState, stamp_ns: int) -> Sample:
        values = zip(state.wheel_angles, state.wheel_rates, strict=True)
        joints = zip((machine.WHEEL_LEFT, machine.WHEEL_RIGHT), values, strict=True)
        return JointSample(stamp_ns, {name: JointValue(*value) for name, value in joints})

    def _winch(self, state: MockState, stamp_ns: int) -> Sample:
        drum = JointValue(state.length, state.payout_rate, self._motor_tension(state))
        brake = JointValue(float(state.brake_released))
        return JointSample(stamp_ns, {machine.WINCH_DRUM: drum, machine.WINCH_BRAKE: brake})


def _rotation(heading: float) -> Array:
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _quaternion(heading: float) -> Array:
    return np.array([0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading)])
