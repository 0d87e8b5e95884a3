"""The planar plant: tether and two-body rover in a vertical plane, behind the plant contract."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_sim.physics.integrators import planar
from rover_sim.physics.integrators.compile_targets import compile_for
from rover_sim.physics.rover import planar_rover
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.starting_shapes import Catenary, arc_nodes
from rover_sim.physics.tether.statics import StaticsError, static_equilibrium
from rover_sim.physics.tether.tether import (
    element_tensions,
    make_tether,
    nodal_tensions,
    to_nodes,
    to_rows,
)
from rover_sim.plants.per_thread import PerThread
from rover_sim.plants.plant import (
    Energies,
    Event,
    JumpMotorCommand,
    Outcome,
    PlantCommand,
    StepResult,
)
from rover_sim.plants.saved_state import STATE, require_phase, require_shape, restore
from rover_sim.scenarios.scenario import AnyScenario, Scenario, ScenarioError

_PHASES = {
    PlantPhase.HELD: planar.HELD,
    PlantPhase.FLIGHT: planar.FLIGHT,
    PlantPhase.LANDED: planar.LANDED,
    PlantPhase.FREE: planar.FREE,
    PlantPhase.DIVERGED: planar.DIVERGED,
    PlantPhase.TETHER_BROKEN: planar.TETHER_BROKEN,
}
_PHASES_OF_ROVER = (PlantPhase.HELD, PlantPhase.FLIGHT, PlantPhase.LANDED)
_PHASE_OF = {code: phase for phase, code in _PHASES.items()}
_OUTCOME_OF = {
    planar.OUTCOME_CONVERGED: Outcome.CONVERGED,
    planar.OUTCOME_HALVED: Outcome.HALVED,
    planar.OUTCOME_DIVERGED: Outcome.DIVERGED,
    planar.OUTCOME_BROKEN: Outcome.TETHER_BROKEN,
}


_DRIVE_OFF = planar.JumpSetpoint(0.0, 0.0, False)


@dataclass(frozen=True)
class EnergyBalance:
    """The energy balance since the start of the run [J]."""

    initial: float = 0.0  # stored at the start
    input: float = 0.0
    dissipated: float = 0.0


@dataclass(frozen=True)
class TakeOffRecord:
    """Pose and time of the last take-off, and the largest rise since."""

    time: float = 0.0  # [s]
    G1: tuple[float, float] = (0.0, 0.0)  # [m]
    theta: float = 0.0  # [rad]
    highest: float = 0.0  # [m]


@dataclass(frozen=True, eq=False)
class PlanarState:
    """State of the planar plant; its arrays are read-only.

    Axes as in the paper: x horizontal, y up, theta counter-clockwise from upright; the origin is
    the tether's root. Without a rover the fields of the bodies are zero. The state holds the
    velocities of both bodies, as the energy-momentum integrator does; `s_rate` follows from them.
    """

    time: float  # [s]
    phase: PlantPhase
    nodes: Array  # (n + 1, 2, 2): [i, 0] position [m], [i, 1] slope r' [-] of node i
    node_rates: Array  # the same per second
    G1: Array  # centre of Body 1 [m], (2,)
    G1_rate: Array  # [m/s]
    G2_rate: Array  # velocity of Body 2's centre [m/s], (2,)
    theta: float  # [rad]
    omega: float  # [rad/s]
    s: float  # distance of the bodies' centres along the slider [m]
    compression: float = 0.0  # of the jump spring by its motor [m]
    take_off: TakeOffRecord = TakeOffRecord()
    energy_balance: EnergyBalance = EnergyBalance()

    def __post_init__(self) -> None:
        for name in ("nodes", "node_rates", "G1", "G1_rate", "G2_rate"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def slider_axis(self) -> Array:
        """Unit vector from Body 1 to Body 2, (2,)."""
        return np.array([-math.sin(self.theta), math.cos(self.theta)])

    @property
    def G2(self) -> Array:
        """Centre of Body 2 [m], (2,)."""
        return self.G1 + self.s * self.slider_axis

    @property
    def s_rate(self) -> float:
        """Rate of s [m/s]."""
        return float(self.slider_axis @ (self.G2_rate - self.G1_rate))


class PlanarPlant:
    """Tether and rover (or a free end, or a weight) of a scenario, in the plane.

    Args:
        scenario: a scenario with `model: planar`.

    Raises:
        ScenarioError: the scenario is of another model.
    """

    scenario: Scenario

    def __init__(self, scenario: AnyScenario) -> None:
        if not isinstance(scenario, Scenario):
            raise ScenarioError("model", scenario.model, "should be planar for the planar plant")
        self.scenario = scenario
        tether = scenario.tether
        self.section = tether.section
        self._elements = tether.elements
        self._model = make_model(scenario)
        self._advance_kernel: Callable[..., Any] | None = None
        self._solvers = PerThread(lambda: planar.make_solver(self._elements))

    @property
    def model(self) -> planar.PlanarModel:
        """The constants of the compiled functions."""
        return self._model

    def initial_state(self) -> PlanarState:
        """Return the state at the scenario's start, at rest, with the rover held.

        Raises:
            StaticsError: the tether has no static equilibrium, or no shape of the requested kind.
        """
        try:
            return self.state_at_rest(initial_nodes(self.scenario))
        except ValueError as error:
            raise StaticsError(f"{self.scenario.name}: no initial shape: {error}") from error

    def state_at_rest(self, nodes: ArrayLike) -> PlanarState:
        """Return a state at rest with the given shape of the tether, the rover held at its tip.

        Args:
            nodes: (n + 1, 2, 2), positions [m] and slopes [-].

        Raises:
            ValueError: the shape does not fit the scenario, or a value is not finite.
        """
        shape = np.array(nodes, dtype=np.float64)
        expected = (self.scenario.tether.elements + 1, 2, 2)
        if shape.shape != expected:
            raise ValueError(f"nodes have the shape {shape.shape}, must be {expected}")
        if not np.all(np.isfinite(shape)):
            raise ValueError("nodes: every value must be finite")
        G1, theta, s = np.zeros(2), 0.0, 0.0
        if self.scenario.rover is not None:
            theta = self.scenario.theta0
            a, b = self.scenario.rover.attachment
            c, z = math.cos(theta), math.sin(theta)
            G1 = shape[-1, 0] - np.array([c * a - z * b, z * a + c * b])
            s = self.scenario.rover.spring_free_length
        state = PlanarState(
            time=0.0,
            phase=PlantPhase.FREE if self.scenario.rover is None else PlantPhase.HELD,
            nodes=shape,
            node_rates=np.zeros_like(shape),
            G1=G1,
            G1_rate=np.zeros(2),
            G2_rate=np.zeros(2),
            theta=theta,
            omega=0.0,
            s=s,
            take_off=TakeOffRecord(0.0, (float(G1[0]), float(G1[1])), theta, 0.0),
        )
        return replace(state, energy_balance=EnergyBalance(initial=self.energies(state).stored))

    def restored_state(self, values: Mapping[str, Any]) -> PlanarState:
        """Return a saved state of this scenario.

        Args:
            values: as from `saved_state.plain_state`.

        Raises:
            ScenarioError: a value is missing, not finite, or of another mesh.
        """
        state = restore(PlanarState, values)
        has_rover = self.scenario.rover is not None
        require_phase(state.phase, _PHASES_OF_ROVER if has_rover else (PlantPhase.FREE,))
        nodes = (self._elements + 1, 2, 2)
        require_shape(state.nodes, nodes, f"{STATE}.nodes")
        require_shape(state.node_rates, nodes, f"{STATE}.node_rates")
        for name in ("G1", "G1_rate", "G2_rate"):
            require_shape(getattr(state, name), (2,), f"{STATE}.{name}")
        return state

    def take_off(self, state: PlanarState) -> PlanarState:
        """Apply the scenario's take-off to a rover on the ground.

        Raises:
            ValueError: there is no rover, or it is not on the ground.
        """
        if state.phase not in (PlantPhase.HELD, PlantPhase.LANDED):
            raise ValueError(
                f"take-off needs a rover on the ground, phase held or landed; it is"
                f" {state.phase.value}"
            )
        motion = _motion_of(state)
        planar.take_off(self._model, self.scenario.take_off_velocity, motion)
        motion.memory[planar.COMPRESSION] = 0.0
        return _state_of(motion, self._elements, PlantPhase.FLIGHT)

    def step(
        self, state: PlanarState, command: PlantCommand, dt: float
    ) -> tuple[PlanarState, StepResult]:
        """Advance by one control tick; see `rover_sim.plants.plant.Plant.step`."""
        return self.advance(state, command, dt, stop_at_touchdown=False)

    def advance(
        self, state: PlanarState, command: PlantCommand, dt: float, *, stop_at_touchdown: bool
    ) -> tuple[PlanarState, StepResult]:
        """Advance as `step`, optionally only up to the touchdown.

        Raises:
            ValueError: dt or a value of the command is not finite or out of range.
        """
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt = {dt}: must be finite and above 0 s")
        setpoint = _setpoint_of(command, self._model.rover.spring_rate)
        motion = _motion_of(state)
        if state.phase.final:
            outcome = (
                Outcome.DIVERGED if state.phase is PlantPhase.DIVERGED else Outcome.TETHER_BROKEN
            )
            return state, StepResult(outcome, self.energies(state), 0.0, 0, math.inf, (), 0.0)
        events = np.zeros((planar.MAX_EVENTS, planar.EVENT_SIZE))
        solver = self._solvers.own()
        arguments = (
            self._model,
            motion,
            _PHASES[state.phase],
            setpoint,
            float(dt),
            stop_at_touchdown,
            events,
            solver,
        )
        if self._advance_kernel is None:
            self._advance_kernel = compile_for(planar.advance, arguments)
        outcome_code, phase_code = self._advance_kernel(*arguments)
        report = solver.report
        count = int(report[planar.EVENT_COUNT])
        after = _state_of(motion, self._elements, _PHASE_OF[phase_code])
        peak = float(report[planar.PEAK_TENSION])
        result = StepResult(
            outcome=_OUTCOME_OF[outcome_code],
            energies=_energies_of(report[planar.KINETIC : planar.SPRING + 1], after.energy_balance),
            constraint_drift=float(report[planar.CONSTRAINT_DRIFT]),
            newton_iterations=int(report[planar.ITERATIONS]),
            smallest_step=float(report[planar.SMALLEST_STEP]),
            events=tuple(_event_of(row) for row in events[:count]),
            peak_tension=peak if math.isfinite(peak) else 0.0,
        )
        return after, result

    def energies(self, state: PlanarState) -> Energies:
        """Return the energies of a state, with the balance since the start of the run."""
        motion = _motion_of(state)
        parts = planar.energies(self._model, motion.q, motion.v, motion.body)
        return _energies_of(parts, state.energy_balance)

    def tension(self, state: PlanarState) -> Array:
        """Return the tension at the nodes [N], (n + 1,), damping included; < 0: compression.

        The mean axial forces of the elements are interpolated to the nodes and extrapolated to the
        ends.
        """
        motion = _motion_of(state)
        tensions = np.empty(self._elements)
        element_tensions(self._model.tether, motion.q, motion.v, tensions)
        return nodal_tensions(tensions)

    def warm_up(self) -> None:
        """Compile the functions of a step, or load them from the cache."""
        state = self.state_at_rest(_straight(self.scenario))
        self.step(state, PlantCommand(), self._model.step)
        self.tension(state)
        if self.scenario.rover is not None:
            self.take_off(state)


def make_model(scenario: Scenario) -> planar.PlanarModel:
    """Return the constants of the compiled functions for a scenario."""
    tether, rover, integration = scenario.tether, scenario.rover, scenario.integration
    section = tether.section
    bodies = planar_rover.NO_ROVER
    if rover is not None:
        bodies = planar_rover.PlanarRover(
            m1=float(rover.m1),
            m2=float(rover.m2),
            inertia=float(rover.inertia1 + rover.inertia2),
            attachment_x=float(rover.attachment[0]),
            attachment_y=float(rover.attachment[1]),
            spring_rate=float(rover.spring_rate),
            spring_free_length=float(rover.spring_free_length),
            slider_damping=float(rover.slider_damping),
        )
    take_off = scenario.take_off
    return planar.PlanarModel(
        tether=make_tether(
            section,
            tether.length,
            tether.elements,
            (0.0, -scenario.gravity),
            integration.numerical_damping,
        ),
        rover=bodies,
        has_rover=rover is not None,
        tip_mass=float(scenario.tip_mass),
        root_pinned=True,
        root_clamped=tether.root == "clamped",
        linear_rates=take_off is not None and take_off.tether_rates == "linear",
        hold_after_landing=scenario.after_landing == "hold",
        breaking_load=float(section.breaking_load),
        step=float(integration.h),
        tolerance=float(integration.tolerance),
        max_halvings=int(integration.max_halvings),
    )


def initial_nodes(scenario: Scenario) -> Array:
    """Return the tether's nodes at the scenario's start, (n + 1, 2, 2), the root at the origin.

    Raises:
        StaticsError: the tether has no static equilibrium.
    """
    tether, start = scenario.tether, scenario.start
    root, tip = np.zeros(2), np.array(scenario.tip_position)
    gravity = np.array([0.0, -scenario.gravity])
    slope = None
    if tether.root == "clamped" and start.direction is not None:
        angle = math.radians(start.direction)
        slope = np.array([math.cos(angle), math.sin(angle)])
    if start.initial_shape == "straight":
        return _straight(scenario)
    if start.initial_shape == "static":
        return static_equilibrium(
            tether.section, tether.length, tether.elements, gravity, root, tip, root_slope=slope
        )
    if start.initial_shape == "catenary":
        nodes = Catenary.between(root, tip, tether.length, gravity).nodes(tether.elements)
    else:
        nodes = arc_nodes(root, tip, tether.elements, tether.length, gravity)
    if slope is not None:
        nodes[0, 1] = slope
    return nodes


def _straight(scenario: Scenario) -> Array:
    """Return the nodes of the unstretched tether along the direction to the tip."""
    direction = np.array(scenario.tip_position)
    direction = direction / float(np.linalg.norm(direction))
    elements = scenario.tether.elements
    nodes = np.empty((elements + 1, 2, 2))
    nodes[:, 0] = np.linspace(0.0, scenario.tether.length, elements + 1)[:, None] * direction
    nodes[:, 1] = direction
    return nodes


def _setpoint_of(command: PlantCommand, spring_rate: float) -> planar.JumpSetpoint:
    """Return the command to the jump drive.

    Raises:
        ValueError: a value is invalid, or the plant lacks the commanded motor.
    """
    for name in ("winch", "wheel"):
        if getattr(command, name) is not None:
            raise ValueError(f"{name}: the planar plant has no such motor; must be None")
    jump = command.jump
    if jump is None:
        return _DRIVE_OFF
    if not isinstance(jump, JumpMotorCommand):
        raise ValueError("jump: the planar plant has no flywheel; must be a JumpMotorCommand")
    if not (math.isfinite(jump.compression) and jump.compression >= 0.0):
        raise ValueError(f"compression = {jump.compression}: must be finite and not below 0 m")
    if not (math.isfinite(jump.rate) and jump.rate > 0.0):
        raise ValueError(f"rate = {jump.rate}: must be finite and above 0 m/s")
    holding = spring_rate * jump.compression
    if not jump.max_force >= holding:
        raise ValueError(
            f"max_force = {jump.max_force}: must be at least {holding:.4g} N, the spring's force"
            f" at {jump.compression:.4g} m"
        )
    return planar.JumpSetpoint(float(jump.compression), float(jump.rate), bool(jump.trips))


def _motion_of(state: PlanarState) -> planar.PlanarMotion:
    """Return new arrays with the state's values."""
    body = np.zeros(planar_rover.BODY_SIZE)
    body[[planar_rover.X1, planar_rover.Y1]] = state.G1
    body[planar_rover.THETA], body[planar_rover.SLIDE], body[planar_rover.OMEGA] = (
        state.theta,
        state.s,
        state.omega,
    )
    body[[planar_rover.VX1, planar_rover.VY1]] = state.G1_rate
    body[[planar_rover.VX2, planar_rover.VY2]] = state.G2_rate
    memory = np.zeros(planar.MEMORY_SIZE)
    memory[planar.TIME] = state.time
    memory[planar.COMPRESSION] = state.compression
    memory[planar.TAKE_OFF_TIME] = state.take_off.time
    memory[[planar.TAKE_OFF_X, planar.TAKE_OFF_Y]] = state.take_off.G1
    memory[planar.TAKE_OFF_THETA] = state.take_off.theta
    memory[planar.MAX_RISE] = state.take_off.highest
    memory[planar.INPUT] = state.energy_balance.input
    memory[planar.DISSIPATED] = state.energy_balance.dissipated
    memory[planar.INITIAL_ENERGY] = state.energy_balance.initial
    return planar.PlanarMotion(to_rows(state.nodes), to_rows(state.node_rates), body, memory)


def _state_of(motion: planar.PlanarMotion, elements: int, phase: PlantPhase) -> PlanarState:
    q, v, body, memory = motion
    return PlanarState(
        time=float(memory[planar.TIME]),
        phase=phase,
        nodes=to_nodes(q, elements),
        node_rates=to_nodes(v, elements),
        G1=body[[planar_rover.X1, planar_rover.Y1]],
        G1_rate=body[[planar_rover.VX1, planar_rover.VY1]],
        G2_rate=body[[planar_rover.VX2, planar_rover.VY2]],
        theta=float(body[planar_rover.THETA]),
        omega=float(body[planar_rover.OMEGA]),
        s=float(body[planar_rover.SLIDE]),
        compression=float(memory[planar.COMPRESSION]),
        take_off=TakeOffRecord(
            time=float(memory[planar.TAKE_OFF_TIME]),
            G1=(float(memory[planar.TAKE_OFF_X]), float(memory[planar.TAKE_OFF_Y])),
            theta=float(memory[planar.TAKE_OFF_THETA]),
            highest=float(memory[planar.MAX_RISE]),
        ),
        energy_balance=EnergyBalance(
            initial=float(memory[planar.INITIAL_ENERGY]),
            input=float(memory[planar.INPUT]),
            dissipated=float(memory[planar.DISSIPATED]),
        ),
    )


def _energies_of(parts: ArrayLike, energy_balance: EnergyBalance) -> Energies:
    kinetic, gravity, axial, bending, spring = (float(part) for part in np.asarray(parts))
    return Energies(
        kinetic,
        gravity,
        axial,
        bending,
        spring,
        energy_balance.input,
        energy_balance.dissipated,
        energy_balance.initial,
    )


def _event_of(row: Array) -> Event:
    kind, time, rise, travel, variation, since, speed, tension = (float(value) for value in row)
    name, values = {
        planar.EVENT_TAKE_OFF: (PlantEvent.TAKE_OFF, {"speed": speed}),
        planar.EVENT_APEX: (PlantEvent.APEX, {"height": rise, "flight_time": since}),
        planar.EVENT_TOUCHDOWN: (
            PlantEvent.TOUCHDOWN,
            {
                "height": rise,
                "attitude_variation": variation,
                "travel": travel,
                "flight_time": since,
                "speed": speed,
            },
        ),
        planar.EVENT_BROKEN: (PlantEvent.TETHER_BROKEN, {"tension": tension}),
        planar.EVENT_DIVERGED: (PlantEvent.DIVERGED, {}),
    }[int(kind)]
    return Event(name, time, values)
