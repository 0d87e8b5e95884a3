"""The driving rover with its controllers: spatial plant, sensors, winch and drive. Without ROS.

Plant, sensor errors and controllers run in lockstep at 50 Hz. In addition to the slip on the
ground, each side may have a slip that no sensor measures: after each tick the rover is moved back
along each wheel's path and rotated by the difference of the sides. Only the checks use the ground
truth.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import EventReport
from msg_schemas.refusal import Refusal
from msg_schemas.samples import ImuSample, JointSample, JointValue, PoseSample, Sample, WrenchSample
from rover_control.drive import Drive, DriveCommands, DriveSettings
from rover_sim import (
    Command,
    Outcome,
    SpatialPlant,
    SpatialState,
    WheelRateCommand,
    load_scenario,
)
from rover_sim.physics import spatial_rover
from rover_sim.spatial_interface import SpatialInterface
from rover_verify.checks.winch_spatial import winch_command
from tether_winch.servo import DriveCommand
from tether_winch.winch import Winch, WinchParameters

TICK_NS = 20_000_000  # of plant, sensors and controllers
TICK = TICK_NS * 1e-9
_TORQUE = 2.0  # limit of the wheel motor [N m]
_SENSOR_TOPICS = (
    topics.IMU,
    topics.CONTACT,
    topics.WINCH_STATE,
    topics.LOAD_CELL,
    topics.MOTOR_CURRENTS,
    topics.WHEEL_STATE,
)
# Level regolith without relief and boulders; little slack.
_FLOOR = 6.0  # depth below the fairlead [m]
_ATTACHMENT = 0.43  # height of the tether attachment above the floor [m]
_SLACK = 0.3  # [m]


def level_floor(x: float, y: float, heading: float = 0.0) -> dict[str, object]:
    """Scenario overrides: the rover stands at a pose [m, rad] on a level floor."""
    reach = math.hypot(x, y, _FLOOR - _ATTACHMENT)
    return {
        "environment.relief": None,
        "environment.boulders": None,
        "environment.floor": {"height": -_FLOOR},
        "start.position": [x, y],
        "start.heading": math.degrees(heading),
        "tether.length": round(reach + _SLACK, 3),
        "tether.element_length": 1.0,
        "integration.h": 4.0e-3,
    }


@cache
def _plant(overrides: str) -> SpatialPlant:
    return SpatialPlant(load_scenario("floor_rubble", json.loads(overrides)))


class TruePose(NamedTuple):
    """True pose of base_link."""

    x: float
    y: float
    heading: float


@dataclass
class DrivenRover:
    """A rover on the floor with its controllers.

    Args:
        overrides: of the scenario, by dotted path.
        settings: of the drive controller.
        seed: of the sensor errors.

    Attributes:
        slip: additional slip of the left and the right wheel, as a fraction of their travel.
    """

    overrides: Mapping[str, object]
    settings: DriveSettings = field(default_factory=DriveSettings)
    seed: int = 0
    slip: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self.plant = _plant(json.dumps(self.overrides, sort_keys=True))
        self.state: SpatialState = self.plant.initial_state()
        self.interface = SpatialInterface(self.plant, self.seed)
        self.interface.restart(self.state, 0)
        self.winch = Winch(WinchParameters())
        self.drive = Drive(self.settings)
        self.ticks = 0
        self.changes: list[tuple[float, EventReport]] = []
        self.refusals: list[str] = []
        self.path: list[TruePose] = []
        self.peak_tension = 0.0
        self.turned = 0.0  # total angle of the left wheel, both directions [rad]
        self._commands = DriveCommands()
        self._winch: DriveCommand | None = None

    @property
    def time(self) -> float:
        """Time [s]."""
        return self.ticks * TICK

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.ticks * TICK_NS

    @property
    def pose(self) -> TruePose:
        """True pose."""
        x, y = self.state.rotation[:2, 0]
        return TruePose(float(self.state.G1[0]), float(self.state.G1[1]), math.atan2(y, x))

    def begin(self) -> None:
        """Feed the controllers with sensor samples, arm the winch, and set the pose."""
        for _ in range(20):
            self.tick()
        self.winch.rearm(self.now_ns)
        for _ in range(20):
            self.tick()
        x, y, heading = self.pose
        turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
        self.drive.set_pose(PoseSample(0, (x, y, 0.0), turned))

    def tick(self) -> None:
        """Advance one tick: plant, sensors, both controllers.

        Raises:
            RuntimeError: the plant cannot continue.
        """
        wheels = self.state.wheel_angles
        self.state, result = self.plant.step(self.state, self._command(), TICK)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.time:.3g} s")
        self.ticks += 1
        left, right = (now - was for now, was in zip(self.state.wheel_angles, wheels, strict=True))
        self.turned += abs(left)
        self._apply_slip(left, right)
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self.interface.measure(self.state, self.now_ns, result)
        self._update_sensors(dict(self.interface.samples(_SENSOR_TOPICS)))
        self._winch = self.winch.step(self.now_ns)
        self.winch.take_transitions()
        self._control()
        if self.ticks % 10 == 0:
            self.path.append(self.pose)

    def _apply_slip(self, left: float, right: float) -> None:
        """Move the rover back by the additional slip of its wheels."""
        rover = self.plant.scenario.rover
        assert rover is not None
        radius, track_width = rover.wheels.radius, rover.wheels.track_width
        slipped = [radius * max(angle, 0.0) * fraction for angle, fraction in
                zip((left, right), self.slip, strict=True)]  # fmt: skip
        if not any(slipped):
            return
        state = self.state
        turn = (slipped[0] - slipped[1]) / track_width
        shift = -0.5 * (slipped[0] + slipped[1])
        # About the middle of the axle, which lies ahead of base_link's origin.
        ahead = state.rotation[:, 0] * np.array([1.0, 1.0, 0.0])
        middle = state.G1 + rover.wheels.axle_x * ahead
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

        def displaced(place: np.ndarray) -> np.ndarray:
            return np.asarray(middle + rotation @ (place - middle) + shift * ahead)

        body, nodes = state.body.copy(), state.nodes.copy()
        at = spatial_rover.POSITION
        body[at : at + 3] = displaced(state.G1)
        for start in (spatial_rover.VELOCITY1, spatial_rover.VELOCITY2):
            body[start : start + 3] = rotation @ body[start : start + 3]
        at = spatial_rover.ORIENTATION
        w, x, y, z = body[at : at + 4]
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        body[at : at + 4] = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
        nodes[-1, 0] = displaced(nodes[-1, 0])
        self.state = replace(state, body=body, nodes=nodes)

    def _command(self) -> Command:
        winch = None if self._winch is None else winch_command(self._winch)
        rate = self._commands.wheel_rate
        wheel = None if rate is None else WheelRateCommand(rate, _TORQUE)
        return Command(None, winch, wheel)

    def _control(self) -> None:
        self._commands = self.drive.step(self.now_ns)
        self.changes += [(self.time, change) for change in self.drive.take_changes()]
        request = self._commands.winch
        if request is None:
            return
        value = JointValue(request.position, request.velocity, request.effort)
        try:
            self.winch.request(JointSample(self.now_ns, {request.joint: value}), self.now_ns)
        except Refusal as refusal:
            self.refusals.append(f"{self.time:.2f} s: {refusal}")

    def _update_sensors(self, samples: dict[str, Sample]) -> None:
        now, drive, winch = self.now_ns, self.drive, self.winch
        drum, cell = samples[topics.WINCH_STATE], samples[topics.LOAD_CELL]
        currents, imu = samples[topics.MOTOR_CURRENTS], samples[topics.IMU]
        wheels, contact = samples[topics.WHEEL_STATE], samples[topics.CONTACT]
        assert isinstance(drum, JointSample)
        assert isinstance(cell, WrenchSample)
        assert isinstance(currents, JointSample)
        assert isinstance(imu, ImuSample)
        assert isinstance(wheels, JointSample)
        assert isinstance(contact, JointSample)
        winch.on_drum(drum, now)
        winch.on_load_cell(cell, now)
        winch.on_currents(currents, now)
        drive.on_contact(contact, now)
        drive.on_wheels(wheels, now)
        drive.on_currents(currents, now)
        drive.on_imu(imu, now)
        drive.on_winch_mode(winch.mode.value)
        estimate = winch.estimate(now)
        if estimate is not None:
            drive.on_winch_estimate(estimate, now)

    # --- requests and results --------------------------------------------------------------------

    def run(self, limit: float) -> None:
        """Run until the drive has ended and the rover is at rest, or for a time [s]."""
        deadline = self.time + limit
        while self.time < deadline:
            self.tick()
            is_at_rest = max(map(abs, self.state.wheel_rates)) < 1e-3
            if not self.drive.is_busy and is_at_rest:
                return

    def events_named(self, name: str) -> Sequence[EventReport]:
        """Events of the drive controller with this name."""
        return [change for _, change in self.changes if change.name == name]
