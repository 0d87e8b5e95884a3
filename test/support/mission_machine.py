"""Model of the nodes that a mission commands; each responds at once on its topics."""

from __future__ import annotations

import math

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState, state_after
from msg_schemas.events import EventReport, MissionEvent, WinchEvent
from msg_schemas.faults import Reason, StuckCause
from msg_schemas.machine import (
    HEADING,
    JUMP_PREDICTION,
    JUMP_SCREW,
    OBSERVATION_STOP,
    PAYOUT,
    PITCH,
    PLAIN_STOP,
    ROLL,
    SWING_MAJOR,
    SWING_MINOR,
    TENSION,
    TETHER_DROP,
    TETHER_OUT,
    WINCH_SLACK,
)
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, MissionPhase, WinchMode
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Level,
    PoseEstimateSample,
    PoseSample,
    Status,
    StatusSample,
    TextSample,
)
from rover_control.mission.mission_checkpoint import checkpoint_of, restore
from rover_control.mission.mission_legs import LegRequest, LegResult
from rover_control.mission.mission_parameters import MissionSettings
from rover_control.mission.mission_plan import Landing, Look, MissionPlan, Waypoint
from rover_control.mission.mission_supervisor import Mission
from rover_control.mission.operator_commands import OperatorCommands

STEP = 0.1  # [s]
FLOOR = 9.0  # length at touchdown [m]
PLAN = MissionPlan(
    looks=(Look(depth=4.0),),
    landing=Landing(approach_depth=7.0, max_depth=10.0, rate=0.1),
    survey=(Waypoint(x=2.0, y=0.0), Waypoint(x=2.0, y=1.0)),
)


class MissionMachine:
    """A mission with models of all nodes that it commands.

    Attributes:
        slope: inclination of the ground, nose up [rad].
        stuck: number of times that the drive will still get stuck.
        cannot_turn: the rover cannot turn where it is stuck.
        jump_fails: the next jump does not leave the ground.
        upright: predicted probability of landing upright.
        rejection: why a prediction rejects the jump.
        turned: heading of the descent controller's gyro [rad].
        swings: the rover swings, so that no stop ends.
        rate: of the last length request to the winch [m/s].
        floor: length below which the rover hangs [m].
        reached_on_floor: how the winch ends a length request whose goal leaves the rover standing.
        refuses_payout: the winch refuses to pay out while the rover stands.
        choices: events of the choices between wheels and jump.
        refuses: reasons of refusals, by topic or service.
        requests: names of all topics and services requested.
    """

    def __init__(self, plan: MissionPlan = PLAN, settings: MissionSettings | None = None) -> None:
        self.plan, self.settings = plan, settings
        self.mission = Mission(plan, settings)
        self.now = 1.0
        self.length, self.slack = 2.0, 0.0
        self.floor = FLOOR
        self.reached_on_floor = Reason.COMPLETED
        self.refuses_payout = False
        self.winch: str = WinchMode.DISARMED
        self.descent: str = DescentPhase.RELEASED
        self.drive: str = DrivePhase.RELEASED
        self.jump: str = JumpPhase.STANDBY
        self.nut = -0.03
        self.place = (0.0, 0.0, 0.0)
        self.knows_place = False
        self.slope = 0.0
        self.stuck = 0
        self.cannot_turn = False
        self.jump_fails = False
        self.upright, self.rejection = 1.0, ""
        self.turned = 0.0
        self.swings = False
        self.rate = math.nan
        self.refuses: dict[str, str] = {}
        self.silent: set[str] = set()
        self.requests: list[str] = []
        self.goals: list[tuple[float, float]] = []
        self.events: list[str] = []
        self.choices: list[EventReport] = []
        self._goal: tuple[float, float] | None = None
        self._stop: tuple[str, float] | None = None
        self._length_goal: float | None = None
        self._busy = 0.0  # remaining time of a jump or drive [s]

    @property
    def operator(self) -> OperatorCommands:
        return OperatorCommands(self.mission)

    @property
    def now_ns(self) -> int:
        return round(self.now * 1e9)

    @property
    def on_floor(self) -> bool:
        return self.length - self.slack >= self.floor - 1e-6 or self._on_floor

    _on_floor = False

    # --- simulation ------------------------------------------------------------------------------

    def run(self, limit: float = 4000.0, until: MissionPhase | None = None) -> None:
        """Run until the mission is in a phase, or until no leg is active."""
        for _ in range(round(limit / STEP)):
            self.tick()
            if until is None and not self.mission.is_active:
                return
            if until is not None and self.mission.phase is until:
                return

    def tick(self) -> None:
        self.now += STEP
        self._move()
        self.publish()
        for request in self.mission.step(self.now_ns):
            self.requests.append(request.name)
            self.handle(request)
        changes = self.mission.take_changes()
        self.events += [change.name for change in changes]
        self.choices += [
            change for change in changes if change.name == MissionEvent.LOCOMOTION_CHOSEN
        ]

    def publish(self) -> None:
        receive, now = self.mission.observed.receive, self.now_ns
        for name, word in (
            (topics.WINCH_MODE, self.winch),
            (topics.DESCENT_PHASE, self.descent),
            (topics.DRIVE_PHASE, self.drive),
            (topics.JUMP_PHASE, self.jump),
        ):
            if word:
                receive(name, TextSample(word), now)
        alarms = {"touchdown": JointValue(float(self.on_floor))}
        receive(topics.WINCH_ALARMS, JointSample(now, alarms), now)
        if topics.WINCH_ESTIMATE not in self.silent:
            joints = {
                PAYOUT: JointValue(self.length),
                TENSION: JointValue(1.0, 0.0, 0.3 if self.on_floor else 16.5),
                TETHER_OUT: JointValue(),
            }
            receive(topics.WINCH_ESTIMATE, JointSample(now, joints), now)
        state = {
            HEADING: JointValue(self.turned),
            SWING_MAJOR: JointValue(0.02 if self.swings else 0.0),
            SWING_MINOR: JointValue(-0.005 if self.swings else 0.0),
        }
        receive(topics.DESCENT_STATE, JointSample(now, state), now)
        receive(topics.JUMP_MOTOR_STATE, JointSample(now, {JUMP_SCREW: JointValue(self.nut)}), now)
        x, y, heading = self.place
        turned = (0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
        known = (0.0,) * 35 + (0.01 if self.knows_place else 3.0,)
        receive(topics.POSE, PoseEstimateSample(now, (x, y, 0.0), turned, known), now)
        tilt = {PITCH: JointValue(-self.slope), ROLL: JointValue(0.0), TETHER_DROP: JointValue()}
        receive(topics.DRIVE_STATE, JointSample(now, tilt), now)

    def record(self, topic: str, reason: Reason | RefusalCode, text: str, **result: object) -> None:
        """Publish the end of the mission's last request on a topic."""
        state = CommandState.REFUSED if isinstance(reason, RefusalCode) else state_after(reason)
        record = CommandRecord(
            "a_node", topic, "mission_node", "1", self.now_ns,
            state, reason=reason, text=text,
            result={k: str(v) for k, v in result.items()},
        )  # fmt: skip
        sample = StatusSample(self.now_ns, (record.status(),))
        self.mission.observed.receive(topics.COMMANDS, sample, self.now_ns)

    def hold_winch(self) -> None:
        """Hold the winch as an operator does."""
        self._length_goal, self.winch = None, WinchMode.HOLD
        values = {"reason": Reason.REQUESTED.value}
        event = Status(WinchEvent.HOLD, "hold requested", Level.OK, "winch_node", values)
        sample = StatusSample(self.now_ns, (event,))
        self.mission.observed.receive(topics.EVENTS, sample, self.now_ns)

    def _move(self) -> None:
        if self._stop is not None and self.descent == DescentPhase.TRAVELLING:
            joint, depth = self._stop
            self.length += math.copysign(
                min(abs(depth - self.length), 0.3 * STEP * 10), depth - self.length
            )
            if abs(depth - self.length) < 1e-6 and not self.swings:
                self._stop, self.descent = None, DescentPhase.STANDBY
                pictures = 3 if joint == OBSERVATION_STOP else 0
                text = "3 pictures" if pictures else "reached"
                self.record(
                    topics.DESCENT_REQUEST, Reason.COMPLETED, text, depth=depth, pictures=pictures
                )
        if self._length_goal is not None and self.winch == WinchMode.LENGTH:
            distance = self._length_goal - self.length
            self.length += math.copysign(min(abs(distance), 0.1 * STEP * 10), distance)
            if distance < 0.0:
                self.slope = 0.0  # a hanging rover is upright
                self._on_floor &= self.length >= self.floor
            if self.length >= self.floor and distance > 0.0:
                self.length, self._on_floor = self.floor, True
                self._end_length(Reason.TOUCHDOWN, f"touchdown at {self.floor} m")
            elif abs(self._length_goal - self.length) < 1e-6:
                self._on_floor = self.length >= self.floor
                reason = self.reached_on_floor if self._on_floor else Reason.COMPLETED
                self._end_length(reason, "there")
        if self.jump == JumpPhase.LETTING_DOWN:
            self.jump, self.nut = JumpPhase.STANDBY, 0.0
        self._busy -= STEP
        if self._busy > 0.0:
            return
        if self.jump == JumpPhase.FLIGHT and self.jump_fails:
            self.jump_fails = False
            self.record(topics.JUMP_REQUEST, Reason.TIME_LIMIT, "no take-off")
        elif self.jump == JumpPhase.FLIGHT:
            self.record(topics.JUMP_REQUEST, Reason.COMPLETED, "at rest on the ground")
        if self.jump == JumpPhase.FLIGHT:
            self.jump, self.nut, self.slack = JumpPhase.STANDBY, -0.03, 0.0
            self.length = self.floor
        if self.drive == DrivePhase.DRIVING and self._goal is not None:
            if self.stuck > 0:
                self.stuck -= 1
                self.drive = DrivePhase.STUCK
                text = "the wheels turn but the rover does not move"
                turning = int(self.cannot_turn)
                self.record(
                    topics.DRIVE_GOAL,
                    Reason.OUT_OF_LIMITS,
                    text,
                    turning=turning,
                    cause=StuckCause.NO_TRAVEL,
                )
            else:
                distance = math.dist(self._goal, self.place[:2])
                share = min(0.2 / distance, 1.0) if distance > 0.0 else 1.0
                x, y = (
                    at + share * (to - at) for at, to in zip(self.place, self._goal, strict=False)
                )
                self.place = (x, y, self.place[2])
                if share == 1.0:
                    self.drive = DrivePhase.RELEASED
                    self.record(topics.DRIVE_GOAL, Reason.COMPLETED, "all goals reached")

    def _end_length(self, reason: Reason, text: str) -> None:
        self._length_goal, self.winch = None, WinchMode.HOLD
        self.record(topics.WINCH_REQUEST, reason, text)

    # --- requests --------------------------------------------------------------------------------

    def handle(self, request: LegRequest) -> None:
        if request.name in self.refuses:
            code = RefusalCode.WRONG_PHASE
            self.record(request.name, code, self.refuses[request.name])
        elif request.sample is None:
            self._serve(request.name)
        elif isinstance(request.sample, PoseEstimateSample):
            x, y, _ = request.sample.position
            self.place, self.knows_place = (x, y, request.sample.heading), True
        elif isinstance(request.sample, PoseSample):
            x, y, _ = request.sample.position
            self._goal, self.drive, self._busy = (x, y), DrivePhase.DRIVING, 0.5
            self.goals.append((x, y))
        else:
            assert isinstance(request.sample, JointSample)
            ((name, value),) = request.sample.joints.items()
            self._request(request.name, name, value.position, value.velocity)

    def _request(self, topic: str, name: str, amount: float, rate: float) -> None:
        if topic == topics.DESCENT_REQUEST and name in (OBSERVATION_STOP, PLAIN_STOP):
            self._stop, self.descent = (name, amount), DescentPhase.TRAVELLING
        elif topic == topics.WINCH_REQUEST and name == WINCH_SLACK:
            self.length += amount - self.slack  # beyond the taut length
            self.slack, self.winch = amount, WinchMode.SLACK
            self.record(topic, Reason.COMPLETED, "slack given")
        elif topic == topics.WINCH_REQUEST:
            pays_out = amount > self.length + 0.01
            if pays_out and self.on_floor and self.refuses_payout:
                self.record(topic, RefusalCode.WRONG_PHASE, "the ground carries the rover")
                return
            self._length_goal, self.winch, self.rate = amount, WinchMode.LENGTH, rate
        elif name == JUMP_PREDICTION:
            self._predict()
        elif topic == topics.JUMP_REQUEST and self.jump:
            self.jump, self._busy = JumpPhase.FLIGHT, 3.0

    def _predict(self) -> None:
        reason = Reason.OUT_OF_LIMITS if self.rejection else Reason.COMPLETED
        self.record(
            topics.JUMP_REQUEST, reason, self.rejection, upright=repr(self.upright), stroke="0.13"
        )

    def _serve(self, service: str) -> None:
        if service == topics.WINCH_REARM:
            self.winch = WinchMode.HOLD
        elif service == topics.WINCH_HOLD:
            self.hold_winch()
            self.record(topics.WINCH_REQUEST, Reason.REQUESTED, "hold requested")
        elif service == topics.DESCENT_RELEASE:
            self.descent = DescentPhase.RELEASED
        elif service == topics.DESCENT_HOLD:
            self.descent = DescentPhase.HOLDING
        elif service == topics.DESCENT_RESUME:
            self.descent = DescentPhase.TRAVELLING
        elif service == topics.DESCENT_ABORT:
            self._stop, self.descent = None, DescentPhase.STANDBY
        elif service == topics.DRIVE_STOP:
            self._goal, self.drive = None, DrivePhase.RELEASED
        elif service == topics.JUMP_ABORT:
            self.jump, self.nut = JumpPhase.STANDBY, 0.0

    def restart_mission(self, after: float = 1.0) -> None:
        """Kill the mission and restart it after a time [s]."""
        saved = checkpoint_of(self.mission, self.now_ns)
        self.now += after
        self.mission = Mission(self.plan, self.settings)
        self.publish()
        restore(self.mission, saved, self.now_ns)


def start_mission(
    until: MissionPhase | None = None, plan: MissionPlan = PLAN, **settings: object
) -> MissionMachine:
    """A machine whose mission is active, or in a phase."""
    machine = MissionMachine(plan, MissionSettings(**settings))  # type: ignore[arg-type]
    machine.publish()
    machine.operator.go(machine.now_ns)
    if until is not None:
        machine.run(until=until)
        assert machine.mission.phase is until
    return machine


def finished(machine: MissionMachine) -> bool:
    """Whether the mission runs to its end."""
    machine.run()
    return machine.events[-3:].count(MissionEvent.COMPLETED) == 1


def results(machine: MissionMachine) -> set[LegResult]:
    """Results of the finished legs."""
    return {done.result for done in machine.mission.record}


def missed(machine: MissionMachine) -> list[str]:
    """Legs that were not completed."""
    return [done.leg for done in machine.mission.record if done.result is not LegResult.DONE]
