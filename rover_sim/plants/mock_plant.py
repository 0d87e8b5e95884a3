"""Mock plant: a kinematic plant that follows commands exactly, for integration tests.

It has the rover, winch and drives of a spatial scenario and needs no compiled code:

- The drum pays out at the commanded rate while its brake is released, between its two stops. It
  does not reel in against a tension above its motor's limit, and yields to the tether of a rover on
  the ground.
- The rover hangs vertically below the fairlead, at rest and level, and is on the level floor when
  the tether is long enough. Reeling in drags it below the fairlead before it lifts off.
- The wheels turn at the commanded rate, or accelerate by the commanded torque, and roll without
  slip on the ground. Backward, only the left wheel turns. A motor without a command is at rest.
- The nut moves to its setpoint at the commanded rate. When the latch trips, the rover flies
  vertically to the height of the spring's energy without losses, and lands where it took off.

The tether is inextensible, straight and unbreakable. It carries the rover and its own weight. On
the ground its share of the rover's weight falls to zero over the first decimetres of slack, as with
a sagging tether, so that tension control works. There are no boulders, relief, slopes or walls.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from msg_schemas import machine
from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_sim.plants.plant import (
    Energies,
    Event,
    FlywheelCommand,
    FlywheelRateCommand,
    Forces,
    JumpMotorCommand,
    Outcome,
    PlantCommand,
    StepResult,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)
from rover_sim.plants.saved_state import STATE, require_phase, restore
from rover_sim.scenarios.hardware import RoverSettings, WinchSettings, jump_height
from rover_sim.scenarios.scenario import AnyScenario, ScenarioError, SpatialScenario

_ARRIVED = 1e-12  # tolerance of rounding [m]
_UNLOADING_SLACK = 0.3  # at which the tether of a rover on the ground carries none of it [m]
_ACCELERATION_TIME = 0.1  # time constant of the IMU's response to a step of the speed [s]
_FULL_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class MockState:
    """State of the mock plant."""

    time: float  # [s]
    phase: PlantPhase
    length: float  # paid out [m]
    x: float  # of the tether's attachment, in map [m]
    y: float
    heading: float  # of base_link's x, from map's x towards y [rad]
    nut: float  # position as compression of the spring [m]
    payout_rate: float = 0.0  # [m/s]
    brake_released: bool = False
    speed: float = 0.0  # forward [m/s]
    acceleration: float = 0.0  # forward, as the IMU measures it [m/s^2]
    yaw_rate: float = 0.0  # [rad/s]
    height: float = 0.0  # above the take-off, in flight [m]
    climb_rate: float = 0.0  # in flight [m/s]
    apex_height: float = 0.0  # of the flight [m]
    wheel_angles: tuple[float, float] = (0.0, 0.0)  # left, right [rad]
    wheel_rates: tuple[float, float] = (0.0, 0.0)  # [rad/s]
    nut_rate: float = 0.0  # [m/s]


class MockPlant:
    """A plant without mechanics that follows commands exactly.

    Args:
        scenario: spatial, with a rover.

    Raises:
        ScenarioError: it is planar, or has no rover.
    """

    def __init__(self, scenario: AnyScenario) -> None:
        if not isinstance(scenario, SpatialScenario):
            raise ScenarioError(
                "model",
                scenario.model,
                "should be spatial for the mock plant, such as marius_hills",
            )
        if scenario.rover is None:
            raise ScenarioError(
                "rover", None, "the mock plant needs a scenario with a rover, such as marius_hills"
            )
        self.scenario = scenario
        self.rover: RoverSettings = scenario.rover
        wheels, drive = self.rover.wheels, self.rover.wheel_drive
        self._largest_wheel_rate = drive.motor.no_load_rate / drive.gear_ratio
        self.pitch = self.rover.jump_drive.lead / _FULL_TURN
        """Of the screw [m/rad]."""
        self.floor_drop = -(
            scenario.environment.floor_height
            + wheels.tip_radius
            - wheels.axle_z
            + self.rover.attachment[2]
        )
        """Depth of the attachment below the fairlead with the rover on the ground [m]."""

    # --- derived quantities ----------------------------------------------------------------------

    def initial_state(self) -> MockState:
        """Return the state at the start: hanging at the scenario's length, or on the ground."""
        start = self.scenario.start
        x, y = start.position if start.kind == "grounded" else (0.0, 0.0)
        state = MockState(
            time=0.0,
            phase=PlantPhase.HANGING,
            length=self.scenario.tether.length,
            x=x,
            y=y,
            heading=math.radians(start.heading),
            nut=-0.5 * self.rover.jump_drive.free_travel,
        )
        return self._constrained(state)

    def restored_state(self, values: Mapping[str, Any]) -> MockState:
        """Return a saved state of the mock plant of this scenario.

        Args:
            values: as from `saved_state.plain_state`.

        Raises:
            ScenarioError: a value is missing, not finite, or not one of this plant.
        """
        state = restore(MockState, values)
        require_phase(state.phase, (PlantPhase.HANGING, PlantPhase.GROUNDED, PlantPhase.FLIGHT))
        longest = self.scenario.tether.whole_length
        if not 0.0 < state.length <= longest:
            raise ScenarioError(
                f"{STATE}.length", state.length, f"should be above 0 and at most {longest:g} m"
            )
        return state

    def drop(self, state: MockState) -> float:
        """Return the depth of the attachment below the fairlead [m]."""
        if state.phase is PlantPhase.HANGING:
            return state.length
        return self.floor_drop - state.height

    def tension(self, state: MockState) -> tuple[float, float]:
        """Return the tension at the fairlead and at the rover [N]."""
        scenario = self.scenario
        rover = self._load_share(state) * self._weight
        tether = scenario.gravity * scenario.tether.section.line_density * state.length
        return rover + tether, rover

    def _load_share(self, state: MockState) -> float:
        """Return the share of the rover's weight that the tether carries."""
        if state.phase is PlantPhase.HANGING:
            return 1.0
        return min(max(1.0 - (state.length - self._chord(state)) / _UNLOADING_SLACK, 0.0), 1.0)

    @property
    def _weight(self) -> float:
        """Weight of the rover [N]."""
        return self.rover.mass * self.scenario.gravity

    def _chord(self, state: MockState) -> float:
        """Return the distance from the fairlead to the attachment [m]."""
        return math.hypot(state.x, state.y, self.drop(state))

    def slide(self, state: MockState) -> float:
        """Return the distance of Body 2 above Body 1 [m]."""
        return self.rover.slider.free_length - max(state.nut, 0.0)

    def energies(self, state: MockState) -> Energies:
        """Return the bodies' energies; the input is set so that the balance closes."""
        rover, gravity = self.rover, self.scenario.gravity
        rate = self._vertical_rate(state)
        kinetic = 0.5 * rover.mass * (state.speed**2 + rate**2)
        height = -self.drop(state) - rover.attachment[2]
        height += rover.m2 / rover.mass * self.slide(state)
        potential = rover.mass * gravity * height
        spring = 0.5 * rover.slider.spring_rate * max(state.nut, 0.0) ** 2
        stored = kinetic + potential + spring
        return Energies(kinetic, potential, 0.0, 0.0, spring, input=stored)

    # --- a step ----------------------------------------------------------------------------------

    def step(
        self, state: MockState, command: PlantCommand, dt: float
    ) -> tuple[MockState, StepResult]:
        """Advance by one control tick; see `plant.Plant.step`."""
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt = {dt}: must be finite and above 0 s")
        events: list[Event] = []
        after = self._move_drum(state, command, dt, events)
        after = self._turn_wheels(after, command, dt)
        after = self._move_nut(after, command, dt, events)
        if after.phase is PlantPhase.FLIGHT:
            after = self._fly(after, dt, events)
        else:
            after = self._drive(after, dt, events)
        after = replace(after, time=state.time + dt)
        return after, self._result(after, tuple(events))

    def _move_drum(
        self, state: MockState, command: PlantCommand, dt: float, events: list[Event]
    ) -> MockState:
        winch, requested = self.scenario.winch, command.winch
        if winch is None or requested is None or not requested.brake_released:
            return replace(state, payout_rate=0.0, brake_released=False)
        max_length = self.scenario.tether.whole_length
        rate = self._drum_rate(state, winch, requested, dt)
        unlimited = state.length + rate * dt
        length = min(max(unlimited, winch.min_length), max_length)
        if length != unlimited:
            rate = (length - state.length) / dt
            if length != state.length:
                side = math.copysign(1.0, rate)
                values = {"side": side, "tension": self.tension(state)[0]}
                events.append(Event(PlantEvent.DRUM_STOP, state.time + dt, values))
        return replace(state, length=length, payout_rate=rate, brake_released=True)

    def _drum_rate(
        self, state: MockState, winch: WinchSettings, requested: WinchCommand, dt: float
    ) -> float:
        """Return the payout rate under the motor's tension limit and dry friction [m/s]."""
        fairlead, rover = self.tension(state)
        friction, limit = winch.friction.breakaway / winch.radius, requested.max_tension
        if self._weight == 0.0 or limit - friction >= fairlead - rover + self._weight:
            return requested.rate
        if state.phase is not PlantPhase.GROUNDED:
            return max(requested.rate, 0.0)
        if requested.rate > 0.0:
            return requested.rate if fairlead + limit > friction else 0.0
        # The drum is at rest where the tension equals the motor's limit within the dry friction.
        tension = min(max(fairlead, limit - friction), limit + friction)
        if tension == fairlead:
            return 0.0
        share = max(tension - (fairlead - rover), 0.0) / self._weight
        balanced = self._chord(state) + (1.0 - share) * _UNLOADING_SLACK
        return min(max((balanced - state.length) / dt, requested.rate), machine.MAX_PAYOUT_RATE)

    def _turn_wheels(self, state: MockState, command: PlantCommand, dt: float) -> MockState:
        """Turn the wheels; the right one has a ratchet and turns forward only."""
        requested, before = command.wheel, state.wheel_rates[0]
        rate = 0.0
        if isinstance(requested, WheelRateCommand):
            rate = requested.rate
        elif isinstance(requested, WheelTorqueCommand):
            rate = before + requested.torque / self.rover.wheel_drive.wheel_inertia * dt
            rate = min(max(rate, -self._largest_wheel_rate), self._largest_wheel_rate)
        rates = (rate, max(rate, 0.0))
        left, right = state.wheel_angles
        return replace(
            state, wheel_rates=rates, wheel_angles=(left + rates[0] * dt, right + rates[1] * dt)
        )

    def _move_nut(
        self, state: MockState, command: PlantCommand, dt: float, events: list[Event]
    ) -> MockState:
        requested, drive = command.jump, self.rover.jump_drive
        if isinstance(requested, FlywheelCommand | FlywheelRateCommand):
            limit = drive.motor.no_load_rate
            if isinstance(requested, FlywheelCommand):
                flywheel = state.nut_rate / self.pitch + requested.torque / drive.inertia * dt
            else:
                flywheel = requested.rate
            rate = min(max(flywheel, -limit), limit) * self.pitch
            nut = min(max(state.nut + rate * dt, -drive.free_travel), 0.0)
            return replace(state, nut=nut, nut_rate=(nut - state.nut) / dt)
        if not isinstance(requested, JumpMotorCommand):
            return replace(state, nut_rate=0.0)
        distance = requested.compression - state.nut
        moved = math.copysign(min(abs(distance), requested.rate * dt), distance)
        nut = state.nut + moved
        arrived = abs(requested.compression - nut) <= _ARRIVED
        if not (requested.trips and requested.compression > 0.0 and arrived):
            return replace(state, nut=nut, nut_rate=moved / dt)
        when = state.time + abs(moved) / requested.rate
        gravity = self.scenario.gravity
        height = jump_height(self.rover, gravity, requested.compression) if gravity > 0.0 else 0.0
        climb = math.sqrt(2.0 * gravity * height)
        jumps = state.phase is PlantPhase.GROUNDED and climb > 0.0
        events.append(Event(PlantEvent.LATCH_RELEASED, when, {"speed": climb if jumps else 0.0}))
        released = replace(state, nut=0.0, nut_rate=0.0)
        if not jumps:
            return released
        events.append(Event(PlantEvent.TAKE_OFF, when, {"speed": climb}))
        return replace(
            released, phase=PlantPhase.FLIGHT, climb_rate=climb, height=0.0, apex_height=height,
            speed=0.0, acceleration=0.0, yaw_rate=0.0,
        )  # fmt: skip

    def _fly(self, state: MockState, dt: float, events: list[Event]) -> MockState:
        gravity = self.scenario.gravity
        climb = state.climb_rate - gravity * dt
        height = state.height + 0.5 * (state.climb_rate + climb) * dt
        if state.climb_rate > 0.0 >= climb:
            when = state.time + state.climb_rate / gravity
            events.append(Event(PlantEvent.APEX, when, {"height": state.apex_height}))
        if height > 0.0:
            return replace(state, climb_rate=climb, height=height)
        values = {"height": state.apex_height, "speed": -climb, "load": 0.0}
        events.append(Event(PlantEvent.TOUCHDOWN, state.time + dt, values))
        landed = replace(
            state, phase=PlantPhase.GROUNDED, climb_rate=0.0, height=0.0, apex_height=0.0
        )
        return self._constrained(landed)

    def _drive(self, state: MockState, dt: float, events: list[Event]) -> MockState:
        """Roll the rover on the ground, within reach of the tether."""
        wheels = self.rover.wheels
        speed = yaw_rate = 0.0
        if state.phase is PlantPhase.GROUNDED:
            left, right = state.wheel_rates
            speed = 0.5 * wheels.tip_radius * (left + right)
            yaw_rate = wheels.tip_radius * (right - left) / wheels.track_width
        # The attachment is above or near base_link's origin: it moves with the same velocity.
        middle = state.heading + 0.5 * yaw_rate * dt
        moved = replace(
            state,
            x=state.x + speed * dt * math.cos(middle),
            y=state.y + speed * dt * math.sin(middle),
            heading=math.remainder(state.heading + yaw_rate * dt, _FULL_TURN),
            speed=speed,
            yaw_rate=yaw_rate,
        )
        constrained = self._constrained(moved)
        change = (constrained.speed - state.speed) / dt - state.acceleration
        share = -math.expm1(-dt / _ACCELERATION_TIME)
        after = replace(constrained, acceleration=state.acceleration + share * change)
        when, rate = state.time + dt, abs(state.payout_rate)
        if state.phase is PlantPhase.HANGING and after.phase is PlantPhase.GROUNDED:
            load = self.rover.mass * self.scenario.gravity
            values = {"height": 0.0, "speed": rate, "load": load}
            events.append(Event(PlantEvent.TOUCHDOWN, when, values))
        elif state.phase is PlantPhase.GROUNDED and after.phase is PlantPhase.HANGING:
            events.append(Event(PlantEvent.TAKE_OFF, when, {"speed": rate}))
        return after

    def _constrained(self, state: MockState) -> MockState:
        """Return the state within reach of the tether: on the ground, or below the fairlead."""
        if state.length < self.floor_drop:
            return replace(state, phase=PlantPhase.HANGING, x=0.0, y=0.0, speed=0.0, yaw_rate=0.0)
        reach = math.sqrt(state.length**2 - self.floor_drop**2)
        aside = math.hypot(state.x, state.y)
        if aside <= reach:
            return replace(state, phase=PlantPhase.GROUNDED)
        share = reach / aside
        return replace(
            state, phase=PlantPhase.GROUNDED, x=share * state.x, y=share * state.y, speed=0.0
        )

    def _vertical_rate(self, state: MockState) -> float:
        return -state.payout_rate if state.phase is PlantPhase.HANGING else state.climb_rate

    def velocity(self, state: MockState) -> tuple[float, float, float]:
        """Return the velocity of Body 1 in its own axes [m/s]."""
        return state.speed, 0.0, self._vertical_rate(state)

    def _result(self, state: MockState, events: tuple[Event, ...]) -> StepResult:
        fairlead, rover = self.tension(state)
        forces = Forces(fairlead_tension=fairlead, rover_tension=rover)
        return StepResult(
            Outcome.CONVERGED, self.energies(state), 0.0, 0, math.inf, events, fairlead, forces
        )
