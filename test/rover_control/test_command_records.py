"""Each kind of request through its life: shipped controllers on the mock plant, without ROS."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import pytest
from driving import ON_MOCK_PLANT

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState, read_command
from msg_schemas.faults import Reason
from msg_schemas.machine import (
    HEADING_TURN,
    JUMP_STROKE,
    OBSERVATION_STOP,
    PLAIN_STOP,
    WINCH_AT_RATE,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import (
    JointSample,
    JointValue,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Sample,
    StatusSample,
    TwistSample,
)
from rover_launch.loop import component_class, make_plan, start_plan
from rover_launch.plan import HANGING_DEFAULTS
from rover_runtime.loop_host import LoopHost

ACCEPTED, RUNNING, DONE = CommandState.ACCEPTED, CommandState.RUNNING, CommandState.DONE
FAILED, SUPERSEDED, EXPIRED = CommandState.FAILED, CommandState.SUPERSEDED, CommandState.EXPIRED
REFUSED = CommandState.REFUSED
HANGING = {"tether.length": 5.0}
FLOOR = {"tether.length": 30.0, "start.position": [1.0, 0.0]}
QUICK: Mapping[str, Mapping[str, object]] = {
    # The mock plant has no swing that could be damped.
    "descent_node": {
        "estimator_settling_time": 1.0,
        "steady_dwell": 0.3,
        "exposures": 2,
        "steady_rate": 0.1,
        "damped_swing_rate": 0.1,
        "damped_yaw_rate": 0.1,
        "largest_swing": 0.5,
        "min_hold_time": 0.0,
    },
    "drive_node": ON_MOCK_PLANT,
}
PLAN = """\
about: one stop
stow: 4.8
looks: [{depth: 5.5}]
"""


class Machine:
    """Controllers with the mock plant, and the records that they publish."""

    def __init__(
        self,
        *controllers: str,
        scenario: str = "marius_hills",
        overrides: Mapping[str, object] | None = None,
        mission: Mapping[str, object] | None = None,
    ) -> None:
        self.host = LoopHost()
        self.records: list[CommandRecord] = []
        self.host.exchange.listen(self._on_records, topics.COMMANDS)
        merged = json.loads(HANGING_DEFAULTS["overrides"]) | dict(overrides or {})
        given = {"scenario": scenario, "overrides": json.dumps(merged), "plant": "mock"}
        planned = make_plan(controllers, HANGING_DEFAULTS, given)
        changed: dict[str, Mapping[str, object]] = {
            **QUICK,
            "mission_node": {"checkpoint": "none", **(mission or {})},
        }
        self.parameters = start_plan(self.host, planned, changed)
        self.host.run(1.0)
        if "winch_node" in controllers:
            self.call(topics.WINCH_REARM)

    def _on_records(self, _topic: str, sample: Sample, _sender: str, now_ns: int) -> None:
        assert isinstance(sample, StatusSample)
        assert sample.stamp_ns == now_ns
        for status in sample.statuses:
            record = read_command(status)
            assert record is not None
            self.records.append(record)

    def call(self, service: str) -> None:
        response = self.host.call(service)
        assert self.host.run(1.0, lambda: response.success is not None)

    def request(self, name: str, topic: str, joint: str, *value: float) -> None:
        sample = JointSample(0, {joint: JointValue(*value)})
        self.host.request(topic, sample, f"operator#{name}")

    def send(self, topic: str, sample: Sample) -> str:
        """Send what is identified by its stamp; returns that."""
        self.host.request(topic, sample)
        return str(self.host.now_ns())

    def pose(self, x: float, y: float) -> PoseSample:
        return PoseSample(self.host.now_ns(), (x, y, 0.0))

    def of(self, identifier: str) -> list[CommandRecord]:
        return [record for record in self.records if record.identifier == identifier]

    def life(self, identifier: str) -> list[CommandState]:
        """States of a command, repetitions left out."""
        states = [record.state for record in self.of(identifier)]
        return [each for k, each in enumerate(states) if k == 0 or each is not states[k - 1]]

    def run_to_end(self, identifier: str, limit: float = 60.0) -> CommandRecord:
        def has_ended() -> bool:
            found = self.of(identifier)
            return bool(found) and found[-1].state.is_over

        assert self.host.run(limit, has_ended), self.records
        return self.of(identifier)[-1]


def test_winch_requests_and_their_ends():
    machine = Machine("winch_node", overrides=HANGING)
    armed = machine.records[-1]
    assert (armed.subject, armed.state, armed.text) == (topics.WINCH_REARM, DONE, "armed")

    machine.request("far", topics.WINCH_REQUEST, WINCH_TO_LENGTH, 8.0, 0.1)
    machine.host.run(1.0)
    machine.request("near", topics.WINCH_REQUEST, WINCH_TO_LENGTH, 5.5, 0.2)
    done = machine.run_to_end("near")
    assert machine.life("far") == [ACCEPTED, RUNNING, SUPERSEDED]
    assert machine.of("far")[-1].reason is Reason.SUPERSEDED
    assert machine.life("near") == [ACCEPTED, RUNNING, DONE]
    progress = [record.progress for record in machine.of("near")[1:]]
    assert progress == sorted(progress)
    assert len(progress) > 5
    assert (done.node, done.sender, done.progress) == ("winch_node", "operator", 1.0)
    assert done.what == "winch_length 5.5 m"

    machine.request("held", topics.WINCH_REQUEST, WINCH_TO_LENGTH, 8.0, 0.1)
    machine.host.run(1.0)
    machine.call(topics.WINCH_HOLD)
    assert machine.run_to_end("held").reason is Reason.REQUESTED
    assert machine.life("held")[-1] is SUPERSEDED

    for _ in range(3):
        machine.request("jog", topics.WINCH_REQUEST, WINCH_AT_RATE, 0.0, 0.05)
        machine.host.run(0.5)
    assert machine.life("jog") == [ACCEPTED, RUNNING]
    assert machine.of("jog")[0].expiry == 1.0
    assert machine.run_to_end("jog").reason is Reason.RENEWAL_TIMEOUT
    assert machine.life("jog") == [ACCEPTED, RUNNING, EXPIRED]

    machine.request("late", topics.WINCH_REQUEST, WINCH_TO_LENGTH, 8.0)
    assert machine.run_to_end("late").reason is RefusalCode.NOT_ARMED
    assert machine.life("late") == [REFUSED]

    machine.call(topics.WINCH_REARM)
    machine.request("cut", topics.WINCH_REQUEST, WINCH_TO_LENGTH, 8.0, 0.1)
    machine.host.run(1.0)
    machine.host.stop("winch_node")
    assert machine.life("cut") == [ACCEPTED, RUNNING, FAILED]
    assert machine.of("cut")[-1].reason is Reason.SHUTDOWN


def test_stops_queue_and_are_held_resumed_and_aborted():
    machine = Machine("winch_node", "descent_node", overrides=HANGING)
    for name, joint, depth in (("1", PLAIN_STOP, 5.4), ("2", OBSERVATION_STOP, 5.8)):
        machine.request(name, topics.DESCENT_REQUEST, joint, depth)
    machine.host.run(3.0)
    assert (machine.life("1"), machine.life("2")) == ([ACCEPTED, RUNNING], [ACCEPTED])
    machine.call(topics.DESCENT_HOLD)
    assert machine.life("1")[-1] is machine.life("2")[-1] is SUPERSEDED
    machine.host.run(2.0)
    machine.call(topics.DESCENT_RESUME)
    assert machine.run_to_end("2", 300.0).number("pictures") == 2.0
    assert machine.life("1") == [ACCEPTED, RUNNING, SUPERSEDED, ACCEPTED, RUNNING, DONE]
    assert machine.life("2") == [ACCEPTED, SUPERSEDED, ACCEPTED, RUNNING, DONE]
    assert len({record.key for record in machine.of("1")}) == 2

    machine.request("turn", topics.DESCENT_REQUEST, HEADING_TURN, 0.2)
    machine.host.run(1.0)
    machine.request("3", topics.DESCENT_REQUEST, PLAIN_STOP, 8.0)
    machine.request("4", topics.DESCENT_REQUEST, PLAIN_STOP, 9.0)
    machine.host.run(5.0)
    turn = machine.of("turn")[-1]
    assert (turn.state, turn.reason) == (SUPERSEDED, Reason.SUPERSEDED)
    assert machine.life("3") == [ACCEPTED, RUNNING]
    machine.call(topics.DESCENT_ABORT)
    assert machine.life("3") == machine.life("4") == [ACCEPTED, RUNNING, SUPERSEDED]
    machine.call(topics.DESCENT_RESUME)
    assert machine.records[-1].reason is RefusalCode.WRONG_PHASE

    machine.request("5", topics.DESCENT_REQUEST, PLAIN_STOP, 15.0)
    machine.host.run(5.0)
    machine.host.exchange.impair(topics.IMU, lambda _sample: None)
    lost = machine.run_to_end("5")
    assert (lost.state, lost.reason) == (FAILED, Reason.SENSOR_TIMEOUT)
    sent = {record.sender for record in machine.records if record.node == "winch_node"}
    assert sent == {"", "/descent_node"}


def test_drives_to_goals_along_paths_and_by_velocity():
    machine = Machine("winch_node", "drive_node", scenario="floor_rubble", overrides=FLOOR)
    ahead = PoseEstimateSample(machine.host.now_ns(), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    start = machine.send(topics.DRIVE_START, ahead)
    machine.run_to_end(start)
    assert machine.life(start) == [DONE]

    goal = machine.send(topics.DRIVE_GOAL, machine.pose(1.6, 0.0))
    assert machine.run_to_end(goal).what == "(1.6, 0) m"
    assert machine.life(goal) == [ACCEPTED, RUNNING, DONE]

    replaced = machine.send(topics.DRIVE_GOAL, machine.pose(6.0, 0.0))
    machine.host.run(1.0)
    poses = (machine.pose(5.0, 0.0), machine.pose(6.0, 0.0))
    path = machine.send(topics.DRIVE_PATH, PathSample(machine.host.now_ns(), poses))
    machine.host.run(1.0)
    assert machine.life(replaced) == [ACCEPTED, RUNNING, SUPERSEDED]
    steered = machine.send(
        topics.CMD_VEL, TwistSample(machine.host.now_ns(), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    )
    machine.host.run(0.3)
    assert machine.life(path)[-1] is SUPERSEDED
    renewal = machine.send(
        topics.CMD_VEL, TwistSample(machine.host.now_ns(), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    )
    assert machine.run_to_end(steered).reason is Reason.RENEWAL_TIMEOUT
    assert machine.life(steered) == [ACCEPTED, RUNNING, EXPIRED]
    nothing = machine.send(
        topics.CMD_VEL, TwistSample(machine.host.now_ns(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    )
    far = machine.send(topics.DRIVE_GOAL, PoseSample(machine.host.now_ns() + 1, (400.0, 0.0, 0.0)))
    machine.host.run(0.5)
    assert not machine.of(renewal)
    assert not machine.of(nothing)
    refused = machine.of(str(int(far) + 1))
    assert [record.reason for record in refused] == [RefusalCode.OUT_OF_LIMITS]

    stopped = machine.send(topics.DRIVE_GOAL, machine.pose(6.0, 0.0))
    machine.host.run(1.0)
    machine.call(topics.DRIVE_STOP)
    assert machine.of(stopped)[-1].reason is Reason.REQUESTED
    lost = machine.send(topics.DRIVE_GOAL, machine.pose(6.0, 0.0))
    machine.host.run(1.0)
    machine.host.exchange.impair(topics.CONTACT, lambda _sample: None)
    assert machine.run_to_end(lost).reason is Reason.FAULT
    assert machine.life(lost) == [ACCEPTED, RUNNING, FAILED]


def test_jumps_and_slack():
    machine = Machine("winch_node", "jump_node", scenario="floor_rubble", overrides=FLOOR)
    machine.host.run(1.0)  # the winch detects the touchdown
    machine.request("slack", topics.WINCH_REQUEST, WINCH_SLACK, 0.1)
    machine.run_to_end("slack")
    assert machine.life("slack") == [ACCEPTED, RUNNING, DONE]
    machine.request("jump", topics.JUMP_REQUEST, JUMP_STROKE, 0.1)
    machine.host.run(1.0)
    machine.request("busy", topics.JUMP_REQUEST, JUMP_STROKE, 0.1)
    machine.run_to_end("jump")
    assert machine.life("jump") == [ACCEPTED, RUNNING, DONE]
    phases = [record.text for record in machine.of("jump") if record.state is RUNNING]
    assert phases == ["compressing", "settling", "releasing", "flight", "landed"]
    assert machine.of("busy")[-1].reason is RefusalCode.WRONG_PHASE
    machine.request("aborted", topics.JUMP_REQUEST, JUMP_STROKE, 0.1)
    machine.host.run(1.0)
    machine.call(topics.JUMP_ABORT)
    assert machine.life("aborted") == [ACCEPTED, RUNNING, SUPERSEDED]


@pytest.fixture
def mission(tmp_path: Path) -> Machine:
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    own = {"plan": str(plan)}
    return Machine(
        "winch_node", "descent_node", "mission_node", overrides=HANGING, mission=own
    )  # fmt: skip


def test_a_mission_is_held_resumed_and_done(mission: Machine):
    def lives(subject: str) -> list[CommandState]:
        """States of the last command of a service, repetitions left out."""
        found = [record for record in mission.records if record.subject == subject]
        states = [record.state for record in found if record.key == found[-1].key]
        return [each for k, each in enumerate(states) if k == 0 or each is not states[k - 1]]

    mission.call(topics.MISSION_RESUME)
    assert lives(topics.MISSION_RESUME) == [REFUSED]
    mission.call(topics.MISSION_GO)
    mission.host.run(5.0)
    assert lives(topics.MISSION_GO) == [ACCEPTED, RUNNING]
    mission.call(topics.MISSION_HOLD)
    assert lives(topics.MISSION_GO) == [ACCEPTED, RUNNING, SUPERSEDED]
    assert lives(topics.MISSION_HOLD) == [DONE]
    mission.host.run(5.0)
    mission.call(topics.MISSION_RESUME)
    mission.host.run(60.0, lambda: lives(topics.MISSION_RESUME)[-1].is_over)
    assert lives(topics.MISSION_RESUME) == [ACCEPTED, RUNNING, DONE]
    legs = {record.text for record in mission.records if record.subject == topics.MISSION_RESUME}
    assert {"look from 5.5 m", "ascend to 4.8 m", "stow"} <= legs
    stops = [record for record in mission.records if record.subject == topics.DESCENT_REQUEST]
    assert {record.sender for record in stops} == {"/mission_node"}
    last = [record for record in mission.records if record.subject == topics.MISSION_RESUME][-1]
    assert last.progress == 1.0
    assert math.isinf(last.expiry)


def test_an_operator_aborts_a_mission_and_a_restart_begins_with_a_new_log(mission: Machine):
    mission.call(topics.MISSION_GO)
    mission.host.run(3.0)
    mission.call(topics.MISSION_ABORT)
    go = [record for record in mission.records if record.subject == topics.MISSION_GO]
    assert (go[-1].state, go[-1].reason) == (SUPERSEDED, Reason.REQUESTED)
    mission.host.kill("mission_node")
    begun = mission.records.copy()
    mission.host.start(component_class("mission_node"), mission.parameters["mission_node"])
    mission.host.run(1.0)
    assert "mission_node" not in {record.node for record in mission.records[len(begun) :]}
