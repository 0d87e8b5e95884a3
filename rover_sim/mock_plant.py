"""A plant without mechanics: what is commanded happens, at once and exactly. For plumbing tests.

It has the machine of a spatial scenario and the same drives, and it needs no compiled code:

- the drum pays out at the commanded rate while its brake is released, between its two stops; it
  reels nothing in that pulls more than its motor may, and gives way to the tether of a rover that
  stands;
- the rover hangs straight below the fairlead, at rest and level, and stands on a level floor once
  the tether reaches that far; reeled in from aside it is dragged to below the fairlead first;
- wheels turn at the commanded rate, or as their torque says, and roll without slip while the rover
  stands; backward the left one alone turns; a motor without command stands still;
- the nut goes to its setpoint at the commanded rate; when the latch trips the rover flies straight
  up, as high as the spring's energy brings it without losses, and comes down where it stood.

The tether is inextensible and straight. It carries the rover and its own weight; where the rover
stands, it lets go of the rover's weight over the first decimetres of slack, as one that sags does,
so that a tension can be held. It never breaks. Boulders, relief, slopes and walls are not there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from msg_schemas.machine import MAX_PAYOUT_RATE
from rover_sim.hardware import Rover, Winch, jump_height
from rover_sim.plant import (
    Command,
    Energies,
    Event,
    FlywheelCommand,
    Forces,
    JumpMotorCommand,
    Outcome,
    Phase,
    StepResult,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)
from rover_sim.scenario import AnyScenario, ScenarioError, SpatialScenario

_ARRIVED = 1e-12  # [m], of rounding
_GIVE = 0.3  # slack with which a tether of a standing rover carries nothing of it any more [m]
_FELT = 0.1  # in which an IMU feels a sudden change of speed, so that nobody misses it [s]
_FULL_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class MockState:
    """Where everything stands."""

    time: float  # [s]
    phase: Phase
    length: float  # paid out [m]
    x: float  # of the tether's attachment, in map [m]
    y: float
    heading: float  # of base_link's x, from map's x towards y [rad]
    nut: float  # counted as compression [m]
    payout_rate: float = 0.0  # [m/s]
    brake_released: bool = False
    speed: float = 0.0  # forward [m/s]
    acceleration: float = 0.0  # forward, as an IMU feels it [m/s^2]
    yaw_rate: float = 0.0  # [rad/s]
    height: float = 0.0  # over where it took off, in flight [m]
    climb: float = 0.0  # in flight [m/s]
    top: float = 0.0  # of the flight [m]
    wheel_angles: tuple[float, float] = (0.0, 0.0)  # left, right [rad]
    wheel_rates: tuple[float, float] = (0.0, 0.0)  # [rad/s]
    nut_rate: float = 0.0  # [m/s]


class MockPlant:
    """Follows commands perfectly.

    Args:
        scenario: whose machine it has: spatial, with a rover.

    Raises:
        ScenarioError: it is planar, or has no rover.
    """

    def __init__(self, scenario: AnyScenario) -> None:
        if not isinstance(scenario, SpatialScenario):
            raise ScenarioError(
                "model", scenario.model, "the mock plant plays a spatial scenario, as marius_hills"
            )
        if scenario.rover is None:
            raise ScenarioError(
                "rover", None, "the mock plant plays a scenario with a rover, as marius_hills"
            )
        self.scenario = scenario
        self.rover: Rover = scenario.rover
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
        """How far below the fairlead the attachment of a rover is that stands [m]."""

    # --- what a state means ----------------------------------------------------------------------

    def initial_state(self) -> MockState:
        """Hanging at the scenario's length, or standing where it starts."""
        start = self.scenario.start
        x, y = start.position if start.kind == "grounded" else (0.0, 0.0)
        state = MockState(
            time=0.0,
            phase=Phase.HANGING,
            length=self.scenario.tether.length,
            x=x,
            y=y,
            heading=math.radians(start.heading),
            nut=-0.5 * self.rover.jump_drive.free_travel,
        )
        return self._held(state)

    def drop(self, state: MockState) -> float:
        """How far below the fairlead the attachment is [m]."""
        if state.phase is Phase.HANGING:
            return state.length
        return self.floor_drop - state.height

    def tension(self, state: MockState) -> tuple[float, float]:
        """At the fairlead and at the rover [N]."""
        scenario = self.scenario
        below = self._carried(state) * self._weight
        own = scenario.gravity * scenario.tether.section.line_density * state.length
        return below + own, below

    def _carried(self, state: MockState) -> float:
        """Share of the rover's weight that the tether carries."""
        if state.phase is Phase.HANGING:
            return 1.0
        return min(max(1.0 - (state.length - self._chord(state)) / _GIVE, 0.0), 1.0)

    @property
    def _weight(self) -> float:
        """Of the rover [N]."""
        return self.rover.mass * self.scenario.gravity

    def _chord(self, state: MockState) -> float:
        """From the fairlead to the attachment [m]."""
        return math.hypot(state.x, state.y, self.drop(state))

    def slide(self, state: MockState) -> float:
        """Of Body 2 above Body 1 [m]."""
        return self.rover.slider.free_length - max(state.nut, 0.0)

    def energies(self, state: MockState) -> Energies:
        """Energies of the bodies; what the drives put in is what they became."""
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

    def step(self, state: MockState, command: Command, dt: float) -> tuple[MockState, StepResult]:
        """Advance by one control tick; see `plant.Plant.step`."""
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt = {dt}: must be finite and above 0 s")
        events: list[Event] = []
        after = self._paid_out(state, command, dt, events)
        after = self._turned(after, command, dt)
        after = self._nut_moved(after, command, dt, events)
        if after.phase is Phase.FLIGHT:
            after = self._flown(after, dt, events)
        else:
            after = self._driven(after, dt, events)
        after = replace(after, time=state.time + dt)
        return after, self._result(after, tuple(events))

    def _paid_out(
        self, state: MockState, command: Command, dt: float, events: list[Event]
    ) -> MockState:
        winch, wanted = self.scenario.winch, command.winch
        if winch is None or wanted is None or not wanted.brake_released:
            return replace(state, payout_rate=0.0, brake_released=False)
        whole = self.scenario.tether.whole_length
        rate = self._yielding(state, winch, wanted, dt)
        free = state.length + rate * dt
        length = min(max(free, winch.min_length), whole)
        if length != free:
            rate = (length - state.length) / dt
            if length != state.length:
                side = math.copysign(1.0, rate)
                values = {"side": side, "tension": self.tension(state)[0]}
                events.append(Event("drum_stop", state.time + dt, values))
        return replace(state, length=length, payout_rate=rate, brake_released=True)

    def _yielding(self, state: MockState, winch: Winch, wanted: WinchCommand, dt: float) -> float:
        """Rate of a drum whose motor gives no more than it may, and that has dry friction [m/s]."""
        fairlead, rover = self.tension(state)
        friction, most = winch.friction.breakaway / winch.radius, wanted.max_tension
        if self._weight == 0.0 or most - friction >= fairlead - rover + self._weight:
            return wanted.rate
        if state.phase is not Phase.GROUNDED:
            return max(wanted.rate, 0.0)
        if wanted.rate > 0.0:
            return wanted.rate if fairlead + most > friction else 0.0
        # The drum stands where the tether's pull is the motor's, within what the friction holds.
        pull = min(max(fairlead, most - friction), most + friction)
        if pull == fairlead:
            return 0.0
        share = max(pull - (fairlead - rover), 0.0) / self._weight
        balanced = self._chord(state) + (1.0 - share) * _GIVE
        return min(max((balanced - state.length) / dt, wanted.rate), MAX_PAYOUT_RATE)

    def _turned(self, state: MockState, command: Command, dt: float) -> MockState:
        """The wheels, as the ratchets let them."""
        wanted, before = command.wheel, state.wheel_rates[0]
        rate = 0.0
        if isinstance(wanted, WheelRateCommand):
            rate = wanted.rate
        elif isinstance(wanted, WheelTorqueCommand):
            rate = before + wanted.torque / self.rover.wheel_drive.wheel_inertia * dt
            rate = min(max(rate, -self._largest_wheel_rate), self._largest_wheel_rate)
        rates = (rate, max(rate, 0.0))
        left, right = state.wheel_angles
        return replace(
            state, wheel_rates=rates, wheel_angles=(left + rates[0] * dt, right + rates[1] * dt)
        )

    def _nut_moved(
        self, state: MockState, command: Command, dt: float, events: list[Event]
    ) -> MockState:
        wanted, drive = command.jump, self.rover.jump_drive
        if isinstance(wanted, FlywheelCommand):
            most = drive.motor.no_load_rate
            flywheel = state.nut_rate / self.pitch + wanted.torque / drive.inertia * dt
            rate = min(max(flywheel, -most), most) * self.pitch
            nut = min(max(state.nut + rate * dt, -drive.free_travel), 0.0)
            return replace(state, nut=nut, nut_rate=(nut - state.nut) / dt)
        if not isinstance(wanted, JumpMotorCommand):
            return replace(state, nut_rate=0.0)
        way = wanted.compression - state.nut
        moved = math.copysign(min(abs(way), wanted.rate * dt), way)
        nut = state.nut + moved
        arrived = abs(wanted.compression - nut) <= _ARRIVED
        if not (wanted.trips and wanted.compression > 0.0 and arrived):
            return replace(state, nut=nut, nut_rate=moved / dt)
        when = state.time + abs(moved) / wanted.rate
        gravity = self.scenario.gravity
        height = jump_height(self.rover, gravity, wanted.compression) if gravity > 0.0 else 0.0
        climb = math.sqrt(2.0 * gravity * height)
        jumps = state.phase is Phase.GROUNDED and climb > 0.0
        events.append(Event("latch_released", when, {"speed": climb if jumps else 0.0}))
        released = replace(state, nut=0.0, nut_rate=0.0)
        if not jumps:
            return released
        events.append(Event("take_off", when, {"speed": climb}))
        return replace(
            released, phase=Phase.FLIGHT, climb=climb, height=0.0, top=height, speed=0.0,
            acceleration=0.0, yaw_rate=0.0,
        )  # fmt: skip

    def _flown(self, state: MockState, dt: float, events: list[Event]) -> MockState:
        gravity = self.scenario.gravity
        climb = state.climb - gravity * dt
        height = state.height + 0.5 * (state.climb + climb) * dt
        if state.climb > 0.0 >= climb:
            when = state.time + state.climb / gravity
            events.append(Event("apex", when, {"height": state.top}))
        if height > 0.0:
            return replace(state, climb=climb, height=height)
        values = {"height": state.top, "speed": -climb, "load": 0.0}
        events.append(Event("touchdown", state.time + dt, values))
        landed = replace(state, phase=Phase.GROUNDED, climb=0.0, height=0.0, top=0.0)
        return self._held(landed)

    def _driven(self, state: MockState, dt: float, events: list[Event]) -> MockState:
        """Rolled on by the wheels where it stands, and held by the tether."""
        wheels = self.rover.wheels
        speed = yaw_rate = 0.0
        if state.phase is Phase.GROUNDED:
            left, right = state.wheel_rates
            speed = 0.5 * wheels.tip_radius * (left + right)
            yaw_rate = wheels.tip_radius * (right - left) / wheels.track_width
        # The attachment lies above base_link's origin or not far from it: it takes the same way.
        middle = state.heading + 0.5 * yaw_rate * dt
        moved = replace(
            state,
            x=state.x + speed * dt * math.cos(middle),
            y=state.y + speed * dt * math.sin(middle),
            heading=math.remainder(state.heading + yaw_rate * dt, _FULL_TURN),
            speed=speed,
            yaw_rate=yaw_rate,
        )
        held = self._held(moved)
        change = (held.speed - state.speed) / dt - state.acceleration
        share = -math.expm1(-dt / _FELT)
        after = replace(held, acceleration=state.acceleration + share * change)
        when, rate = state.time + dt, abs(state.payout_rate)
        if state.phase is Phase.HANGING and after.phase is Phase.GROUNDED:
            load = self.rover.mass * self.scenario.gravity
            values = {"height": 0.0, "speed": rate, "load": load}
            events.append(Event("touchdown", when, values))
        elif state.phase is Phase.GROUNDED and after.phase is Phase.HANGING:
            events.append(Event("take_off", when, {"speed": rate}))
        return after

    def _held(self, state: MockState) -> MockState:
        """Standing as far from the fairlead as the tether lets it, or hanging below it."""
        if state.length < self.floor_drop:
            return replace(state, phase=Phase.HANGING, x=0.0, y=0.0, speed=0.0, yaw_rate=0.0)
        reach = math.sqrt(state.length**2 - self.floor_drop**2)
        aside = math.hypot(state.x, state.y)
        if aside <= reach:
            return replace(state, phase=Phase.GROUNDED)
        share = reach / aside
        return replace(state, phase=Phase.GROUNDED, x=share * state.x, y=share * state.y, speed=0.0)

    def _vertical_rate(self, state: MockState) -> float:
        return -state.payout_rate if state.phase is Phase.HANGING else state.climb

    def velocity(self, state: MockState) -> tuple[float, float, float]:
        """Of Body 1 in its own axes [m/s]."""
        return state.speed, 0.0, self._vertical_rate(state)

    def _result(self, state: MockState, events: tuple[Event, ...]) -> StepResult:
        fairlead, rover = self.tension(state)
        forces = Forces(
            fairlead=(0.0, 0.0, -fairlead),
            fairlead_tension=fairlead,
            rover_tension=rover,
            drum_stuck=not state.brake_released,
        )
        return StepResult(
            Outcome.CONVERGED, self.energies(state), 0.0, 0, math.inf, events, fairlead, forces
        )
