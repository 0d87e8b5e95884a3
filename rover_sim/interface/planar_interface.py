"""Interface of the planar plant: its drives, and its states as samples of the contract.

Samples are in SI units and REP-103 axes; twists are in the body frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

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
    Vector,
    WrenchSample,
)
from rover_sim.devices.actuators import DriveFeedback
from rover_sim.devices.equipment import Equipment, Nut
from rover_sim.interface.drawing import (
    BODY1_COLOUR,
    BODY2_COLOUR,
    as_quaternion,
    as_vector,
    nominal_tension,
    solid,
    tether_line,
)
from rover_sim.interface.truth_samples import energy_sample, state_sample, tether_sample
from rover_sim.physics.rover import rep103
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.planar_plant import PlanarPlant, PlanarState
from rover_sim.plants.plant import Energies, StepResult

_NANO = 1e9


class PlanarInterface:
    """Drives and topics of the planar plant.

    Args:
        plant: whose states are published.
    """

    available_after_tick = frozenset({topics.IMU})

    def __init__(self, plant: PlanarPlant) -> None:
        self.plant = plant
        self._scenario = plant.scenario
        self._snapshot: _PlanarSnapshot | None = None
        self._makers: dict[str, Callable[[_PlanarSnapshot], Sample]] = {
            topics.CLOCK: lambda snapshot: ClockSample(snapshot.stamp_ns),
            topics.TRUTH_TETHER: self._tether,
            topics.TRUTH_ENERGY: self._energy,
            topics.TRUTH_STATE: lambda snapshot: state_sample(snapshot.stamp_ns, snapshot.after),
            topics.LOAD_CELL: self._load_cell,
            topics.WINCH_STATE: self._winch,
            topics.MARKERS: self._markers,
        }
        if plant.scenario.rover is not None:
            self._makers |= {
                topics.TRUTH_BODY1: self._body1,
                topics.TRUTH_BODY2: self._body2,
                topics.IMU: self._imu,
                topics.CONTACT: self._contact,
                topics.ROVER_LOAD_CELL: self._rover_load_cell,
                topics.JUMP_MOTOR_STATE: self._jump_motor,
            }

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the plant; without a rover, none of the rover."""
        return tuple(self._makers)

    @property
    def equipment(self) -> Equipment:
        """A jump motor if there is a rover; the drum has no motor."""
        rover = self._scenario.rover
        nut = None if rover is None else Nut(rover.spring_rate, holds=True, needs_ground=True)
        return Equipment(self._scenario.name, nut=nut, fixed_length=self._scenario.tether.length)

    def drive_feedback(self, state: PlanarState) -> DriveFeedback:
        """Return the state of the jump motor."""
        held = state.compression > 0.0
        return DriveFeedback(
            state.phase, state.compression, not held, held, self._scenario.tether.length
        )

    def restart(self, state: PlanarState, stamp_ns: int) -> None:
        """Set a state without a preceding tick."""
        self._snapshot = _PlanarSnapshot(
            self.plant, state, state, 0.0, stamp_ns, self.plant.energies(state)
        )

    def measure(self, state: PlanarState, stamp_ns: int, result: StepResult) -> None:
        """Set the state at the end of a tick; see `plant_interface.PlantInterface.measure`."""
        last = self._snapshot
        if last is None:
            raise AssertionError("a tick without a preceding state")
        dt = (stamp_ns - last.stamp_ns) / _NANO
        self._snapshot = _PlanarSnapshot(
            self.plant, last.after, state, dt, stamp_ns, result.energies
        )

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        """Yield (topic, sample) of the last state for the topics that are due."""
        snapshot = self._snapshot
        if snapshot is None:
            raise AssertionError("no state was set yet")
        for name in due:
            yield name, self._makers[name](snapshot)

    def _body1(self, snapshot: _PlanarSnapshot) -> Sample:
        state = snapshot.after
        return _odometry(snapshot.stamp_ns, state, state.G1, state.G1_rate)

    def _body2(self, snapshot: _PlanarSnapshot) -> Sample:
        state = snapshot.after
        return _odometry(snapshot.stamp_ns, state, state.G2, state.G2_rate)

    def _tether(self, snapshot: _PlanarSnapshot) -> Sample:
        return tether_sample(
            snapshot.stamp_ns, rep103.vector(snapshot.after.nodes), snapshot.tension
        )

    def _energy(self, snapshot: _PlanarSnapshot) -> Sample:
        return energy_sample(snapshot.stamp_ns, snapshot.energies)

    def _imu(self, snapshot: _PlanarSnapshot) -> Sample:
        before, after = snapshot.before, snapshot.after
        acceleration = np.zeros(2)
        if snapshot.dt > 0.0:
            acceleration = (after.G1_rate - before.G1_rate) / snapshot.dt
        force = acceleration + np.array([0.0, self._scenario.gravity])
        # Body 1 rotates during the tick: resolve the mean force in its mean attitude.
        theta = 0.5 * (before.theta + after.theta)
        return ImuSample(
            snapshot.stamp_ns,
            as_vector(rep103.rotation_rate(after.omega)),
            as_vector(rep103.vector(_in_body(theta, force))),
        )

    def _contact(self, snapshot: _PlanarSnapshot) -> Sample:
        on_ground = snapshot.after.phase in (PlantPhase.HELD, PlantPhase.LANDED)
        return JointSample(
            snapshot.stamp_ns, {machine.FLOOR_SWITCH: JointValue(1.0 if on_ground else 0.0)}
        )

    def _load_cell(self, snapshot: _PlanarSnapshot) -> Sample:
        return WrenchSample(snapshot.stamp_ns, snapshot.pull)

    def _rover_load_cell(self, snapshot: _PlanarSnapshot) -> Sample:
        slope = -snapshot.after.nodes[-1, 1]
        force = float(snapshot.tension[-1]) / float(np.hypot(*slope)) * slope
        in_body = rep103.vector(_in_body(snapshot.after.theta, force))
        return WrenchSample(snapshot.stamp_ns, as_vector(in_body))

    def _jump_motor(self, snapshot: _PlanarSnapshot) -> Sample:
        rover = self._scenario.rover
        if rover is None:
            raise AssertionError("a plant without a rover has no jump motor")
        before, after = snapshot.before, snapshot.after
        released = after.compression == 0.0 and after.phase is PlantPhase.FLIGHT
        rate = 0.0
        if snapshot.dt > 0.0 and not released:
            rate = (after.compression - before.compression) / snapshot.dt
            rate = min(
                max(rate, -machine.MAX_NUT_SPEED), machine.MAX_NUT_SPEED
            )  # rounding may exceed it
        force = rover.spring_rate * after.compression
        return JointSample(
            snapshot.stamp_ns, {machine.JUMP_SCREW: JointValue(after.compression, rate, force)}
        )

    def _winch(self, snapshot: _PlanarSnapshot) -> Sample:
        length = self._scenario.tether.length
        return JointSample(
            snapshot.stamp_ns,
            {machine.WINCH_DRUM: JointValue(length), machine.WINCH_BRAKE: JointValue(0.0)},
        )

    def _markers(self, snapshot: _PlanarSnapshot) -> Sample:
        state = snapshot.after
        length = self._scenario.tether.length
        nodes = rep103.vector(state.nodes)
        rover = self._scenario.rover
        carried = self._scenario.tip_mass if rover is None else rover.mass
        density = self._scenario.tether.section.line_density
        nominal = nominal_tension(carried, density, length, self._scenario.gravity)
        arcs = np.linspace(0.0, length, len(nodes))
        shapes = [tether_line(nodes, arcs, snapshot.tension, nominal)]
        if rover is not None:
            orientation = rep103.quaternion(state.theta)
            for name, (width, height), colour, centre in (
                (machine.BODY1_FRAME, rover.body1_size, BODY1_COLOUR, state.G1),
                (machine.BODY2_FRAME, rover.body2_size, BODY2_COLOUR, state.G2),
            ):
                size = (width, width, height)
                place = rep103.vector(centre)
                shapes.append(solid(name, "box", colour, size, place, orientation))
        return DrawingSample(snapshot.stamp_ns, tuple(shapes))

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        """Return an empty drawing: the planar model has no ground."""
        return DrawingSample(stamp_ns, ())


class _PlanarSnapshot:
    """State at the end of a tick, with derived values that several topics share."""

    def __init__(
        self,
        plant: PlanarPlant,
        before: PlanarState,
        after: PlanarState,
        dt: float,
        stamp_ns: int,
        energies: Energies,
    ) -> None:
        self._plant = plant
        self.before = before
        self.after = after
        self.dt = dt
        self.stamp_ns = stamp_ns
        self.energies = energies
        self._tension: Array | None = None

    @property
    def tension(self) -> Array:
        """Tension at the nodes [N], (n + 1,)."""
        if self._tension is None:
            self._tension = self._plant.tension(self.after)
        return self._tension

    @property
    def pull(self) -> Vector:
        """Force of the tether on the fairlead [N]: the tension along the slope at the root."""
        slope = self.after.nodes[0, 1]
        force = float(self.tension[0]) / float(np.hypot(*slope)) * slope
        return as_vector(rep103.vector(force))


def _in_body(theta: float, vector: Array) -> Array:
    """Resolve a planar world vector (2,) in the axes of a body rotated by theta."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]])


def _odometry(stamp_ns: int, state: PlanarState, centre: Array, rate: Array) -> OdometrySample:
    return OdometrySample(
        stamp_ns,
        as_vector(rep103.vector(centre)),
        as_quaternion(rep103.quaternion(state.theta)),
        as_vector(rep103.vector(_in_body(state.theta, rate))),
        as_vector(rep103.rotation_rate(state.omega)),
    )
