"""Whole missions without ROS: spatial plant, real sensors, and all controllers of the suite.

Plant, sensor errors, winch, descent, drive and jump controllers run in lockstep at 50 Hz, the
mission supervisor at 10 Hz. This rig delivers the messages that the nodes exchange on topics and
services, refusals and events included. Only the checks use the ground truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from msg_schemas import topics
from msg_schemas.access import Act, node_that
from msg_schemas.events import EventReport, PlantEvent
from msg_schemas.machine import (
    HEADING_TURN,
    OBSERVATION_STOP,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.refusal import Refusal, RefusalReport
from msg_schemas.samples import (
    JointSample,
    JointValue,
    PoseSample,
    Sample,
    Status,
    StatusSample,
    TextSample,
)
from rover_control.descent import Descent, DescentCommands, DescentSettings
from rover_control.descent_profile import Stop
from rover_control.descent_report import observation_sample
from rover_control.descent_report import state_sample as descent_state
from rover_control.drive import Drive, DriveCommands, DriveSettings
from rover_control.drive_report import odometry_sample
from rover_control.drive_report import state_sample as drive_state
from rover_control.jump import Jump, JumpSettings
from rover_control.jump_prediction import PredictionParameters
from rover_control.jump_predictor import JumpPredictor
from rover_control.jump_report import flown_sample, prediction_sample
from rover_control.mission import Mission
from rover_control.mission_legs import Request
from rover_control.mission_parameters import MissionSettings
from rover_control.mission_plan import MissionPlan
from rover_control.mission_report import state_sample as mission_state
from rover_sim import (
    Command,
    FlywheelCommand,
    JumpMotorCommand,
    Outcome,
    SpatialPlant,
    SpatialState,
    WheelRateCommand,
    load_scenario,
)
from rover_sim.spatial_interface import SpatialInterface
from rover_verify.checks.winch_spatial import winch_command
from rover_verify.tape import Tape
from tether_winch.servo import DriveCommand, ServoParameters
from tether_winch.winch import Winch, WinchParameters

TICK_NS = 20_000_000  # of plant, sensors and controllers
TICK = TICK_NS * 1e-9
_MISSION_PERIOD = 5  # ticks per step of the mission
_STATE_PERIOD = 25  # ticks per sample of the mission state
_NUT_TIMEOUT = 25  # ticks without a command after which the nut holds its position
_WHEEL_TORQUE = 2.0  # limit of the wheel motor on the floor [N m]
_SENSOR_TOPICS = (
    topics.IMU,
    topics.CONTACT,
    topics.WINCH_STATE,
    topics.LOAD_CELL,
    topics.ROVER_LOAD_CELL,
    topics.MOTOR_CURRENTS,
    topics.WHEEL_STATE,
    topics.FLYWHEEL_STATE,
    topics.JUMP_MOTOR_STATE,
    topics.CAMERA,
)
WINCH = WinchParameters(servo=ServoParameters(trim_rate=0.3, shortest_length=1.4, end_zone=0.3))
"""Parameters of the winch as in `config/winch_descent.yaml`."""

_WINCH, _DESCENT, _DRIVE, _JUMP = "winch_node", "descent_node", "drive_node", "jump_node"
MISSION = "mission_node"
NODES = (_WINCH, _DESCENT, _DRIVE, _JUMP, MISSION)
"""Nodes that can be killed and restarted."""


@dataclass
class MissionFlight:
    """A rover, its mother machine, and a mission.

    Args:
        scenario: name.
        overrides: of the scenario, by dotted path.
        plan: of the mission.
        settings: of the mission.
        seed: of the sensor errors.
        tape: records the messages; None: no recording.
    """

    scenario: str
    overrides: Mapping[str, object]
    plan: MissionPlan
    settings: MissionSettings = field(default_factory=MissionSettings)
    seed: int = 0
    tape: Tape | None = None

    def __post_init__(self) -> None:
        self.plant = SpatialPlant(load_scenario(self.scenario, dict(self.overrides)))
        self.state: SpatialState = self.plant.initial_state()
        self.interface = SpatialInterface(self.plant, self.seed)
        self.interface.restart(self.state, 0)
        self.winch = Winch(WINCH)
        self.descent = Descent(DescentSettings())
        self.drive = Drive(DriveSettings())
        self.jump = Jump(JumpSettings())
        self.mission = Mission(self.plan, self.settings)
        self.ticks = 0
        self.peak_tension = 0.0
        self.max_depth = 0.0  # largest depth of base_link below the fairlead [m]
        self.reports: list[tuple[float, str, EventReport]] = []  # time [s], node, event
        self.on_report: Callable[[float, str, EventReport | RefusalReport], None] = (
            lambda _time, _who, _what: None
        )
        self._predictor: JumpPredictor | None = None
        self._phases: dict[str, str] = {}
        self._alarms: dict[str, bool] | None = None
        self._winch_command: DriveCommand | None = None
        self._descent_commands = DescentCommands()
        self._drive_commands = DriveCommands()
        self._nut: JumpMotorCommand | None = None
        self._idle_ticks = 0  # ticks without a nut command

    # --- state -----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time [s]."""
        return self.ticks * TICK

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.ticks * TICK_NS

    @property
    def tilt(self) -> float:
        """True inclination of the rover [rad]."""
        return math.acos(min(max(float(self.state.rotation[2, 2]), -1.0), 1.0))

    def events_named(self, name: str) -> list[EventReport]:
        """Events with this name."""
        return [what for _, _, what in self.reports if what.name == name]

    # --- simulation ------------------------------------------------------------------------------

    def run(self, limit: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run until a condition holds, or for a time [s]; whether it holds."""
        deadline = self.time + limit
        while self.time < deadline:
            self.tick()
            if until():
                return True
        return False

    def tick(self) -> None:
        """Advance one tick: plant, sensors, controllers.

        Raises:
            RuntimeError: the plant cannot continue.
        """
        self.state, result = self.plant.step(self.state, self._command(), TICK)
        if result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{result.outcome.value} after {self.time:.3g} s")
        self.ticks += 1
        if any(event.name == PlantEvent.LATCH_RELEASED for event in result.events):
            self._nut = None  # as the drive does once its latch has tripped
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self.max_depth = max(self.max_depth, -float(self.state.G1[2]))
        self.interface.measure(self.state, self.now_ns, result)
        samples = dict(self.interface.samples(_SENSOR_TOPICS))
        if self.tape is not None:
            self.tape.tick(self.interface, samples, self.now_ns)
        self._update_sensors(samples)
        self._step_winch()
        self._step_descent()
        self._step_drive()
        self._step_jump()
        self._publish_phases()
        if self.ticks % _MISSION_PERIOD == 0:
            self._step_mission(samples)

    def _update_sensors(self, samples: Mapping[str, Any]) -> None:
        now, winch, descent, drive = self.now_ns, self.winch, self.descent, self.drive
        drum, imu = samples[topics.WINCH_STATE], samples[topics.IMU]
        currents, wheels = samples[topics.MOTOR_CURRENTS], samples[topics.WHEEL_STATE]
        winch.on_drum(drum, now)
        winch.on_load_cell(samples[topics.LOAD_CELL], now)
        winch.on_currents(currents, now)
        descent.on_drum(drum, now)
        descent.on_load_cell(samples[topics.LOAD_CELL], now)
        descent.on_wheels(wheels, now)
        descent.on_flywheel(samples[topics.FLYWHEEL_STATE], now)
        descent.on_imu(imu, now)
        descent.on_camera(samples[topics.CAMERA])
        drive.on_contact(samples[topics.CONTACT], now)
        drive.on_wheels(wheels, now)
        drive.on_currents(currents, now)
        drive.on_imu(imu, now)
        jump = self.jump
        jump.on_contact(samples[topics.CONTACT], now)
        jump.on_jump_motor(samples[topics.JUMP_MOTOR_STATE], now)
        jump.on_imu(imu, now)
        jump.on_load_cell(samples[topics.ROVER_LOAD_CELL], now)

    def _step_winch(self) -> None:
        now, winch = self.now_ns, self.winch
        self._winch_command = winch.step(now)
        self._publish_events(_WINCH, winch.take_transitions())
        estimate = winch.estimate(now)
        if estimate is not None:
            self.drive.on_winch_estimate(estimate, now)
            self.jump.on_winch_estimate(estimate)
        if dict(winch.alarms) != self._alarms:
            self._alarms = dict(winch.alarms)
            joints = {name: JointValue(float(on)) for name, on in self._alarms.items()}
            self._publish(topics.WINCH_ALARMS, JointSample(now, joints))

    def _step_descent(self) -> None:
        commands = self._descent_commands = self.descent.step(self.now_ns)
        self._publish_events(_DESCENT, self.descent.take_changes())
        for picture in self.descent.take_observations():
            self._record(topics.DESCENT_OBSERVATION, observation_sample(picture))
        if commands.winch is not None:
            value = JointValue(commands.winch.length, commands.winch.rate, 0.0)
            sample = JointSample(self.now_ns, {WINCH_WHILE_RENEWED: value})
            self._attempt(
                _WINCH, topics.WINCH_REQUEST, lambda: self.winch.request(sample, self.now_ns)
            )
        trim = commands.trim
        if trim is not None:
            self._attempt(_WINCH, topics.WINCH_TRIM, lambda: self.winch.trim(trim, self.now_ns))

    def _step_drive(self) -> None:
        commands = self._drive_commands = self.drive.step(self.now_ns)
        self._publish_events(_DRIVE, self.drive.take_changes())
        request = commands.winch
        if request is not None:
            value = JointValue(request.position, request.velocity, request.effort)
            sample = JointSample(self.now_ns, {request.joint: value})
            self._attempt(
                _WINCH, topics.WINCH_REQUEST, lambda: self.winch.request(sample, self.now_ns)
            )

    def _step_jump(self) -> None:
        self._predict()
        command = self.jump.step(self.now_ns)
        self._idle_ticks = (
            0
            if command is not None or self._descent_commands.nut is not None
            else self._idle_ticks + 1
        )
        if command is not None:
            self._nut = JumpMotorCommand(
                command.compression, command.rate, command.force, command.trips
            )
        elif self._nut is not None and self._idle_ticks == _NUT_TIMEOUT:
            # Like the drive's watchdog: the nut holds its position.
            self._nut = replace(self._nut, compression=self._held_nut(), trips=False)
        changes = [each.event for each in self.jump.take_transitions()]
        self._publish_events(_JUMP, changes)
        for record in self.jump.take_records():
            self._record(topics.JUMP_FLOWN, flown_sample(record))

    def _predict(self) -> None:
        """Run a requested prediction at once; a node needs a second or two."""
        prediction_request = self.jump.take_prediction_request()
        if prediction_request is None:
            return
        if self._predictor is None:
            self._predictor = JumpPredictor(PredictionParameters())
        prediction = self._predictor.predict(prediction_request, self.jump.spring)
        self._record(topics.JUMP_PREDICTION, prediction_sample(prediction, self.now_ns))
        self.jump.on_prediction(prediction_request, prediction, self.now_ns)

    def _held_nut(self) -> float:
        drive = self.plant.model.jump
        return min(max(self.state.nut, -drive.free_travel), drive.stroke)

    def _command(self) -> Command:
        winch = None if self._winch_command is None else winch_command(self._winch_command)
        descent, drive = self._descent_commands, self._drive_commands
        wheel = None
        if drive.wheel_rate is not None:
            wheel = WheelRateCommand(drive.wheel_rate, _WHEEL_TORQUE)
        elif descent.wheel_rate is not None:
            torque = self.descent.settings.hanging_controller.rotors.wheel_torque
            wheel = WheelRateCommand(descent.wheel_rate, torque)
        jump: JumpMotorCommand | FlywheelCommand | None = self._nut
        if descent.nut is not None:
            speed = self.descent.settings.descent.nut_speed
            jump = self._nut = JumpMotorCommand(descent.nut, speed)
        elif descent.flywheel_torque is not None:
            jump, self._nut = FlywheelCommand(descent.flywheel_torque), None
        return Command(jump, winch, wheel)

    def _publish_phases(self) -> None:
        """Deliver the phases and modes that the nodes latch."""
        phases = {
            topics.WINCH_MODE: self.winch.mode.value,
            topics.DESCENT_PHASE: str(self.descent.phase),
            topics.DRIVE_PHASE: self.drive.phase.value,
            topics.JUMP_PHASE: self.jump.phase.value,
        }
        for name, phase in phases.items():
            if self._phases.get(name) == phase:
                continue
            self._phases[name] = phase
            self._publish_phase(name, phase)
            self._publish(name, TextSample(phase))

    def _publish_phase(self, name: str, phase: str) -> None:
        now = self.now_ns
        if name == topics.WINCH_MODE:
            self.descent.on_winch_mode(phase, now)
            self.drive.on_winch_mode(phase)
            self.jump.on_winch_mode(phase)
        elif name == topics.DESCENT_PHASE:
            self.drive.on_descent(phase)
        elif name == topics.JUMP_PHASE:
            self.winch.on_jump(phase, now)
            self.descent.on_jump(phase)
            self.drive.on_jump(phase)

    def _publish_events(self, who: str, changes: list[EventReport]) -> None:
        for change in changes:
            self.reports.append((self.time, who, change))
            self.on_report(self.time, who, change)
            status = Status(change.name, change.message, change.level, who, change.texts())
            sample = StatusSample(self.now_ns, (status,))
            if who == MISSION:
                self._record(topics.EVENTS, sample)
            else:
                self._publish(topics.EVENTS, sample)

    def _publish(self, name: str, sample: Sample) -> None:
        """Deliver a sample to the mission and record it."""
        self.mission.receive(name, sample, self.now_ns)
        self._record(name, sample)

    def _record(self, name: str, sample: Sample) -> None:
        if self.tape is not None:
            self.tape.write(name, sample, self.now_ns)

    def _attempt(self, who: str, subject: str, action: Callable[[], object]) -> None:
        """Execute a request or service; a refusal goes to diagnostics."""
        try:
            action()
        except Refusal as refusal:
            report = RefusalReport(who, subject, refusal.code, refusal.reason)
            self.on_report(self.time, who, report)
            sample = StatusSample(self.now_ns, (report.status(),))
            self.mission.receive(topics.DIAGNOSTICS, sample, self.now_ns)

    # --- the mission -----------------------------------------------------------------------------

    def _step_mission(self, samples: Mapping[str, Sample]) -> None:
        now, mission = self.now_ns, self.mission
        estimate = self.winch.estimate(now)
        if estimate is not None:
            self._publish(topics.WINCH_ESTIMATE, estimate)
        state = descent_state(self.descent, now)
        if state is not None:
            self._publish(topics.DESCENT_STATE, state)
        odometry = odometry_sample(self.drive, now)
        self.jump.on_odometry(odometry)
        self._publish(topics.ODOMETRY, odometry)
        self._publish(topics.DRIVE_STATE, drive_state(self.drive, now))
        mission.receive(topics.JUMP_MOTOR_STATE, samples[topics.JUMP_MOTOR_STATE], now)
        for request in mission.step(now):
            self.send(request)
        self._publish_events(MISSION, mission.take_changes())
        phase = mission.phase.value
        if phase != self._phases.get(topics.MISSION_PHASE):
            self._phases[topics.MISSION_PHASE] = phase
            self._record(topics.MISSION_PHASE, TextSample(phase))
        if self.ticks % _STATE_PERIOD == 0:
            self._record(topics.MISSION_STATE, mission_state(mission, now))

    def send(self, request: Request) -> None:
        """Deliver a request, or call a service."""
        if request.sample is None:
            self._attempt(
                node_that(Act.SERVE, request.name), request.name, lambda: self._call(request.name)
            )
        else:
            sample = request.sample
            self._attempt(
                _SERVERS[request.name], request.name, lambda: self._request(request.name, sample)
            )

    def _call(self, service: str) -> object:
        now = self.now_ns
        served: dict[str, Callable[[], object]] = {
            topics.WINCH_HOLD: lambda: self.winch.hold(now),
            topics.WINCH_REARM: lambda: self.winch.rearm(now),
            topics.DESCENT_HOLD: lambda: self.descent.hold(now),
            topics.DESCENT_RESUME: lambda: self.descent.resume(now),
            topics.DESCENT_ABORT: lambda: self.descent.abort(now),
            topics.DESCENT_RELEASE: self.descent.release,
            topics.DRIVE_STOP: lambda: self.drive.stop(now),
            topics.JUMP_ABORT: lambda: self.jump.abort(now),
        }
        return served[service]()

    def _request(self, topic: str, sample: Sample) -> None:
        now = self.now_ns
        if isinstance(sample, PoseSample):
            if topic == topics.DRIVE_START:
                self.drive.set_pose(sample)
            else:
                self.drive.request(sample, now)
            return
        assert isinstance(sample, JointSample)
        ((name, value),) = sample.joints.items()
        if topic == topics.WINCH_REQUEST:
            self.winch.request(sample, now)
        elif topic == topics.JUMP_REQUEST:
            self.jump.request(sample, now)
        elif name == HEADING_TURN:
            self.descent.turn(value.position, now)
        else:
            self.descent.request(Stop(value.position, name == OBSERVATION_STOP, 0.0), now)

    # --- restarts --------------------------------------------------------------------------------

    def restart(self, node: str) -> None:
        """Kill a node and restart it at once: it knows only latched messages."""
        if node == _WINCH:
            self.winch = Winch(WINCH)
            self.winch.on_jump(self._phases[topics.JUMP_PHASE], self.now_ns)
        elif node == _DESCENT:
            self.descent = Descent(DescentSettings())
            self._descent_commands = DescentCommands()
            self.descent.on_winch_mode(self._phases[topics.WINCH_MODE], self.now_ns)
            self.descent.on_jump(self._phases[topics.JUMP_PHASE])
        elif node == _DRIVE:
            self.drive = Drive(DriveSettings())
            self._drive_commands = DriveCommands()
            self.drive.on_winch_mode(self._phases[topics.WINCH_MODE])
            self.drive.on_jump(self._phases[topics.JUMP_PHASE])
            self.drive.on_descent(self._phases[topics.DESCENT_PHASE])
        elif node == _JUMP:
            self.jump = Jump(JumpSettings())
            self.jump.on_winch_mode(self._phases[topics.WINCH_MODE])
        else:
            checkpoint = self.mission.checkpoint(self.now_ns)
            self.mission = Mission(self.plan, self.settings)
            self._alarms = None
            for name, phase in self._phases.items():
                if name != topics.MISSION_PHASE:
                    self.mission.receive(name, TextSample(phase), self.now_ns)
            self.mission.restore(checkpoint, self.now_ns)


_SERVERS = {
    topics.WINCH_REQUEST: _WINCH,
    topics.DESCENT_REQUEST: _DESCENT,
    topics.DRIVE_START: _DRIVE,
    topics.DRIVE_GOAL: _DRIVE,
    topics.JUMP_REQUEST: _JUMP,
}
