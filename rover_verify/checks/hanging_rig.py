"""Hanging rover under its controllers: spatial plant, sensor errors, winch, hanging controller.

Plant, sensor errors, the winch's controller and the rover's are stepped together at 50 Hz, without
ROS. That is the rate at which the rover's drives are commanded; IMU and winch run twice as fast in
the machine, where each loop is quicker by 10 ms. At 100 Hz swings end the same to 0.001 deg, in
twice the time. Only the checks use the ground truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.events import EventReport
from msg_schemas.machine import SMEAR, WINCH_TO_LENGTH
from msg_schemas.refusal import Refusal
from msg_schemas.samples import ImuSample, JointSample, JointValue, Sample, WrenchSample
from rover_control.descent_profile import Stop
from rover_control.hanging_controller import (
    ActuatorCommands,
    Exposure,
    HangingController,
    HangingControllerParameters,
)
from rover_control.hanging_rover import HangingParameters
from rover_sim import (
    Command,
    FlywheelCommand,
    Outcome,
    SpatialPlant,
    SpatialScenario,
    SpatialState,
    WheelRateCommand,
    load_scenario,
    load_spatial,
)
from rover_sim.physics import spatial_rover
from rover_sim.spatial_interface import SpatialInterface
from rover_verify.checks.machine_off import machine_off
from rover_verify.checks.winch_spatial import winch_command
from tether_winch.servo import DriveCommand, ServoParameters
from tether_winch.winch import Winch, WinchParameters

TICK_NS = 20_000_000  # of plant, sensors and controllers
TICK = TICK_NS * 1e-9
EXPOSURE_TICKS = 5  # of the camera, 0.1 s
_SENSOR_TOPICS = (
    topics.IMU,
    topics.WINCH_STATE,
    topics.LOAD_CELL,
    topics.MOTOR_CURRENTS,
    topics.WHEEL_STATE,
    topics.FLYWHEEL_STATE,
    topics.CAMERA,
)
# Winch parameters of a descent: from 2 m on, with range for the trim.
WINCH = WinchParameters(servo=ServoParameters(trim_rate=0.3, shortest_length=1.4, end_zone=0.3))
# Coarser than in the scenario; the swing frequency keeps five digits.
_MESH: dict[str, object] = {
    "tether.element_length": 0.9,
    "winch.min_length": 1.4,
    "integration.h": 5.0e-3,
}


@dataclass(frozen=True)
class Start:
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
            **machine_off(_nominal(), self.mass, self.friction),
        }
        if self.swivel_friction is not None:
            changed["tether.swivel_friction"] = self.swivel_friction
        return {**_MESH, **changed}


@cache
def _nominal() -> SpatialScenario:
    return load_spatial("free_hang")


class TrueSwing(NamedTuple):
    """True swing of the rover."""

    major: float  # [rad]
    minor: float
    tilt: tuple[float, float]  # against the tether's end, about base_link x and y [rad]
    twist: float  # heading about the plumb line [rad]


class Picture(NamedTuple):
    """True data of a picture."""

    exposure: Exposure
    smear: float  # of the true picture [px]
    camera_rate: float  # largest true rate during the exposure [rad/s]
    tilt: tuple[float, float]  # RMS during the exposure [rad]


@dataclass
class HangingFlight:
    """A rover on the tether, with its controllers.

    Args:
        start: how it starts.
        parameters: of the rover's controller.
    """

    start: Start
    parameters: HangingControllerParameters = field(default_factory=HangingControllerParameters)

    def __post_init__(self) -> None:
        self.plant = SpatialPlant(load_scenario("free_hang", self.start.overrides()))
        self.state: SpatialState = self.plant.initial_state()
        self.interface = SpatialInterface(self.plant, self.start.seed)
        self.interface.restart(self.state, 0)
        self.winch = Winch(WINCH)
        self.rover = HangingController(self.parameters)
        self.ticks = 0
        self.pictures: list[Picture] = []
        self.changes: list[tuple[float, EventReport]] = []
        self.refusals: list[str] = []
        self.spent: dict[str, float] = {}  # first time outside its budget, by axis [s]
        self._drive: DriveCommand | None = None
        self._orders = ActuatorCommands(None, None, None, None, None)
        self._mode = ""
        self._open: list[tuple[Exposure, int, list[float], list[tuple[float, float]]]] = []

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.ticks * TICK

    @property
    def now_ns(self) -> int:
        """Simulated time."""
        return self.ticks * TICK_NS

    def begin(self) -> None:
        """Run until the sensors are received, and arm the winch."""
        for _ in range(20):
            self.tick()
        self.winch.rearm(self.now_ns)
        for _ in range(20):
            self.tick()

    def request(self, depth: float, *, observes: bool = True, rate: float = 0.0) -> None:
        """Request a stop of the controller."""
        self.rover.request(Stop(depth, observes, rate), self.now_ns)

    def disturb(self, angle: float, heading: float) -> None:
        """Disturb the rover: add the velocity of a swing amplitude [rad].

        Tether and rover turn about the fairlead as one.
        """
        frequency = self.rover.parameters.hanging.swing_frequency(self.state.length)
        outward = np.array([math.cos(heading), math.sin(heading), 0.0])
        spin = angle * frequency * np.cross([0.0, 0.0, -1.0], outward)
        state = self.state
        body = state.body.copy()
        for at, place in (
            (spatial_rover.VELOCITY1, state.G1),
            (spatial_rover.VELOCITY2, state.G2),
        ):
            body[at : at + 3] += np.cross(spin, place)
        body[spatial_rover.SPIN : spatial_rover.SPIN + 3] += state.rotation.T @ spin
        fairlead_slope = state.fairlead_slope.copy()
        fairlead_slope[1] += np.cross(spin, fairlead_slope[0])
        self.state = replace(
            state,
            node_rates=state.node_rates + np.cross(spin, state.nodes),
            fairlead_slope=fairlead_slope,
            body=body,
        )

    def run(self, duration: float) -> None:
        """Run for a duration [s]."""
        for _ in range(round(duration / TICK)):
            self.tick()

    def tick(self) -> None:
        """One tick: plant, sensors, both controllers.

        Raises:
            RuntimeError: the plant cannot go on.
        """
        self.state, result = self.plant.step(self.state, self._command(), TICK)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.time:.3g} s")
        self.ticks += 1
        self.interface.measure(self.state, self.now_ns, result)
        samples = dict(self.interface.samples(_SENSOR_TOPICS))
        self._on_samples(samples)
        self._drive = self.winch.step(self.now_ns)
        self.winch.take_transitions()
        if self.winch.mode.value != self._mode:
            self._mode = self.winch.mode.value
            self.rover.on_winch_mode(self._mode)
        self._control()
        self._watch()

    def _control(self) -> None:
        orders = self.rover.step(self.now_ns)
        self.changes += [(self.time, change) for change in self.rover.take_changes()]
        try:
            if orders.winch is not None:
                value = JointValue(orders.winch.length, orders.winch.rate, 0.0)
                sample = JointSample(self.now_ns, {WINCH_TO_LENGTH: value})
                self.winch.request(sample, self.now_ns)
            if orders.trim is not None:
                self.winch.trim(orders.trim, self.now_ns)
        except Refusal as refusal:
            self.refusals.append(f"{self.time:.2f} s: {refusal}")
        if orders.exposure is not None:
            self._open.append((orders.exposure, self.ticks + EXPOSURE_TICKS, [], []))
        self._orders = orders

    def _command(self) -> Command:
        winch = None if self._drive is None else winch_command(self._drive)
        orders = self._orders
        wheel = None
        if orders.wheel_rate is not None:
            wheel = WheelRateCommand(orders.wheel_rate, self.parameters.rotors.wheel_torque)
        jump = None
        if orders.flywheel_torque is not None:
            jump = FlywheelCommand(orders.flywheel_torque)
        return Command(jump, winch, wheel)

    def _on_samples(self, samples: dict[str, Sample]) -> None:
        now = self.now_ns
        drum, cell = samples[topics.WINCH_STATE], samples[topics.LOAD_CELL]
        currents, imu = samples[topics.MOTOR_CURRENTS], samples[topics.IMU]
        wheels, flywheel = samples[topics.WHEEL_STATE], samples[topics.FLYWHEEL_STATE]
        camera = samples[topics.CAMERA]
        assert isinstance(drum, JointSample)
        assert isinstance(cell, WrenchSample)
        assert isinstance(currents, JointSample)
        assert isinstance(imu, ImuSample)
        assert isinstance(wheels, JointSample)
        assert isinstance(flywheel, JointSample)
        assert isinstance(camera, JointSample)
        self.winch.on_drum(drum, now)
        self.winch.on_load_cell(cell, now)
        self.winch.on_currents(currents, now)
        self.rover.on_drum(drum, now)
        self.rover.on_load_cell(cell, now)
        self.rover.on_wheels(wheels, now)
        self.rover.on_flywheel(flywheel, now)
        self.rover.on_imu(imu, now)
        self.rover.on_camera(camera)
        self._smear = camera.joints[SMEAR].position

    # --- ground truth -----------------------------------------------------------------------------

    def _watch(self) -> None:
        state = self.state
        rotors = self.parameters.rotors
        centre = -0.5 * self.plant.model.jump.free_travel
        travel = abs(state.nut - centre) / self.plant.model.jump.pitch
        over = {
            self.rover.wheels.axis.name: max(map(abs, state.wheel_rates))
            > (1.0 + rotors.wheel_rate_fraction) * abs(rotors.wheel_pump_bias),
            self.rover.flywheel.axis.name: abs(state.flywheel_rate) > rotors.flywheel_rate
            or travel > rotors.screw_travel,
        }
        for name, is_over in over.items():
            if is_over:
                self.spent.setdefault(name, self.time)
        still_open = []
        for exposure, closes, rates, tilts in self._open:
            rates.append(float(np.linalg.norm(state.omega)))
            tilts.append(self.true_tilt())
            if self.ticks < closes:
                still_open.append((exposure, closes, rates, tilts))
                continue
            rms = np.sqrt(np.mean(np.square(tilts), axis=0))
            self.pictures.append(
                Picture(exposure, self._smear, max(rates), (float(rms[0]), float(rms[1])))
            )
        self._open = still_open

    def true_tilt(self) -> tuple[float, float]:
        """True tilt against the tether's end, about base_link x and y [rad]."""
        tangent = self.state.nodes[-1, 1]
        up = -self.state.rotation.T @ (tangent / np.linalg.norm(tangent))
        return (math.atan2(float(up[1]), float(up[2])), math.atan2(-float(up[0]), float(up[2])))

    def true_momentum(self) -> tuple[float, float]:
        """Momenta about the plumb line [N m s]: of the swing, and of the spin with the rotors."""
        rover = self.plant.scenario.rover
        assert rover is not None
        state = self.state
        swing = sum(
            mass * float(place[0] * rate[1] - place[1] * rate[0])
            for mass, place, rate in (
                (rover.m1, state.G1, state.G1_rate),
                (rover.m2, state.G2, state.G2_rate),
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
        place: NDArray[np.float64] = (1.0 - share) * state.G1 + share * state.G2
        rate = (1.0 - share) * state.G1_rate + share * state.G2_rate
        reach = -float(place[2])
        frequency = math.sqrt(self.plant.scenario.gravity / reach)
        z = complex(place[0], place[1]) / reach
        turned = complex(rate[0], rate[1]) / (1j * frequency * reach)
        ahead, back = abs(0.5 * (z + turned)), abs(0.5 * (z - turned))
        x, y = state.rotation[:2, 0]
        return TrueSwing(ahead + back, ahead - back, self.true_tilt(), math.atan2(y, x))
