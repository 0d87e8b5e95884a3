"""The driving rover under its own controllers: spatial plant, real sensors, winch and drive.

Plant, sensor errors, the winch's controller and the rover's are stepped together at 50 Hz, without
ROS. The ground makes the wheels slip as it does; on top each side may slip by a share of its own,
which is told to nobody: after each tick the rover is put back along each wheel's track, and turned
where the sides differ. What is true is kept for the checks alone.
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
_TORQUE = 2.0  # that the wheel motor may use [N m]
_HEARD = (
    topics.IMU,
    topics.CONTACT,
    topics.WINCH_STATE,
    topics.LOAD_CELL,
    topics.MOTOR_CURRENTS,
    topics.WHEEL_STATE,
)
# A bare level floor of regolith, on which the rover stands with little slack.
_FLOOR = 6.0  # below the fairlead [m]
_ATTACHMENT = 0.43  # of the tether above the floor [m]
_SLACK = 0.3  # [m]


def level_floor(x: float, y: float, heading: float = 0.0) -> dict[str, object]:
    """Overrides of a scenario in which the rover stands so [m, rad] on a level floor."""
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
    """Where base_link truly is."""

    x: float
    y: float
    heading: float


@dataclass
class DrivenRover:
    """A rover on the floor with its controllers.

    Args:
        overrides: of the scenario, by dotted path.
        settings: of the rover's controller.
        seed: of the sensors' errors.

    Attributes:
        slip: share of its way by which each wheel, left and right, slips beyond what the ground
            makes it.
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
        self.turned = 0.0  # of the left wheel since the start, both ways [rad]
        self._drives = DriveCommands()
        self._winch: DriveCommand | None = None

    @property
    def time(self) -> float:
        """[s]."""
        return self.ticks * TICK

    @property
    def now_ns(self) -> int:
        """Simulated time."""
        return self.ticks * TICK_NS

    @property
    def pose(self) -> TruePose:
        """The true one."""
        x, y = self.state.rotation[:2, 0]
        return TruePose(float(self.state.G1[0]), float(self.state.G1[1]), math.atan2(y, x))

    def begin(self) -> None:
        """Let the controllers hear their sensors, arm the winch, say where the rover stands."""
        for _ in range(20):
            self.tick()
        self.winch.rearm(self.now_ns)
        for _ in range(20):
            self.tick()
        x, y, heading = self.pose
        turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
        self.drive.set_pose(PoseSample(0, (x, y, 0.0), turned))

    def tick(self) -> None:
        """One tick: plant, sensors, both controllers.

        Raises:
            RuntimeError: the plant cannot go on.
        """
        wheels = self.state.wheel_angles
        self.state, result = self.plant.step(self.state, self._command(), TICK)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.time:.3g} s")
        self.ticks += 1
        left, right = (now - was for now, was in zip(self.state.wheel_angles, wheels, strict=True))
        self.turned += abs(left)
        self._slip_on(left, right)
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self.interface.measure(self.state, self.now_ns, result)
        self._hear(dict(self.interface.samples(_HEARD)))
        self._winch = self.winch.step(self.now_ns)
        self.winch.take_transitions()
        self._control()
        if self.ticks % 10 == 0:
            self.path.append(self.pose)

    def _slip_on(self, left: float, right: float) -> None:
        """Put the rover back by what each wheel slips beyond the ground's own."""
        rover = self.plant.scenario.rover
        assert rover is not None
        radius, track = rover.wheels.radius, rover.wheels.track_width
        back = [radius * max(angle, 0.0) * share for angle, share in
                zip((left, right), self.slip, strict=True)]  # fmt: skip
        if not any(back):
            return
        state = self.state
        turn = (back[0] - back[1]) / track
        way = -0.5 * (back[0] + back[1])
        # About the middle of the axle, which lies ahead of base_link's origin.
        ahead = state.rotation[:, 0] * np.array([1.0, 1.0, 0.0])
        middle = state.G1 + rover.wheels.axle_x * ahead
        c, s = math.cos(turn), math.sin(turn)
        spun = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

        def moved(place: np.ndarray) -> np.ndarray:
            return np.asarray(middle + spun @ (place - middle) + way * ahead)

        body, nodes = state.body.copy(), state.nodes.copy()
        at = spatial_rover.POSITION
        body[at : at + 3] = moved(state.G1)
        for first in (spatial_rover.VELOCITY1, spatial_rover.VELOCITY2):
            body[first : first + 3] = spun @ body[first : first + 3]
        at = spatial_rover.ORIENTATION
        w, x, y, z = body[at : at + 4]
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        body[at : at + 4] = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
        nodes[-1, 0] = moved(nodes[-1, 0])
        self.state = replace(state, body=body, nodes=nodes)

    def _command(self) -> Command:
        winch = None if self._winch is None else winch_command(self._winch)
        rate = self._drives.wheel_rate
        wheel = None if rate is None else WheelRateCommand(rate, _TORQUE)
        return Command(None, winch, wheel)

    def _control(self) -> None:
        self._drives = self.drive.step(self.now_ns)
        self.changes += [(self.time, change) for change in self.drive.take_changes()]
        ask = self._drives.winch
        if ask is None:
            return
        value = JointValue(ask.position, ask.velocity, ask.effort)
        try:
            self.winch.request(JointSample(self.now_ns, {ask.joint: value}), self.now_ns)
        except Refusal as refusal:
            self.refusals.append(f"{self.time:.2f} s: {refusal}")

    def _hear(self, samples: dict[str, Sample]) -> None:
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

    # --- what is asked for -----------------------------------------------------------------------

    def run(self, limit: float) -> None:
        """Go on until nothing is driven and the rover stands, or so long [s]."""
        ends = self.time + limit
        while self.time < ends:
            self.tick()
            stands = max(map(abs, self.state.wheel_rates)) < 1e-3
            if not self.drive.is_busy and stands:
                return

    def told(self, name: str) -> Sequence[EventReport]:
        """What the drive told by this name."""
        return [change for _, change in self.changes if change.name == name]
