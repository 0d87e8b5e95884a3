"""The spatial plant: tether, winch, rover with its drives, and ground."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from msg_schemas.phases import PlantPhase
from rover_sim.physics.ground.rover_contact import anchor_rows
from rover_sim.physics.integrators import integrator_memory, session, spatial
from rover_sim.physics.integrators.compile_targets import (
    Target,
    compile_for,
    full_step,
    sensor_functions,
    step_parts,
)
from rover_sim.physics.integrators.drive_states import (
    LATCH,
    RELEASED_FOR,
    DriveCommands,
    DriveStates,
)
from rover_sim.physics.integrators.session import Model, as_record, make_session, vector_size
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive, wheel_drive
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.numerics.record import Record
from rover_sim.physics.rover import spatial_rover
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.driven_end import end_position, end_rate
from rover_sim.physics.tether.tether import element_tensions, to_rows
from rover_sim.physics.tether.twist import twist_angle
from rover_sim.plants.per_thread import PerThread
from rover_sim.plants.plant import Energies, Outcome, PlantCommand, StepResult
from rover_sim.plants.saved_state import STATE, require_phase, require_shape, restore
from rover_sim.plants.settling import SETTLING_AXIAL, SETTLING_BENDING, settle
from rover_sim.plants.spatial_model import at_start, check_tick, damped, make_model, make_orders
from rover_sim.plants.spatial_result import SpatialResult, energies_of, event_of
from rover_sim.plants.spatial_start import (
    StartPose,
    check_clear,
    frames_along,
    hanging,
    on_ground,
    product,
    quaternion_of,
    straight,
)
from rover_sim.plants.spatial_state import (
    FRAME_ROWS,
    SpatialState,
    load_state,
    rotation_matrix,
    state_of,
)
from rover_sim.scenarios.scenario import AnyScenario, ScenarioError, SpatialScenario

_OUTCOME_OF = {
    integrator_memory.OUTCOME_CONVERGED: Outcome.CONVERGED,
    integrator_memory.OUTCOME_HALVED: Outcome.HALVED,
    integrator_memory.OUTCOME_DIVERGED: Outcome.DIVERGED,
    integrator_memory.OUTCOME_BROKEN: Outcome.TETHER_BROKEN,
}
_IDLE = PlantCommand()
# A tether that carries more than this share of the rover's weight carries the rover.
_CARRIES = 0.05

# Entry of a saved state: the time since the latch tripped; infinite after the release.
_MAY_BE_INFINITE = f"{STATE}.vector[{session.DRIVES.start + RELEASED_FOR}]"
_PHASES = (PlantPhase.HANGING, PlantPhase.GROUNDED, PlantPhase.FLIGHT)
_UNSETTLED_STARTS = ("hanging", "straight")

# Tolerance of a saved state: of the orientation's norm, and of the joint between tether and rover
# [m]; above the largest drift of a run.
_SAME = 1e-4


class SpatialPlant:
    """Spatial plant of a scenario: winch, tether, rover (or a point mass, or a free end), ground.

    Several threads may step it at once; each has its own work arrays.

    Args:
        scenario: a scenario with `model: spatial`.

    Raises:
        ScenarioError: the scenario is of another model.
    """

    scenario: SpatialScenario

    def __init__(self, scenario: AnyScenario) -> None:
        if not isinstance(scenario, SpatialScenario):
            raise ScenarioError("model", scenario.model, "should be spatial for the spatial plant")
        self.scenario = scenario
        self._model = make_model(scenario)
        self._capacity = scenario.most_elements + 1
        self._records = PerThread(lambda: self._make_record(self._model))
        self._advance_kernel: Callable[..., int] | None = None
        self._settled: SpatialState | None = None

    @property
    def model(self) -> Model:
        """The constants of the compiled functions."""
        return self._model

    def _make_record(self, model: Model) -> Record:
        """Allocate the record of constants, state and work arrays of one thread."""
        return as_record(make_session(model, self._capacity))

    # --------------------------------------------------------------------------- initial states

    def initial_state(self) -> SpatialState:
        """Return the state at the scenario's start.

        A rover on the ground, or on a tether with natural curvature or relaxation, is settled by a
        simulation, once for each plant.

        Raises:
            SettlingError: it does not come to rest.
            ScenarioError: the tether does not reach the rover, or the start is in the ground.
        """
        if not self.settles:
            return self.unsettled_state()
        settled, start = self.settled_state(), self.scenario.start
        if start.compression == 0.0:
            return settled
        ready = self.compressed(settled, start.compression, np.radians(start.tilt))
        return self._with_initial_memory(ready, ready.twist, ready.phase)

    @property
    def settles(self) -> bool:
        """Whether a simulation settles the scenario's start."""
        kind = self.scenario.start.kind
        return kind not in _UNSETTLED_STARTS or (
            kind == "hanging" and self.scenario.tether.has_frames
        )

    def settled_state(self) -> SpatialState:
        """Return the settled state, from which a rover is made ready to jump.

        Raises:
            SettlingError: it does not come to rest.
            ScenarioError: the tether does not reach the rover, or the start is in the ground.
        """
        if self._settled is None:
            self._settled = self._settle(self.unsettled_state())
        return self._settled

    def start_from(self, settled: Mapping[str, Any]) -> None:
        """Take a settled state of the same scenario in place of a simulation.

        Args:
            settled: `settled_state`, as from `saved_state.plain_state`.

        Raises:
            ScenarioError: as `restored_state`.
        """
        self._settled = self.restored_state(settled)

    def with_scenario(self, scenario: SpatialScenario) -> SpatialPlant:
        """Return a plant of a scenario with another start alone; it shares this one's model.

        If both starts settle at the same place, they share the settled state as well.

        Raises:
            ScenarioError: the scenario differs in more than its start.
        """
        for item in dataclasses.fields(scenario):
            own, value = getattr(self.scenario, item.name), getattr(scenario, item.name)
            if item.name != "start" and own != value:
                raise ScenarioError(item.name, value, "should be that of the plant's scenario")
        other = copy.copy(self)
        other.scenario = scenario
        if scenario.start.at_rest != self.scenario.start.at_rest:
            other._settled = None
        return other

    def compressed(
        self, state: SpatialState, stroke: float, tilt: ArrayLike = (0.0, 0.0, 0.0)
    ) -> SpatialState:
        """Return a state at rest with the spring compressed and latched, and the rover tilted.

        The clock and the energy balance do not change: they do not account for the spring's energy.

        Args:
            state: with the rover at rest.
            stroke: compression of the spring [m]; a value above the drive's stroke represents a
                spring stiffer than the scenario's.
            tilt: rotation vector of the rover in base_link [rad], (3,).

        Raises:
            ScenarioError: the scenario has no rover.
            ValueError: the stroke is not above 0 or not below the slider's lower stop.
        """
        rover = self.scenario.rover
        if rover is None:
            raise ScenarioError("rover", None, "should be there to jump")
        slider = rover.slider
        if not 0.0 < stroke < slider.lower_stop:
            raise ValueError(
                f"stroke = {stroke!r} m: must be above 0 and below the slider's lower stop at "
                f"{slider.lower_stop:g} m"
            )
        body, nodes = state.body.copy(), state.nodes.copy()
        quaternion = slice(spatial_rover.ORIENTATION, spatial_rover.ORIENTATION + 4)
        turned = product(body[quaternion], quaternion_of(tilt))
        body[quaternion] = turned
        body[spatial_rover.SLIDE] = slider.free_length - stroke
        nodes[-1, 0] = state.G1 + rotation_matrix(turned) @ np.array(rover.attachment)
        # The nut yields elastically to the spring's force.
        nut = stroke * (1.0 + slider.spring_rate / slider.nut_stiffness)
        jump = state.drives.jump._replace(latch=int(Latch.ENGAGED), nut=nut, rate=0.0)
        return state.replaced(body=body, nodes=nodes, drives=state.drives._replace(jump=jump))

    def unsettled_state(self) -> SpatialState:
        """Return the state at the scenario's start, without settling a rover on the ground.

        Raises:
            ScenarioError: the tether does not reach the rover, or the start is in the ground.
        """
        kind = self.scenario.start.kind
        if kind == "grounded":
            return self._state_from(on_ground(self.scenario, self._model.terrain))
        pose = (hanging if kind == "hanging" else straight)(self.scenario)
        check_clear(self.scenario, pose, self._model.terrain)
        return self._state_from(pose)

    def restored_state(self, values: Mapping[str, Any]) -> SpatialState:
        """Return a saved state of this scenario.

        Args:
            values: as from `saved_state.plain_state`.

        Raises:
            ScenarioError: a value is missing, not finite, or of another mesh; or the parts of the
                state do not fit together.
        """
        state = restore(SpatialState, values, infinite=(_MAY_BE_INFINITE,))
        require_phase(state.phase, _PHASES if self._model.has_rover else (PlantPhase.FREE,))
        corners = len(self._model.rover_contact.corners)
        require_shape(state.vector, (vector_size(corners),), f"{STATE}.vector")
        elements = int(state.memory[integrator_memory.ELEMENTS])
        most = self.scenario.most_elements
        if not 1 <= elements <= most:
            raise ScenarioError(
                f"{STATE}: elements", elements, f"should be from 1 to {most}, the scenario's most"
            )
        require_shape(state.rows, (12, elements + 1), f"{STATE}.rows")
        require_shape(state.tether_anchors, (2 * elements, 3), f"{STATE}.tether_anchors")
        frames = elements + 1 if self.scenario.tether.has_frames else 0
        require_shape(state.frames, (FRAME_ROWS, frames), f"{STATE}.frames")
        first = state.length - elements * self._model.tether.element_length
        if self._model.has_winch and not 0.0 < first < 2.0 * self._model.tether.element_length:
            raise ScenarioError(
                f"{STATE}: length paid out",
                state.length,
                f"should be that of {elements} elements of {self._model.tether.element_length:g} m "
                "and a shorter one",
            )
        latch = float(state.vector[session.DRIVES.start + LATCH])
        if latch not in tuple(Latch):
            names = ", ".join(f"{each.value} {each.name.lower()}" for each in Latch)
            raise ScenarioError(f"{STATE}: latch", latch, f"should be one of {names}")
        if self._model.has_rover:
            self._check_rover(state)
        return state

    def _check_rover(self, state: SpatialState) -> None:
        norm = float(np.linalg.norm(state.orientation))
        if not abs(norm - 1.0) < _SAME:
            raise ScenarioError(f"{STATE}: norm of the orientation", norm, "should be 1")
        attachment = state.G1 + state.rotation @ np.array(self._model.rover.attachment)
        gap = float(np.linalg.norm(attachment - state.tip))
        if not gap < _SAME:
            raise ScenarioError(
                f"{STATE}: distance of tether and rover",
                gap,
                f"should be below {_SAME:g} m at the attachment",
            )

    def state_at(
        self,
        nodes: ArrayLike,
        node_rates: ArrayLike | None = None,
        *,
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        slide: float | None = None,
        twist: float = 0.0,
    ) -> SpatialState:
        """Return a state with given pose and motion; clock, energy balance and drives are initial.

        Both bodies move with the tether's tip and the angular velocity; the slider is at rest.

        Args:
            nodes: of the whole tether as from `to_full_nodes`: positions [m] and slopes [-],
                (m + 1, 2, 3); the first is the fairlead.
            node_rates: rates of the nodes per second; None: at rest.
            orientation: quaternion (x, y, z, w), base_link to map.
            angular_velocity: in base_link [rad/s], (3,).
            slide: s [m]; None: the spring's free length.
            twist: of the tether [rad].

        Raises:
            ValueError: the shape does not fit the scenario, or a value is not finite.
        """
        chain, first = self.scenario.chain
        count = chain + (2 if first > 0.0 else 1)
        whole = _finite_array("nodes", nodes, (count, 2, 3))
        if np.any(whole[0, 0] != 0.0):
            raise ValueError(
                f"nodes[0, 0] = {whole[0, 0].tolist()}: must be the fairlead, (0, 0, 0)"
            )
        rates = np.zeros_like(whole)
        if node_rates is not None:
            rates = _finite_array("node_rates", node_rates, (count, 2, 3))
        x, y, z, w = _finite_array("orientation", orientation, (4,))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1.0) < 1e-6:
            raise ValueError(f"orientation: its norm is {norm:.6g}, must be 1")
        rover, section = self.scenario.rover, self.scenario.tether.section
        rest = 0.0 if rover is None else rover.slider.free_length
        square = float(whole[0, 1] @ whole[0, 1])
        tension = 0.5 * section.axial_stiffness * (square - 1.0) * math.sqrt(square)
        own = slice(1, None) if first > 0.0 else slice(None)
        return self._state_from(
            StartPose(
                nodes=whole[own],
                node_rates=rates[own],
                fairlead_slope=np.array([whole[0, 1], rates[0, 1]]),
                tension=tension,
                orientation=np.array([w, x, y, z]) / norm,
                spin=_finite_array("angular_velocity", angular_velocity, (3,)),
                slide=rest if slide is None else float(_finite_array("slide", slide, ())),
            ),
            twist,
        )

    def _state_from(self, pose: StartPose, twist: float | None = None) -> SpatialState:
        if twist is None:
            twist = math.radians(self.scenario.start.twist)
        body = np.zeros(spatial_rover.BODY_SIZE)
        turned = rotation_matrix(pose.orientation)
        spin_x, spin_y = float(pose.spin[0]), float(pose.spin[1])
        if self._model.has_rover:
            spin = turned @ pose.spin
            lever1 = -turned @ np.array(self._model.rover.attachment)
            lever2 = (
                lever1 + pose.slide * turned[:, 2] + turned @ np.array(self._model.rover.offset)
            )
            tip, rate = pose.nodes[-1, 0], pose.node_rates[-1, 0]
            body[spatial_rover.POSITION : spatial_rover.POSITION + 3] = tip + lever1
            body[spatial_rover.ORIENTATION : spatial_rover.ORIENTATION + 4] = pose.orientation
            body[spatial_rover.SPIN : spatial_rover.SPIN + 3] = pose.spin
            body[spatial_rover.VELOCITY1 : spatial_rover.VELOCITY1 + 3] = rate + np.cross(
                spin, lever1
            )
            body[spatial_rover.VELOCITY2 : spatial_rover.VELOCITY2 + 3] = rate + np.cross(
                spin, lever2
            )
            body[spatial_rover.SLIDE] = pose.slide
            body[spatial_rover.ROTORS] = self._model.jump.inertia * spin_x
            body[spatial_rover.ROTORS + 1] = 2.0 * self._model.wheels.wheel_inertia * spin_y
            prescribed = at_start(self._model).rotors.momenta[0]
            body[spatial_rover.ROTORS : spatial_rover.ROTORS + 3] += prescribed
        drives = self._drive_states(spin_x, spin_y)
        if pose.payout_rate != 0.0:
            drum = drives.drum
            turns = self._model.drum.full_turns - drum.angle / (2.0 * math.pi)
            radius = drums.radius_at(self._model.drum, turns)
            drives = drives._replace(
                drum=drum._replace(rate=float(pose.payout_rate / radius), braked=False)
            )
        elements = len(pose.nodes) - 1
        memory = np.zeros(integrator_memory.MEMORY_SIZE)
        memory[integrator_memory.ELEMENTS] = elements
        memory[integrator_memory.FAIRLEAD_TENSION] = pose.tension
        memory[integrator_memory.AIRBORNE] = 1.0
        state = SpatialState.from_parts(
            phase=PlantPhase.HANGING,
            nodes=pose.nodes,
            node_rates=pose.node_rates,
            fairlead_slope=pose.fairlead_slope,
            body=body,
            rover_anchors=np.zeros((anchor_rows(len(self._model.rover_contact.corners)), 3)),
            tether_anchors=np.zeros((2 * elements, 3)),
            frames=frames_along(self.scenario, pose, twist),
            drives=drives,
            memory=memory,
        )
        return self._with_initial_memory(
            state, twist, self._phase_off_ground(float(self.tension(state)[-1]))
        )

    def _drive_states(self, spin_x: float, spin_y: float) -> DriveStates:
        """Return drives at rest relative to Body 1, with its angular velocity [rad/s]."""
        model = self._model
        length = min(max(self.scenario.tether.length, model.drum.min_length), model.drum.max_length)
        return DriveStates(
            jump_drive.initial_state(model.jump)._replace(body_rate=spin_x),
            drums.initial_state(model.drum, length),
            wheel_drive.WheelState()._replace(body_rate=spin_y),
        )

    def _phase_off_ground(self, tension: float) -> PlantPhase:
        """Return the phase of a rover without ground contact: hanging or in flight."""
        rover = self.scenario.rover
        if rover is None:
            return PlantPhase.FREE
        carries = tension > _CARRIES * rover.mass * self.scenario.gravity and tension > 0.0
        return PlantPhase.HANGING if carries else PlantPhase.FLIGHT

    def _with_initial_memory(
        self, state: SpatialState, twist: float, phase: PlantPhase
    ) -> SpatialState:
        """Return the state with zero clock and energy balance, and a twist of the tether [rad]."""
        memory = np.zeros(integrator_memory.MEMORY_SIZE)
        for entry in (
            integrator_memory.ELEMENTS,
            integrator_memory.FAIRLEAD_TENSION,
            integrator_memory.LEFT_TORQUE,
            integrator_memory.RIGHT_TORQUE,
            integrator_memory.AIRBORNE,
        ):
            memory[entry] = state.memory[entry]
        if phase is PlantPhase.HANGING:
            memory[integrator_memory.AIRBORNE] = integrator_memory.SUSPENDED
        memory[integrator_memory.TAKE_OFF_X : integrator_memory.TAKE_OFF_Z + 1] = state.G1
        if self._model.has_rover:
            slope = state.fairlead_slope[0] if self._model.has_winch else state.nodes[0, 1]
            quaternion = state.body[spatial_rover.ORIENTATION : spatial_rover.ORIENTATION + 4]
            memory[integrator_memory.TWIST] = twist_angle(
                state.elements,
                tuple(slope.tolist()),
                to_rows(state.nodes),
                tuple(quaternion.tolist()),
                0.0,
            )
            memory[integrator_memory.SWIVEL_SLIP] = memory[integrator_memory.TWIST] - twist
            spin = state.omega
            memory[integrator_memory.DRIVE_KINETIC] = 0.5 * self._model.jump.inertia * spin[0] ** 2
            memory[integrator_memory.DRIVE_KINETIC] += (
                self._model.wheels.wheel_inertia * spin[1] ** 2
            )
        if self._model.has_winch:
            memory[integrator_memory.DRIVE_KINETIC] += (
                0.5 * self._model.drum.inertia * state.drum_rate**2
            )
        fresh = state.replaced(memory=memory, phase=phase)
        memory[integrator_memory.INITIAL_ENERGY] = self.energies(fresh).stored
        return fresh.replaced(memory=memory)

    def _settle(self, state: SpatialState) -> SpatialState:
        """Let tether and rover come to rest, the tether strongly damped and relaxed."""
        model = at_start(damped(self._model, SETTLING_AXIAL, SETTLING_BENDING))
        record = self._make_record(model)
        orders = make_orders(self.scenario, model, _IDLE, free=True)
        at_rest = settle(
            self.scenario, state, lambda before, dt: self._advance(record, before, orders, dt)
        )
        # the twist of a tether with natural curvature belongs to its shape
        return self._with_initial_memory(at_rest, float(np.sum(at_rest.frames[3])), at_rest.phase)

    # -------------------------------------------------------------------------------- stepping

    def step(
        self, state: SpatialState, command: PlantCommand, dt: float
    ) -> tuple[SpatialState, StepResult]:
        """Advance by one control tick; see `rover_sim.plants.plant.Plant.step`."""
        tick = check_tick(dt)
        orders = make_orders(
            self.scenario,
            self._model,
            command,
            free=state.latch is Latch.FREE,
            drum_radius=self.drum_radius(state),
        )
        if state.phase.final:
            outcome = (
                Outcome.DIVERGED if state.phase is PlantPhase.DIVERGED else Outcome.TETHER_BROKEN
            )
            return state, StepResult(outcome, self.energies(state), 0.0, 0, math.inf, (), 0.0)
        return self._advance(self._records.own(), state, orders, tick)

    def _advance(
        self, record: Record, state: SpatialState, orders: DriveCommands, dt: float
    ) -> tuple[SpatialState, StepResult]:
        if self._advance_kernel is None:
            self._advance_kernel = compile_for(*full_step(record, orders))
        own = record.value
        load_state(state, own)
        outcome = _OUTCOME_OF[self._advance_kernel(record, orders, dt)]
        report = own.report.tolist()
        count = int(report[integrator_memory.EVENT_COUNT])
        after = state_of(own, self._phase(outcome, own.memory, report))
        events = tuple(event_of(row) for row in own.events[:count]) if count else ()
        return after, SpatialResult(outcome, report, after, events)

    def _phase(self, outcome: Outcome, memory: Array, report: Sequence[float]) -> PlantPhase:
        if outcome is Outcome.DIVERGED:
            return PlantPhase.DIVERGED
        if outcome is Outcome.TETHER_BROKEN:
            return PlantPhase.TETHER_BROKEN
        if memory[integrator_memory.AIRBORNE] == 0.0 and self._model.has_rover:
            return PlantPhase.GROUNDED
        return self._phase_off_ground(report[integrator_memory.TIP_TENSION])

    # ------------------------------------------------------------------------ derived quantities

    def energies(self, state: SpatialState) -> Energies:
        """Return the energies of a state, with the balance since the start of the run."""
        record = self._records.own()
        load_state(state, record.value)
        report = [0.0] * integrator_memory.REPORT_SIZE
        report[integrator_memory.KINETIC : integrator_memory.TORSION + 1] = spatial.energies(record)
        return energies_of(report, state.memory)

    def to_full_nodes(self, state: SpatialState) -> Array:
        """Return the nodes from fairlead to rover, (m + 1, 2, 3), as `SpatialState.nodes`.

        With a winch the fairlead is added as the first node.
        """
        if not self._model.has_winch:
            return state.nodes
        place = end_position.py_func(self._model.root_motion, state.time)
        fairlead = np.array([[place, state.fairlead_slope[0]]])
        return np.concatenate([fairlead, state.nodes])

    def to_arc_lengths(self, state: SpatialState) -> Array:
        """Return the undeformed arc length from the fairlead to the full nodes [m], (m + 1,)."""
        chain = self._model.tether.element_length * np.arange(state.elements + 1)
        if not self._model.has_winch:
            return np.asarray(chain)
        return np.concatenate([[0.0], state.length - chain[-1] + chain])

    def tension(self, state: SpatialState) -> Array:
        """Return the tension at the full nodes [N], (m + 1,), damping included; < 0: compression.

        The mean axial forces of the elements are interpolated to the nodes and extrapolated to the
        ends.
        """
        tether = self._model.tether._replace(elements=state.elements)
        means = np.empty(state.elements)
        element_tensions(tether, to_rows(state.nodes), to_rows(state.node_rates), means)
        arcs = self.to_arc_lengths(state)
        if self._model.has_winch:
            ends = self.to_full_nodes(state)[:2]
            # The element grows as the drum pays out: its first node moves with the material.
            follows = self.payout_rate(state) * (ends[1, 0] - ends[0, 0]) / arcs[1]
            follows = follows + end_rate.py_func(self._model.root_motion, state.time)
            rates = np.array([[follows, state.fairlead_slope[1]], state.node_rates[0]])
            first = np.empty(1)
            element_tensions(
                tether._replace(elements=1, element_length=float(arcs[1])),
                to_rows(ends),
                to_rows(rates),
                first,
            )
            means = np.concatenate([first, means])
        if means.size == 1:
            return np.repeat(means, 2)
        middles = 0.5 * (arcs[:-1] + arcs[1:])
        inner = np.interp(arcs[1:-1], middles, means)
        slope0 = (means[1] - means[0]) / (middles[1] - middles[0])
        slope1 = (means[-1] - means[-2]) / (middles[-1] - middles[-2])
        first_node = means[0] - slope0 * (middles[0] - arcs[0])
        last_node = means[-1] + slope1 * (arcs[-1] - middles[-1])
        return np.concatenate([[first_node], inner, [last_node]])

    def payout_rate(self, state: SpatialState) -> float:
        """Return the payout rate at the drum [m/s], > 0 lengthens the tether."""
        if not self._model.has_winch:
            return 0.0
        return self.drum_radius(state) * state.drives.drum.rate

    def drum_radius(self, state: SpatialState) -> float:
        """Return the radius at which the tether leaves the drum [m]."""
        turns = self._model.drum.full_turns - state.drum_angle / (2.0 * math.pi)
        # The Python function: converting the arguments of the compiled one takes far longer.
        return float(drums.radius_at.py_func(self._model.drum, turns))

    def _some_state(self) -> SpatialState:
        """Return a state that needs no simulation."""
        is_straight = self.scenario.start.kind == "straight"
        return self._state_from((straight if is_straight else hanging)(self.scenario))

    def step_parts(self) -> list[Target]:
        """Return the functions that `warm_up` compiles last; see `compile_targets.step_parts`."""
        return step_parts(self._records.own())

    def sensor_functions(self) -> list[Target]:
        """Return the functions of the sensors, which `warm_up` does not compile."""
        return sensor_functions(self._model.terrain)

    def warm_up(self) -> None:
        """Compile the functions of a step, or load them from the cache."""
        orders = make_orders(self.scenario, self._model, _IDLE, free=True)
        state = self._some_state()
        self._advance(self._records.own(), state, orders, self._model.step)
        self.tension(state)
        self.payout_rate(state)


def _finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} have the shape {array.shape}, must be {shape}")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name}: every value must be finite")
    return array
