"""Interface of the spatial plant: its drives, sensors, and states as samples of the contract.

Samples are in SI units and REP-103 axes, which are the plant's; twists are in the body frame. The
sensors measure at every tick, so that their errors do not depend on the subscriptions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.samples import (
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    OdometrySample,
    Sample,
    Shape,
    WrenchSample,
)
from msg_schemas.table import TOPICS
from rover_sim.devices.actuators import DriveFeedback
from rover_sim.devices.equipment import Equipment, spatial_equipment
from rover_sim.devices.sensors import Readings, SensorState, SensorSuite, Truth
from rover_sim.interface.drawing import (
    as_quaternion,
    as_vector,
    contact_force,
    ground,
    nominal_tension,
    rover_solids,
    tether_line,
)
from rover_sim.interface.truth_samples import energy_sample, state_sample, tether_sample
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.rover.body_motion import BodyMotion
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.plant import Energies, Forces, StepResult
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.plants.spatial_state import SpatialState
from rover_sim.scenarios.hardware import RoverSettings


class SpatialInterface:
    """Drives, sensors and topics of the spatial plant.

    Args:
        plant: whose states are published.
        seed: of the sensors' errors.

    Attributes:
        sensors: state of the sensors; None before a restart.
    """

    def __init__(self, plant: SpatialPlant, seed: int) -> None:
        self.plant = plant
        scenario = plant.scenario
        self._scenario = scenario
        self._suite = SensorSuite(
            scenario.sensors,
            scenario.gravity,
            pitch=plant.model.jump.pitch,
            terrain=plant.model.terrain if plant.model.has_ground else None,
            seed=seed,
        )
        self.sensors: SensorState | None = None
        self._readings: Readings | None = None
        self._snapshot: _SpatialSnapshot | None = None
        self._truth_makers: dict[str, Callable[[_SpatialSnapshot], Sample]] = {
            topics.CLOCK: lambda snapshot: ClockSample(snapshot.stamp_ns),
            topics.TRUTH_TETHER: self._tether,
            topics.TRUTH_ENERGY: self._energy,
            topics.TRUTH_STATE: lambda snapshot: state_sample(snapshot.stamp_ns, snapshot.state),
            topics.MARKERS: self._markers,
        }
        self._sensor_makers: dict[str, Callable[[int, Readings], Sample]] = {
            topics.LOAD_CELL: _load_cell,
            topics.WINCH_STATE: self._winch,
            topics.MOTOR_CURRENTS: _currents,
        }
        if scenario.rover is not None:
            self._truth_makers |= {
                topics.TRUTH_BODY1: self._body1,
                topics.TRUTH_BODY2: self._body2,
            }
            self._sensor_makers |= {
                topics.IMU: _imu,
                topics.CONTACT: _contact,
                topics.ROVER_LOAD_CELL: _rover_load_cell,
                topics.CAMERA: _camera,
                topics.JUMP_MOTOR_STATE: self._jump_motor,
                topics.FLYWHEEL_STATE: _flywheel,
                topics.WHEEL_STATE: _wheels,
            }

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the plant; without a rover, none of the rover."""
        return (*self._truth_makers, *self._sensor_makers)

    @property
    def available_after_tick(self) -> frozenset[str]:
        """Topics of the sensors."""
        return frozenset(self._sensor_makers)

    @property
    def equipment(self) -> Equipment:
        """The drives of the scenario's rover and winch."""
        return spatial_equipment(self._scenario)

    def drive_feedback(self, state: SpatialState) -> DriveFeedback:
        """Return the state of the drives."""
        return DriveFeedback(
            state.phase,
            state.nut,
            state.latch is Latch.FREE,
            state.latch in (Latch.ENGAGED, Latch.COMPRESSING),
            self._length(state),
            self.plant.payout_rate(state),
            state.braked,
            state.flywheel_rate * self.plant.model.jump.pitch,
            state.flywheel_rate,
            state.wheel_rates[0],
        )

    def _length(self, state: SpatialState) -> float:
        return self._scenario.tether.length if self._scenario.winch is None else state.length

    # --- states ----------------------------------------------------------------------------------

    def restart(self, state: SpatialState, stamp_ns: int) -> None:
        """Set a state without a preceding tick, and restart the sensors."""
        # Forces are known only after a step.
        forces = Forces()
        self.sensors = self._suite.start(self._truth(state, forces))
        self._readings = None
        self._snapshot = _SpatialSnapshot(state, stamp_ns, self.plant.energies(state), forces)

    def measure(self, state: SpatialState, stamp_ns: int, result: StepResult) -> None:
        """Set the state at the end of a tick; see `plant_interface.PlantInterface.measure`."""
        if self.sensors is None:
            raise AssertionError("the sensors were not started")
        # After the plant has stopped, the sensors keep their last readings.
        if state.time > self.sensors.truth.time:
            truth = self._truth(state, result.forces)
            self.sensors, self._readings = self._suite.step(self.sensors, truth)
        self._snapshot = _SpatialSnapshot(state, stamp_ns, result.energies, result.forces)

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of the last state for the topics that are due."""
        snapshot = self._snapshot
        if snapshot is None:
            raise AssertionError("no state was set yet")
        for name in due:
            if name in self._truth_makers:
                yield name, self._truth_makers[name](snapshot)
            elif self._readings is not None:
                yield name, self._sensor_makers[name](snapshot.stamp_ns, self._readings)

    def _truth(self, state: SpatialState, forces: Forces) -> Truth:
        """Return the true values of all measured quantities."""
        make_truth = partial(
            Truth,
            time=state.time,
            length=self._length(state),
            payout_rate=self.plant.payout_rate(state),
            brake_closed=state.braked,
            currents=(forces.jump_current, forces.wheel_current, forces.winch_current),
            fairlead_tension=forces.fairlead_tension,
        )
        if self._scenario.rover is None:
            return make_truth()
        x, y, z, w = state.orientation.tolist()
        return make_truth(
            body=BodyMotion(
                as_vector(state.G1), (w, x, y, z), as_vector(state.G1_rate), as_vector(state.omega)
            ),
            nut=state.nut,
            flywheel_angle=state.nut / self.plant.model.jump.pitch,
            flywheel_rate=state.flywheel_rate,
            wheel_angles=state.wheel_angles,
            wheel_rates=state.wheel_rates,
            rover_tension=forces.rover_tension,
            wheel_loads=(forces.left_wheel, forces.right_wheel),
            body_load=forces.body,
        )

    # --- truth -----------------------------------------------------------------------------------

    def _body1(self, snapshot: _SpatialSnapshot) -> Sample:
        return _odometry(snapshot, snapshot.state.G1, snapshot.state.G1_rate)

    def _body2(self, snapshot: _SpatialSnapshot) -> Sample:
        centre = snapshot.state.centre2(self._rover)
        return _odometry(snapshot, centre, snapshot.state.G2_rate)

    def _tether(self, snapshot: _SpatialSnapshot) -> Sample:
        nodes = self.plant.to_full_nodes(snapshot.state)
        return tether_sample(snapshot.stamp_ns, nodes, self.plant.tension(snapshot.state))

    def _energy(self, snapshot: _SpatialSnapshot) -> Sample:
        return energy_sample(snapshot.stamp_ns, snapshot.energies)

    def _markers(self, snapshot: _SpatialSnapshot) -> Sample:
        state, rover = snapshot.state, self._scenario.rover
        scenario = self._scenario
        density = scenario.tether.section.line_density
        nominal = nominal_tension(scenario.tip_mass, density, self._length(state), scenario.gravity)
        shapes = [
            tether_line(
                self.plant.to_full_nodes(state),
                self.plant.to_arc_lengths(state),
                self.plant.tension(state),
                nominal,
            )
        ]
        if rover is not None:
            centre2 = state.centre2(rover)
            shapes += rover_solids(rover, state.G1, centre2, state.rotation, state.orientation)
            shapes += self._contact_forces(snapshot, rover)
        return DrawingSample(snapshot.stamp_ns, tuple(shapes))

    def _contact_forces(self, snapshot: _SpatialSnapshot, rover: RoverSettings) -> list[Shape]:
        """Draw the ground's normal forces on wheels and bodies, along the floor's normal."""
        terrain, forces = self.plant.model.terrain, snapshot.forces
        normal = terrain.floor_cosine * np.array([-terrain.slope_x, -terrain.slope_y, 1.0])
        below = rover.wheels.radius * normal
        turned, state = snapshot.state.rotation, snapshot.state
        loads = (
            (
                machine.WHEEL_LEFT,
                forces.left_wheel,
                state.G1 + turned @ np.array(rover.wheels.left) - below,
            ),
            (
                machine.WHEEL_RIGHT,
                forces.right_wheel,
                state.G1 + turned @ np.array(rover.wheels.right) - below,
            ),
            (machine.BODY_SWITCH, forces.body, state.G1),
        )
        return [
            contact_force(f"force_{name}", place, load * normal)
            for name, load, place in loads
            if load > 0.0
        ]

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        """Return the drawing of the ground, if there is one."""
        model = self.plant.model
        return DrawingSample(stamp_ns, ground(model.terrain) if model.has_ground else ())

    # --- samples that combine readings and the drives' state -------------------------------------

    def _jump_motor(self, stamp_ns: int, readings: Readings) -> Sample:
        rover = self._rover
        held = 0.0
        if self._snapshot is not None and self._snapshot.state.latch in (
            Latch.ENGAGED,
            Latch.COMPRESSING,
        ):
            held = rover.slider.spring_rate * max(readings.nut, 0.0)
        value = JointValue(readings.nut, readings.nut_rate, held)
        return TOPICS[topics.JUMP_MOTOR_STATE].saturated(stamp_ns, {machine.JUMP_SCREW: value})

    @property
    def _rover(self) -> RoverSettings:
        if self._scenario.rover is None:
            raise AssertionError("a plant without a rover publishes nothing of one")
        return self._scenario.rover

    def _winch(self, stamp_ns: int, readings: Readings) -> Sample:
        drum = self.plant.model.drum
        tension = 0.0
        if self._scenario.winch is not None and self._snapshot is not None:
            torque = readings.currents[2] * drum.motor.torque_constant * drum.gear_ratio
            # A positive torque pays out; the tension acts against it.
            tension = -torque / self.plant.drum_radius(self._snapshot.state)
        joints = {
            machine.WINCH_DRUM: JointValue(readings.length, readings.payout_rate, tension),
            machine.WINCH_BRAKE: JointValue(0.0 if readings.brake_closed else 1.0),
        }
        return TOPICS[topics.WINCH_STATE].saturated(stamp_ns, joints)


class _SpatialSnapshot(NamedTuple):
    """State and forces at the end of a tick."""

    state: SpatialState
    stamp_ns: int
    energies: Energies
    forces: Forces


def _odometry(snapshot: _SpatialSnapshot, centre: Array, rate: Array) -> OdometrySample:
    state = snapshot.state
    return OdometrySample(
        snapshot.stamp_ns,
        as_vector(centre),
        as_quaternion(state.orientation),
        as_vector(state.rotation.T @ rate),
        as_vector(state.omega),
    )


def _imu(stamp_ns: int, readings: Readings) -> Sample:
    return ImuSample(stamp_ns, readings.gyro, readings.specific_force)


def _contact(stamp_ns: int, readings: Readings) -> Sample:
    left, right = readings.wheel_contacts
    switches = {
        machine.FLOOR_SWITCH: readings.on_ground,
        machine.WHEEL_LEFT: left,
        machine.WHEEL_RIGHT: right,
        machine.BODY_SWITCH: readings.body_contact,
    }
    return JointSample(stamp_ns, {name: JointValue(float(on)) for name, on in switches.items()})


def _load_cell(stamp_ns: int, readings: Readings) -> Sample:
    return WrenchSample(stamp_ns, (0.0, 0.0, -readings.fairlead_tension))


def _rover_load_cell(stamp_ns: int, readings: Readings) -> Sample:
    return WrenchSample(stamp_ns, (0.0, 0.0, readings.rover_tension))


def _currents(stamp_ns: int, readings: Readings) -> Sample:
    names = (machine.JUMP_MOTOR, machine.WHEEL_MOTOR, machine.WINCH_MOTOR)
    joints = {
        name: JointValue(effort=current)
        for name, current in zip(names, readings.currents, strict=True)
    }
    return JointSample(stamp_ns, joints)


def _camera(stamp_ns: int, readings: Readings) -> Sample:
    joints = {
        machine.WALL_DISTANCE: JointValue(readings.wall_distance),
        machine.SMEAR: JointValue(readings.smear),
    }
    return TOPICS[topics.CAMERA].saturated(stamp_ns, joints)


def _flywheel(stamp_ns: int, readings: Readings) -> Sample:
    value = JointValue(readings.flywheel_angle, readings.flywheel_rate)
    return JointSample(stamp_ns, {machine.FLYWHEEL: value})


def _wheels(stamp_ns: int, readings: Readings) -> Sample:
    values = zip(readings.wheel_angles, readings.wheel_rates, strict=True)
    joints = {
        name: JointValue(angle, rate)
        for name, (angle, rate) in zip(
            (machine.WHEEL_LEFT, machine.WHEEL_RIGHT), values, strict=True
        )
    }
    return JointSample(stamp_ns, joints)
