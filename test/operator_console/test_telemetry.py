"""Values have ages and become stale; nodes have health."""

import io
import json
import math
from dataclasses import replace

import pytest
from rich.console import Console, RenderableType

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.commands import CommandRecord, CommandState, read_command
from msg_schemas.events import NodeEvent
from msg_schemas.health import Health
from msg_schemas.phases import HealthState, PlantPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    Level,
    Status,
    StatusSample,
    TextSample,
    WrenchSample,
)
from msg_schemas.table import TOPICS
from operator_console.liveness import SILENT_AFTER
from operator_console.telemetry import PHASE_TOPICS, QUANTITIES, TELEMETRY_TOPICS, Telemetry
from operator_console.views import command_view, status_view
from rover_runtime.refusal_log import RefusalLog


def health(node: str, *more: Status, missing: tuple[str, ...] = ()) -> StatusSample:
    state = HealthState.WAITING if missing else HealthState.READY
    return StatusSample(1, (Health(node, state, missing).status({}), *more))


def estimate(length: float, rate: float, tension: float, valid: bool = True) -> JointSample:
    return JointSample(
        1,
        {
            machine.PAYOUT: JointValue(length, rate),
            machine.TENSION: JointValue(float(valid), 0.0, tension),
        },
    )


def drum(length: float, rate: float = 0.0, brake: float = 0.0, stamp: int = 0) -> JointSample:
    joints = {
        machine.WINCH_DRUM: JointValue(length, rate),
        machine.WINCH_BRAKE: JointValue(brake),
    }
    return JointSample(stamp * 10_000_000, joints)


def test_every_quantity_and_phase_is_in_the_contract_and_subscribed():
    for row in QUANTITIES:
        for topic, path in row.sources:
            assert topic in TELEMETRY_TOPICS
            assert path in TOPICS[topic].by_path or path == "force", (topic, path)
    for topic in PHASE_TOPICS:
        assert topic in TELEMETRY_TOPICS
        assert TOPICS[topic].words
        assert any(topic in access.publishes for access in ACCESS.values())


def test_nothing_is_known_at_first():
    now = Telemetry().snapshot(5.0)
    assert all(reading.value is None and reading.is_stale for reading in now.readings)
    assert not now.nodes
    assert json.loads(json.dumps(now.as_dict()))["alarms"] == []


def test_a_value_becomes_stale_and_stays_readable():
    known = Telemetry()
    known.on_sample(topics.WINCH_ESTIMATE, estimate(12.3456, -0.01, 16.2), 10.0)
    fresh, old = known.snapshot(10.6).reading("depth"), known.snapshot(12.5).reading("depth")
    assert (fresh.text, fresh.is_stale) == ("12.346 m", False)
    assert (old.text, old.is_stale, old.age) == ("12.346 m", True, 2.5)


def test_the_next_source_replaces_a_stale_or_invalid_one():
    known = Telemetry()
    known.on_sample(topics.WINCH_ESTIMATE, estimate(12.0, 0.0, 0.0, valid=False), 10.0)
    known.on_sample(topics.LOAD_CELL, WrenchSample(1, (3.0, 0.0, -4.0)), 10.0)
    known.on_sample(topics.WINCH_STATE, drum(12.5, brake=1.0), 13.0)
    now = known.snapshot(13.1)
    assert now.reading("tension").value == pytest.approx(5.0)
    assert now.reading("tension").is_stale
    assert now.reading("depth").value == 12.5
    assert not now.reading("depth").is_stale
    brake = next(each for each in QUANTITIES if each.key == "brake_released")
    assert brake.states is not None
    assert now.reading(brake.key).text == brake.states[1]


def test_angles_are_in_degrees_and_budgets_in_percent():
    known = Telemetry()
    joints = {
        machine.SWING_MAJOR: JointValue(math.radians(1.5)),
        machine.WHEEL_BUDGET: JointValue(-1.2),
        machine.HEADING: JointValue(-1e-9),
    }
    known.on_sample(topics.DESCENT_STATE, JointSample(1, joints), 1.0)
    now = known.snapshot(1.0)
    assert now.reading("swing_major").text == "1.50 deg"
    assert now.reading("wheels_budget").text == "-120 %"
    assert now.reading("wheels_budget").is_warning
    assert now.reading("heading").text == "0.0 deg"


def test_a_phase_is_as_fresh_as_its_node():
    known = Telemetry()
    known.on_sample(topics.WINCH_MODE, TextSample(WinchMode.FAULT), 1.0)
    assert known.snapshot(1.1).reading("winch").is_stale  # latched by a node that has ended
    known.on_sample(topics.DIAGNOSTICS, health("winch_node"), 50.0)
    now = known.snapshot(50.5).reading("winch")
    assert (now.value, now.is_stale, now.is_warning) == ("fault", False, True)
    assert known.snapshot(50.5 + SILENT_AFTER).reading("winch").is_stale


def test_the_plant_s_phase_is_fresh_with_any_plant():
    known = Telemetry()
    known.on_sample(topics.TRUTH_PHASE, TextSample(PlantPhase.HANGING), 1.0)
    known.on_sample(topics.DIAGNOSTICS, health("winch_node"), 1.0)
    assert known.snapshot(1.1).reading("plant").is_stale
    known.on_sample(topics.DIAGNOSTICS, health("mock_plant"), 1.0)
    assert not known.snapshot(1.1).reading("plant").is_stale


def test_a_node_reports_its_problems_and_becomes_silent():
    known = Telemetry()
    bad = Status("winch_node: mode", "fault: node_late", Level.ERROR, "winch_node")
    good = Status("winch_node: tension", "normal", Level.OK, "winch_node")
    known.on_sample(topics.DIAGNOSTICS, health("winch_node", bad, good), 1.0)
    (node,) = known.snapshot(2.0).nodes
    assert (node.condition, node.level, node.is_silent) == ("ready", "ERROR", False)
    assert node.details == ("mode: fault: node_late",)
    known.on_sample(topics.DIAGNOSTICS, health("winch_node"), 3.0)
    (node,) = known.snapshot(3.1 + SILENT_AFTER).nodes
    assert (node.level, node.is_silent, node.details) == ("OK", True, ())


def inactive(node: str) -> StatusSample:
    return StatusSample(0, (Health(node, HealthState.INACTIVE).status({}),))


def test_a_node_that_ended_well_is_forgotten_and_a_killed_one_is_silent():
    known = Telemetry()
    known.on_sample(topics.DIAGNOSTICS, health("winch_node"), 1.0)
    known.on_sample(topics.DIAGNOSTICS, inactive("jump_node"), 1.0)
    assert {node.node for node in known.snapshot(1.1).nodes} == {"winch_node", "jump_node"}
    (node,) = known.snapshot(1.1 + SILENT_AFTER).nodes
    assert (node.node, node.is_silent) == ("winch_node", True)


def test_drives_on_a_link_may_follow_a_simulation_that_has_ended():
    known = Telemetry()
    running = Status("sim_node: simulation", "running", Level.OK, "sim_node", {"paused": "false"})
    snag = JointSample(1, {"snag": JointValue(1.0)})
    known.on_sample(topics.CLOCK, ClockSample(10**9), 1.0)
    known.on_sample(topics.SIM_STATUS, StatusSample(1, (running,)), 1.0)
    known.on_sample(topics.WINCH_ALARMS, snag, 1.0)
    for node in ("sim_node", "winch_node"):
        known.on_sample(topics.DIAGNOSTICS, inactive(node), 1.0)
    over = known.snapshot(60.0)
    assert (over.has_plant, over.is_clock_over, over.alarms, over.dangers) == (False, False, (), ())

    line = Status("hil_bridge: link", "operational", Level.OK, "hil_bridge", {})
    for now in (60.0, 60.1):
        known.on_sample(topics.LINK_STATUS, StatusSample(1, (line,)), now)
        known.on_sample(topics.WINCH_STATE, drum(10.0), now)
        for node in ("hil_bridge", "winch_node"):
            known.on_sample(topics.DIAGNOSTICS, health(node), now)
    hardware = known.snapshot(60.1)
    assert (hardware.has_plant, hardware.is_clock_over, hardware.dangers) == (True, True, ())
    assert hardware.obstacle(["winch_node"]) == ""
    assert known.snapshot(70.0).dangers[0].part == "link"


def test_however_many_names_are_sent_few_are_kept():
    known = Telemetry()
    for number in range(1000):
        parts = tuple(Status(f"n{number}: part {part}", "m", Level.WARN) for part in range(1000))
        if number > 10:
            parts = ()
        known.on_sample(topics.DIAGNOSTICS, health(f"n{number}", *parts), 1.0)
        known.on_sample(
            topics.CONFIG, TextSample(f'{{"node": "/n{number}", "parameters": {{}}}}'), 1
        )
        link = Status(f"device {number}", "m", Level.OK)
        known.on_sample(topics.LINK_STATUS, StatusSample(0, (link,)), 1.0)
    present = known.snapshot(1.0)
    assert len(present.nodes) == len(present.link) == 64
    assert present.nodes[-1].node == "n999"
    assert max(len(node.details) for node in present.nodes) <= 64


def test_refusals_are_separate_from_health():
    known = Telemetry()
    refusal = Refusal(topics.WINCH_REQUEST, RefusalCode.NOT_ARMED, "the winch is in stop")
    status = RefusalLog("winch_node").take(refusal)
    assert status is not None
    known.on_sample(topics.DIAGNOSTICS, health("winch_node"), 1.0)
    known.on_sample(topics.DIAGNOSTICS, StatusSample(2_500_000_000, (status,)), 1.0)
    now = known.snapshot(1.5)
    (shown,) = now.refusals
    assert (shown.node, shown.stamp) == ("winch_node", 2.5)
    assert "in stop" in shown.message
    assert shown.values["code"] == "not_armed"
    assert now.nodes[0].level == "OK"


def test_only_active_alarms_are_shown():
    known = Telemetry()
    joints = {name: JointValue(float(name == "snag")) for name in machine.ALARM_NAMES}
    known.on_sample(topics.WINCH_ALARMS, JointSample(1, joints), 1.0)
    assert known.snapshot(1.0).alarms == ("snag",)


@pytest.mark.parametrize(
    ("rate", "brake", "jump", "rests"),
    [
        (0.0, 0.0, "standby", True),
        (0.0, 0.0, "compressing", False),
        (-0.05, 0.0, "standby", False),
        (0.0, 1.0, "standby", False),
    ],
)
def test_rest_requires_half_a_second_of_the_drum_s_own_time(
    rate: float, brake: float, jump: str, rests: bool
):
    known = Telemetry()
    known.on_sample(topics.JUMP_PHASE, TextSample(jump), 0.5)
    assert not known.is_at_rest(0.0)
    for tick in range(52):  # slow simulated time: 0.01 s per 0.1 s
        known.on_sample(topics.WINCH_STATE, drum(12.0, 0.2, 1.0, stamp=tick), tick * 0.1)
    for tick in range(52, 102):
        known.on_sample(topics.WINCH_STATE, drum(12.0, rate, brake, stamp=tick), tick * 0.1)
    assert not known.is_at_rest(0.0)
    known.on_sample(topics.WINCH_STATE, drum(12.0, rate, brake, stamp=102), 10.2)
    assert known.is_at_rest(5.1) is rests
    assert not known.is_at_rest(5.2)


def test_a_parameter_is_read_from_the_configuration():
    known = Telemetry()
    content = {"node": "/mother/descent_node", "parameters": {"min_depth": 1.6}}
    known.on_sample(topics.CONFIG, TextSample(json.dumps(content)), 1.0)
    known.on_sample(topics.CONFIG, TextSample(json.dumps({"node": "/mother/winch_node"})), 1.0)
    known.on_sample(topics.CONFIG, TextSample("[1]"), 1.0)
    assert known.parameter("descent_node", "min_depth") == 1.6
    assert known.parameter("descent_node", "lowest") is None
    assert known.parameter("winch_node", "min_depth") is None


def test_a_node_that_reports_its_health_is_alive():
    known = Telemetry()
    known.on_sample(topics.WINCH_MODE, TextSample(WinchMode.HOLD), 1.0)
    assert not known.has_any_node
    known.on_sample(topics.DIAGNOSTICS, health("a"), 1.0)
    assert known.has_any_node


def command(node: str, identifier: str, state: CommandState, taken_ns: int) -> StatusSample:
    record = CommandRecord(node, topics.WINCH_REQUEST, "rover", identifier, taken_ns, state)
    return StatusSample(taken_ns + 1, (record.status(),))


def test_the_latest_record_of_each_command_is_kept_and_a_restart_loses_the_open_ones():
    known = Telemetry()
    for sample in (
        command("winch_node", "1", CommandState.RUNNING, 10),
        command("winch_node", "2", CommandState.RUNNING, 20),
        command("jump_node", "3", CommandState.RUNNING, 15),
        command("winch_node", "1", CommandState.DONE, 10),
    ):
        known.on_sample(topics.COMMANDS, sample, 0.0)
    states = {each.name: each.state for each in known.snapshot(0.0).commands}
    assert states == {"rover#2": "running", "rover#3": "running", "rover#1": "done"}
    assert known.snapshot(0.0).commands[-1].name == "rover#1", "the last changed one comes last"
    started = StatusSample(30, (Status(NodeEvent.ACTIVE, "", Level.OK, "winch_node"),))
    known.on_sample(topics.EVENTS, started, 0.0)
    found = {each.name: each for each in known.snapshot(0.0).commands}
    assert found["rover#2"].state == "failed"
    assert found["rover#2"].reason == "restarted"
    assert found["rover#3"].state == "running"
    assert found["rover#1"].state == "done"
    for number in range(100):
        sample = command("winch_node", str(number), CommandState.DONE, 40 + number)
        known.on_sample(topics.COMMANDS, sample, 0.0)
    assert len(known.snapshot(0.0).commands) == 50


def test_commands_are_shown_with_progress_and_reason():
    known = Telemetry()
    running = CommandRecord(
        "winch_node", topics.WINCH_REQUEST, "", "7", 2_000_000_000, CommandState.RUNNING,
        "winch_length 8 m", progress=0.3,
    )  # fmt: skip
    refused = CommandRecord(
        "winch_node", topics.WINCH_REQUEST, "[bold]x", "8", 2_000_000_000, CommandState.REFUSED,
        reason=RefusalCode.NOT_ARMED, text="in fault",
    )  # fmt: skip
    for record in (running, refused):
        known.on_sample(topics.COMMANDS, StatusSample(3_000_000_000, (record.status(),)), 0.0)
    first, second = printed(command_view(known.snapshot(0.0).commands)).splitlines()
    assert "winch/request winch_length 8 m" in first
    assert "running 30 %" in first
    assert "[bold]x#8" in second
    assert "in fault [not_armed]" in second


def printed(view: RenderableType) -> str:
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(view)
    return console.export_text()


@pytest.mark.parametrize(
    ("measured", "shown"),
    [("0.4012", "running; 0.4 × real time"), ("", "running"), ("nan", "running"), ("x", "running")],
)
def test_the_terminal_shows_the_speed_that_a_simulation_reaches(measured: str, shown: str):
    known = Telemetry()
    values = {"real_time_factor": "1.0", "measured_real_time_factor": measured}
    plant = Status("sim_node: plant", "running", hardware_id="sim_node", values=values)
    known.on_sample(topics.SIM_STATUS, StatusSample(1, (plant,)), 0.0)
    lines = printed(status_view(known.snapshot(0.0))).splitlines()
    (line,) = (line for line in lines if "simulation" in line)
    assert line.strip("│ ").removeprefix("simulation").strip() == shown


def test_names_are_no_markup():
    known = Telemetry()
    known.on_sample(topics.DIAGNOSTICS, health("[/x]"), 0.0)
    event = Status("[/y]", "[/z]", Level.ERROR, "[/node]", {"code": "[/code]"})
    known.on_sample(topics.EVENTS, StatusSample(1, (event,)), 0.0)
    line = Status("hil_bridge: [/station]", "", Level.OK, "[/link]")
    known.on_sample(topics.LINK_STATUS, StatusSample(1, (line,)), 0.0)
    shown = printed(status_view(known.snapshot(0.0)))
    for name in ("[/x]", "[/y]: [/z] [[/code]]", "[/node]", "link: [/station]"):
        assert name in shown


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("taken", "9" * 400),
        ("taken", "-1"),
        ("progress", "inf"),
        ("progress", "nan"),
        ("progress", "2"),
    ],
)
def test_a_record_with_a_number_beyond_its_limits_is_none(key: str, value: str):
    (status,) = command("winch_node", "1", CommandState.RUNNING, 10).statuses
    wrong = replace(status, values={**status.values, key: value})
    assert read_command(status) is not None
    assert read_command(wrong) is None
