"""The jumping rover with its controller: spatial plant, real sensors, jump controller. Without ROS.

Plant and sensors run at 100 Hz, the controller at 20 Hz like its node. The machine may deviate from
the controller's parameters: spring, stroke at which the latch trips, floor. Only the checks use the
ground truth.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from msg_schemas import topics
from msg_schemas.events import PlantEvent
from msg_schemas.machine import JUMP_HEIGHT, PAYOUT
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import Refusal
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    JointValue,
    OdometrySample,
    WrenchSample,
)
from rover_control.jump import Jump, JumpRecord, JumpSettings
from rover_control.jump_prediction import Prediction, PredictionParameters
from rover_control.jump_predictor import JumpPredictor
from rover_control.jump_sequence import NutCommand, Transition
from rover_sim import Command, Event, JumpMotorCommand, Outcome, SpatialPlant, load_scenario
from rover_sim.spatial_interface import SpatialInterface

TICK_NS = 10_000_000
TICK = TICK_NS * 1e-9
_EVERY = 5  # ticks per step of the controller
_SENSOR_TOPICS = (topics.IMU, topics.CONTACT, topics.JUMP_MOTOR_STATE, topics.ROVER_LOAD_CELL)
_FLOOR = 6.0  # depth below the fairlead [m]
_ATTACHMENT = 0.43  # height of the tether attachment above the floor [m]


@dataclass(frozen=True)
class Stand:
    """Place and ground on which the rover stands."""

    away: float = 2.0  # distance from the plumb line, along x [m]
    heading: float = 0.0  # [rad]
    slope: float = 0.0  # of the floor [rad]
    downhill: float = 0.0  # downhill direction, from x towards y [rad]
    slack: float = 0.8  # tether length beyond the chord [m]
    spring: float = 1.0  # true spring rate over the nominal one

    def overrides(self) -> dict[str, object]:
        """Overrides of the scenario."""
        drop = self.away * math.tan(self.slope) * math.cos(self.downhill)
        chord = math.hypot(self.away, _FLOOR + drop - _ATTACHMENT)
        return {
            "environment.relief": None,
            "environment.boulders": None,
            "environment.floor": {
                "height": -_FLOOR,
                "slope": round(math.degrees(self.slope), 6),
                "downhill": round(math.degrees(self.downhill), 6),
            },
            "rover.slider.spring_rate": round(824.0 * self.spring, 3),
            "start.position": [self.away, 0.0],
            "start.heading": round(math.degrees(self.heading), 6),
            "start.settling_time": 300.0,
            "tether.length": round(chord + self.slack, 3),
            "tether.element_length": 1.0,
            "integration.h": 2.0e-3,
        }


@cache
def _plant(overrides: str) -> SpatialPlant:
    return SpatialPlant(load_scenario("floor_rubble", json.loads(overrides)))


@dataclass
class JumpingRover:
    """A jumping rover.

    Args:
        stand: place, ground and true spring.
        settings: of the controller.
        seed: of the sensor errors.
        jump: a controller whose spring estimate is to be used; None = a new one.

    Attributes:
        stroke_error: true nut position less the measured one [m].
        heights: true rise of Body 1 in each jump [m].
    """

    stand: Stand = field(default_factory=Stand)
    settings: JumpSettings = field(
        default_factory=lambda: JumpSettings(prediction=PredictionParameters(floor_depth=_FLOOR))
    )
    seed: int = 0
    jump: Jump | None = None
    stroke_error: float = 0.0

    def __post_init__(self) -> None:
        self.plant = _plant(json.dumps(self.stand.overrides(), sort_keys=True))
        self.state = self.plant.initial_state()
        self.interface = SpatialInterface(self.plant, self.seed)
        self.interface.restart(self.state, 0)
        self.control = Jump(self.settings) if self.jump is None else self.jump
        if self.jump is not None:
            self.control.start_over(0)
        self.ticks = 0
        self.events: list[Event] = []
        self.changes: list[tuple[float, Transition]] = []
        self.records: list[JumpRecord] = []
        self.predictions: list[Prediction] = []
        self.predictor = JumpPredictor(self.settings.prediction)
        self.refusals: list[str] = []
        self.heights: list[float] = []
        self.peak_tension = 0.0  # since the last release [N]
        self._command: NutCommand | None = None
        self._standing = float(self.state.G1[2])
        self._top = -math.inf

    @property
    def time(self) -> float:
        """Time [s]."""
        return self.ticks * TICK

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.ticks * TICK_NS

    def tick(self) -> None:
        """Advance one tick: plant, sensors, controller.

        Raises:
            RuntimeError: the plant cannot continue.
        """
        self.state, result = self.plant.step(self.state, self._plant_command(), TICK)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.time:.3g} s")
        self.ticks += 1
        self.events += result.events
        if any(event.name == PlantEvent.LATCH_RELEASED for event in result.events):
            self._command = None  # as the drive does once its latch has tripped
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self._top = max(self._top, float(self.state.G1[2]))
        self.interface.measure(self.state, self.now_ns, result)
        self._update_sensors()
        if self.ticks % _EVERY == 0:
            self._predict()
            self._command = self.control.step(self.now_ns)
            self._process_changes()

    def run(self, duration: float) -> None:
        """Run for a time [s]."""
        for _ in range(round(duration / TICK)):
            self.tick()

    def request(self, joint: str, value: float) -> None:
        """Send a request; records a refusal."""
        try:
            self.control.request(JointSample(self.now_ns, {joint: JointValue(value)}), self.now_ns)
        except Refusal as refusal:
            self.refusals.append(str(refusal))
        self._process_changes()

    def perform_jump(self, value: float, joint: str = JUMP_HEIGHT, limit: float = 60.0) -> bool:
        """Request a jump and wait for its end; whether the rover jumped."""
        if self.ticks == 0:
            self.run(0.5)
        flown = len(self.heights)
        self.request(joint, value)
        ends = self.time + limit
        while self.control.phase not in (JumpPhase.STANDBY, JumpPhase.FAULT) and self.time < ends:
            self.tick()
        return len(self.heights) > flown

    def _predict(self) -> None:
        prediction_request = self.control.take_prediction_request()
        if prediction_request is not None:
            prediction = self.predictor.predict(prediction_request, self.control.spring)
            self.predictions.append(prediction)
            self.control.on_prediction(prediction_request, prediction, self.now_ns)

    def _plant_command(self) -> Command:
        order = self._command
        if order is None:
            return Command()
        compression = order.compression + self.stroke_error
        return Command(JumpMotorCommand(compression, order.rate, order.force, order.trips))

    def _update_sensors(self) -> None:
        samples, now = dict(self.interface.samples(_SENSOR_TOPICS)), self.now_ns
        imu, contact = samples[topics.IMU], samples[topics.CONTACT]
        motor, cell = samples[topics.JUMP_MOTOR_STATE], samples[topics.ROVER_LOAD_CELL]
        assert isinstance(imu, ImuSample)
        assert isinstance(contact, JointSample)
        assert isinstance(motor, JointSample)
        assert isinstance(cell, WrenchSample)
        control = self.control
        control.on_imu(imu, now)
        control.on_contact(contact, now)
        ((name, nut),) = motor.joints.items()
        reported = nut._replace(position=nut.position - self.stroke_error)
        control.on_jump_motor(JointSample(motor.stamp_ns, {name: reported}), now)
        control.on_load_cell(cell, now)
        x, y, z, w = self.state.orientation.tolist()
        place = (float(self.state.G1[0]), float(self.state.G1[1]), 0.0)
        still = (0.0, 0.0, 0.0)
        control.on_odometry(OdometrySample(now, place, (x, y, z, w), still, still))
        payout = JointValue(self.state.length)
        control.on_winch_estimate(JointSample(now, {PAYOUT: payout}))

    def _process_changes(self) -> None:
        for change in self.control.take_transitions():
            self.changes.append((self.time, change))
            if change.phase is JumpPhase.RELEASING:
                self._standing = self._top = float(self.state.G1[2])
                self.peak_tension = 0.0
            elif change.phase is JumpPhase.LANDED:
                self.heights.append(self._top - self._standing)
        self.records += self.control.take_records()


def draw_stand(generator: np.random.Generator, tilt: float = math.radians(5.0)) -> Stand:
    """A random place on a floor tilted by up to `tilt` [rad], with a spring off by up to 5 %."""
    return Stand(
        away=round(float(generator.uniform(0.5, 3.0)), 3),
        heading=round(float(generator.uniform(-math.pi, math.pi)), 3),
        slope=round(float(generator.uniform(0.0, tilt)), 5),
        downhill=round(float(generator.uniform(-math.pi, math.pi)), 3),
        spring=round(float(generator.uniform(0.95, 1.05)), 5),
    )
