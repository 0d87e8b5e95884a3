"""Bridge and emulated machine together, cycle by cycle: motion, watchdogs, refusals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import BridgeEvent, EmulatorEvent
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level
from rover_hil.bridge.commissioning import is_checked
from rover_hil.bridge.drive_channel import (
    DISABLED,
    ENABLED,
    FAULT,
    QUICK_STOP,
    SWITCHED_ON,
    DriveChannel,
)
from rover_hil.bridge.link_report import link_status
from rover_hil.bridge.statistics import percentiles
from rover_hil.bridge.wiring import AT_REST, COMMANDED, PUBLISHED
from rover_hil.canopen.devices import DEVICES, SYNC_PERIOD, WINCH, ErrorCode
from rover_hil.canopen.dictionary import object_dictionary
from rover_hil.canopen.link import unpack
from rover_hil.canopen.objects import Pdo
from rover_sim import Simulation, build_interface, build_plant, load_spatial
from rover_verify.harness.hil_bench import HilBench

WEIGHT = 16.2
RATE = 0.3
PRE_OPERATIONAL = 127
STOP = 0.26 + RATE / 0.4 + 0.1  # timeout, quick stop, brake [s]


def simulation(error_model: str = "ideal") -> Simulation[Any]:
    scenario = load_spatial("free_hang", {"sensors.error_model": error_model})
    return Simulation(build_interface(build_plant(scenario), 1), SYNC_PERIOD)


@pytest.fixture
def bench(compiled_in_space: None) -> Iterator[HilBench]:
    made = HilBench(simulation(), rover_offset=1.25)
    yield made
    made.close()


def winch(rate: float = RATE, brake: float = 1.0) -> dict[str, JointSample]:
    joints = {
        machine.WINCH_DRUM: JointValue(20.0, rate, WEIGHT),
        machine.WINCH_BRAKE: JointValue(brake),
        machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
    }
    return {topics.WINCH_COMMAND: JointSample(0, joints)}


def drum(bench: HilBench) -> JointValue:
    sample = bench.published[topics.WINCH_STATE]
    assert isinstance(sample, JointSample)
    return sample.joints[machine.WINCH_DRUM]


def brake_is_open(bench: HilBench) -> bool:
    sample = bench.published[topics.WINCH_STATE]
    assert isinstance(sample, JointSample)
    return sample.joints[machine.WINCH_BRAKE].position == 1.0


def paying_out(bench: HilBench) -> None:
    bench.arm()
    bench.cycles(0.6, winch())
    assert drum(bench).velocity == pytest.approx(RATE, rel=0.1)  # the rover swings up and down
    assert brake_is_open(bench)


def assert_stops(bench: HilBench, within: float) -> None:
    """The plant's drum stands still with its brake closed."""
    bench.cycles(within)
    state = bench.simulation.state
    assert bench.simulation.interface.drive_feedback(state).payout_rate == 0.0
    assert not bench.machine.drives["winch"].automaton.enabled


# ------------------------------------------------------------------------------- published topics


def test_all_topics_equal_those_of_the_direct_simulation(bench: HilBench):
    bench.cycles(0.1)
    assert set(bench.published) == set(PUBLISHED)
    stamp_ns = bench.simulation.stamp_ns - round(SYNC_PERIOD * 1e9)
    direct = dict(bench.simulation.interface.samples(PUBLISHED))
    for topic, sample in bench.published.items():
        mine = dict(sample.scalars())
        assert getattr(sample, "stamp_ns") == stamp_ns  # noqa: B009 - all samples here have one
        for path, value in direct[topic].scalars():
            assert mine[path] == pytest.approx(value, abs=0.05), (topic, path)


def test_a_clock_offset_is_estimated_within_its_uncertainty(bench: HilBench):
    bench.cycles(0.1)
    now_ns = bench.simulation.stamp_ns
    for name, station in bench.bridge.stations.items():
        found = station.clock.now(now_ns)
        assert found is not None
        truth = 1.25 if station.device.is_on_rover else 0.0
        assert abs(found.value - truth) <= found.uncertainty + 1e-9, name


# ------------------------------------------------------------------------------------------ arming


def test_a_command_before_arming_is_refused_with_the_remedy(bench: HilBench):
    bench.cycles(0.1)
    with pytest.raises(Refusal, match=topics.DRIVES_ARM) as refused:
        bench.cycle(winch())
    assert refused.value.code is RefusalCode.NOT_ARMED
    bench.cycle(winch(rate=0.0, brake=0.0))  # requests no motion, is not refused
    assert all(channel.state == DISABLED for channel in bench.bridge.channels.values())


def test_arming_is_refused_while_a_drive_is_missing_or_not_the_expected_one(
    bench: HilBench,
):
    with pytest.raises(Refusal, match="no answer on the link: jump, wheel, winch"):
        bench.bridge.arm(0)
    bench.cycles(0.1)
    bench.bridge.on_device_checked(WINCH, "1018h:03 Revision number is 1, should be 65536")
    with pytest.raises(Refusal, match="winch: 1018h:03 Revision"):
        bench.bridge.arm(bench.simulation.stamp_ns)
    assert not any(channel.armed for channel in bench.bridge.channels.values())
    bench.bridge.arm(bench.simulation.stamp_ns)  # it was checked again, without a difference


def test_arming_is_refused_while_another_bridge_is_on_the_link(bench: HilBench):
    bench.cycles(0.1)

    def is_reported(text: str) -> bool:
        status = link_status("hil_bridge", bench.bridge, bench._bridge_link, bench._now_ns())
        return status.level is Level.ERROR and text in str(status)

    bench.bridge.on_other_bridge(bench.simulation.stamp_ns)
    with pytest.raises(Refusal, match="another bridge"):
        bench.bridge.arm(bench.simulation.stamp_ns)
    assert is_reported("another bridge is on the link")
    bench.cycles(0.5)
    bench.arm()
    bench._bridge_link.problem = "No buffer space available"
    assert is_reported("cannot send: No buffer space available")


def test_a_drive_with_heartbeat_but_unknown_state_counts_as_missing(
    bench: HilBench,
):
    now_ns = bench.simulation.stamp_ns
    for station in bench.bridge.stations.values():
        bench.bridge.on_heartbeat(station.device, PRE_OPERATIONAL, now_ns)
    assert bench.bridge.missing_devices(now_ns) == ("jump", "wheel", "winch")
    bench.cycles(0.1)
    assert bench.bridge.missing_devices(bench.simulation.stamp_ns) == ()


def test_armed_drives_are_switched_on_and_enabled_by_their_first_command(bench: HilBench):
    bench.arm()
    states = {name: channel.state for name, channel in bench.bridge.channels.items()}
    assert set(states.values()) == {SWITCHED_ON}
    bench.cycles(0.02, winch(rate=0.0))
    assert bench.bridge.channels["winch"].state == ENABLED
    assert bench.bridge.channels["wheel"].state == SWITCHED_ON


@pytest.mark.parametrize(
    ("topic", "joints", "state_topic", "joint"),
    [
        (
            topics.WHEEL_COMMAND,
            {machine.WHEEL_DRIVE: JointValue(0.0, 2.0, 1.0)},
            topics.WHEEL_STATE,
            machine.WHEEL_LEFT,
        ),
        (
            topics.WHEEL_TORQUE_COMMAND,
            {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, 0.2)},
            topics.WHEEL_STATE,
            machine.WHEEL_LEFT,
        ),
        (
            topics.FLYWHEEL_COMMAND,
            {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.05)},
            topics.FLYWHEEL_STATE,
            machine.FLYWHEEL,
        ),
        (
            topics.JUMP_MOTOR_COMMAND,
            {machine.JUMP_SCREW: JointValue(-0.01, 0.02, 100.0)},
            topics.JUMP_MOTOR_STATE,
            machine.JUMP_SCREW,
        ),
    ],
)
def test_each_motor_follows_its_command(
    bench: HilBench, topic: str, joints: dict[str, JointValue], state_topic: str, joint: str
):
    bench.arm()
    before = bench.published[state_topic]
    bench.cycles(0.5, {topic: JointSample(0, joints)})
    after = bench.published[state_topic]
    assert isinstance(before, JointSample)
    assert isinstance(after, JointSample)
    distance = after.joints[joint].position - before.joints[joint].position
    assert abs(distance) > 1e-3
    assert not bench.has_event(EmulatorEvent.SETPOINT_REFUSED, "jump")


def test_the_wheel_drive_reports_the_torque_of_its_current(bench: HilBench):
    bench.arm()
    measured = bench.machine.devices["wheel"].values
    for torque in (0.4, -0.4):
        command = JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, torque)})
        bench.cycles(0.1, {topics.WHEEL_TORQUE_COMMAND: command})
        # The gear's friction adds to it.
        assert 0.35 < math.copysign(1.0, torque) * measured["torque"] < 0.7


@pytest.mark.parametrize(
    ("change", "name", "counts"),
    [
        ({"winch.quick_stop_deceleration": 0.8}, "winch", 800_000),
        ({"rover.wheel_drive.quick_stop_deceleration": 5.0}, "wheel", 5000),
        ({"rover.jump_drive.quick_stop_deceleration": 50.0}, "jump", 50_000),
    ],
)
def test_a_drive_has_the_quick_stop_deceleration_of_the_scenario(
    change: dict[str, object], name: str, counts: int
):
    scenario = load_spatial("free_hang", change)
    bench = HilBench(Simulation(build_interface(build_plant(scenario), 1), SYNC_PERIOD))
    drive, node = bench.machine.drives[name], bench.machine.drives[name].node
    node.set_data(0x6085, 0, bytes(4))
    drive.power_on()
    read = int.from_bytes(node.get_data(0x6085, 0, check_readable=True), "little")
    other = int.from_bytes(node.get_data(0x605A, 0, check_readable=True), "little")
    bench.close()
    assert (read, other) == (counts, 2)
    # The bridge compares it with the dictionary, which holds the default machine's.
    device = next(each for each in DEVICES if each.name == name)
    default = device.by_key["quick_stop_deceleration"].default
    assert default == {"winch": 400_000, "wheel": 3000, "jump": 75_000}[name]
    variable = object_dictionary(device).get_variable(0x6085)
    assert variable is not None
    assert is_checked(variable)


# ------------------------------------------------------------------------------------ end of motion


def test_a_command_timeout_stops_the_drive_and_the_next_command_starts_it(
    bench: HilBench,
):
    paying_out(bench)
    assert_stops(bench, STOP)
    assert bench.has_event(BridgeEvent.COMMANDS_CEASED, "winch")
    assert bench.bridge.channels["winch"].state == SWITCHED_ON
    assert not brake_is_open(bench)
    bench.cycles(0.5, winch())
    assert brake_is_open(bench)


def test_a_dead_bridge_stops_the_drives_by_their_watchdogs(bench: HilBench):
    paying_out(bench)
    bench.bridge_is_on = False
    before = drum(bench).position
    assert_stops(bench, STOP)
    assert bench.machine.drives["winch"].automaton.error_code is ErrorCode.RPDO_TIMEOUT
    drives = bench.simulation.interface.drive_feedback(bench.simulation.state)
    # The timeout alone gives 0.078 m, with the ramp 0.19 m; a brake at once adds 0.04 m only.
    assert 0.15 < drives.length - before < 0.2


@pytest.mark.parametrize("delay", [0.3, 0.37, 0.45])
def test_late_commands_keep_no_drive_active_beyond_the_age_of_their_sample(
    bench: HilBench, delay: float
):
    commands = {
        **winch(),
        topics.WHEEL_COMMAND: JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 0.5)}),
    }
    bench.arm()
    bench.cycles(0.4, commands)
    assert {"winch", "wheel"} <= bench.driven
    bench.impair(f"{{kind: delay, magnitude: {delay}}}")
    bench.cycles(0.5, commands, [])
    bench.cycles(0.005, commands, [])
    assert not bench.driven


def restart_bridge(bench: HilBench, downtime: float) -> None:
    bench.bridge_is_on = False
    bench.cycles(downtime)
    bench.restart_bridge()
    bench.bridge_is_on = True


def restart_plant(bench: HilBench) -> None:
    bench.simulation.reset_plant()
    bench.machine.restart()


@pytest.mark.parametrize(
    "restart",
    [partial(restart_bridge, downtime=0.05), partial(restart_bridge, downtime=STOP), restart_plant],
)
def test_after_a_restart_nothing_moves_until_it_is_armed(
    bench: HilBench, restart: Callable[[HilBench], None]
):
    commands = {
        **winch(),
        topics.WHEEL_COMMAND: JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 0.5)}),
        topics.FLYWHEEL_COMMAND: JointSample(0, {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.05)}),
    }
    bench.arm()
    bench.cycles(0.6, commands)
    assert {"winch", "wheel"} <= bench.driven
    restart(bench)
    bench.cycles(STOP, commands, [])
    for _ in range(20):
        bench.cycles(0.05, commands, [])
        assert not bench.driven
        assert_stops(bench, 0.0)
    with pytest.raises(Refusal, match=topics.DRIVES_ARM):
        bench.cycle(winch())
    bench.arm()  # resets the fault: its cause is gone
    bench.cycles(0.5, winch())
    assert brake_is_open(bench)


def test_a_reset_plant_does_not_execute_earlier_setpoints(bench: HilBench):
    bench.arm()
    bench.cycles(0.3, {
        topics.WHEEL_COMMAND: JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 10.0, 1.0)}),
        topics.FLYWHEEL_COMMAND: JointSample(0, {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.05)}),
    })  # fmt: skip
    restart_plant(bench)
    feedback = bench.simulation.interface.drive_feedback(bench.simulation.state)
    assert (feedback.wheel_rate, feedback.flywheel_rate) == (0.0, 0.0)


def test_only_the_drive_that_restarts_is_disarmed(bench: HilBench):
    paying_out(bench)
    bench.machine.drives["winch"].power_on()
    with pytest.raises(Refusal, match="not armed"):
        bench.cycles(0.1, winch())
    assert_stops(bench, STOP)
    assert bench.has_event(BridgeEvent.RESTARTED, "winch")
    assert bench.has_event(BridgeEvent.TRIPPED, "winch")
    assert not bench.bridge.channels["winch"].armed
    assert bench.bridge.channels["wheel"].armed


def test_a_fault_brakes_is_reported_with_its_code_and_reset_only_when_its_cause_is_gone(
    bench: HilBench,
):
    paying_out(bench)
    bench.impair("{kind: drive_fault, target: winch, cause: overtemperature}")
    with pytest.raises(Refusal, match="not armed"):
        bench.cycles(0.1, winch())
    assert_stops(bench, STOP)
    emergencies = [change for _, change in bench.changes if change.name is BridgeEvent.EMERGENCY]
    assert emergencies[0].level is Level.ERROR
    assert emergencies[0].values["error_code"] == ErrorCode.DRIVE_OVERTEMPERATURE
    bench.arm()
    assert bench.bridge.channels["winch"].state == FAULT
    bench.impair("")
    bench.arm()
    assert bench.bridge.channels["winch"].state == SWITCHED_ON


@pytest.mark.parametrize(
    ("is_moving", "controlword"),
    # Disable voltage, quick stop, shutdown, disable operation.
    [*((True, word) for word in (0x00, 0x02, 0x06, 0x07)), (False, 0x00), (False, 0x06)],
)
def test_a_drive_that_switches_itself_off_stays_off_until_it_is_armed(
    bench: HilBench, is_moving: bool, controlword: int
):
    (paying_out if is_moving else HilBench.arm)(bench)
    bench.machine.drives["winch"].automaton.command(controlword)  # as by its safe torque off
    refused: list[Refusal] = []
    bench.cycles(STOP, winch(), refused)
    bench.cycles(0.5, winch(), refused)
    assert refused[-1].code is RefusalCode.NOT_ARMED
    assert_stops(bench, 0.0)
    texts = [change.message for _, change in bench.changes if change.name is BridgeEvent.TRIPPED]
    assert len(texts) == 1
    assert "without a command" in texts[0]
    bench.arm()
    bench.cycles(0.5, winch())
    assert brake_is_open(bench)


def test_a_fault_that_cannot_be_reset_leaves_the_drive_disarmed(
    bench: HilBench, monkeypatch: pytest.MonkeyPatch
):
    bench.arm()
    drive = bench.machine.drives["winch"]
    drive.fail(ErrorCode.DRIVE_OVERTEMPERATURE)
    bench.cycles(0.1)
    obey = drive.automaton.command
    monkeypatch.setattr(drive.automaton, "command", lambda word: obey(word & ~0x80))
    bench.arm()
    assert bench.bridge.channels["winch"].armed
    refused: list[Refusal] = []
    bench.cycles(0.6, winch(), refused)
    monkeypatch.undo()  # the cause is gone
    bench.cycles(0.5, winch(), refused)
    assert refused[-1].code is RefusalCode.NOT_ARMED
    assert_stops(bench, 0.0)
    bench.arm()
    assert bench.bridge.channels["winch"].state == SWITCHED_ON


def test_disarming_switches_the_motors_off_at_once(bench: HilBench):
    paying_out(bench)
    bench.bridge.disarm("asked to disarm", bench.simulation.stamp_ns)
    assert_stops(bench, STOP)
    assert all(channel.state == DISABLED for channel in bench.bridge.channels.values())


def test_an_impossible_command_is_reported_and_dropped(bench: HilBench):
    bench.arm()
    joints = {machine.JUMP_SCREW: JointValue(0.3, 0.02, 1000.0)}  # beyond the stroke of 0.2 m
    bench.cycles(0.1, {topics.JUMP_MOTOR_COMMAND: JointSample(0, joints)})
    assert bench.has_event(EmulatorEvent.SETPOINT_REFUSED, "jump")
    assert bench.has_event(BridgeEvent.SETPOINT_REJECTED, "jump")


@pytest.mark.parametrize(
    ("topic", "setpoint"),
    [
        (topics.WHEEL_COMMAND, {"mode": 9, "target_velocity": 1.0}),  # no limit of the torque
        (topics.JUMP_MOTOR_COMMAND, {"mode": 1, "max_torque": 100.0}),  # no rate
        (topics.FLYWHEEL_COMMAND, {"mode": 10, "target_torque": 1.5, "max_torque": 10_000.0}),
        (topics.WINCH_COMMAND, {"mode": 9, "target_torque": -5.0, "max_torque": 100.0}),
        (topics.WINCH_COMMAND, {"mode": 9, "target_position": -1.0, "max_torque": 100.0}),
        (topics.WINCH_COMMAND, {"mode": 9, "target_velocity": 900.0, "max_torque": 100.0}),
    ],
)
def test_a_command_set_beyond_the_contract_is_rejected(
    bench: HilBench, topic: str, setpoint: dict[str, float]
):
    bench.arm()
    name = COMMANDED[topic].name
    channel, sampled_ns = bench.bridge.channels[name], bench.bridge.stations[name].sampled_ns
    assert sampled_ns is not None
    for _ in range(6):
        channel.command(topic, {**AT_REST, **setpoint}, bench.simulation.stamp_ns)
        channel.send(sampled_ns, bench.simulation.stamp_ns)
        bench.cycle()
    assert bench.has_event(EmulatorEvent.SETPOINT_REFUSED, name)
    assert bench.has_event(BridgeEvent.SETPOINT_REJECTED, name)
    assert bench.machine.drives[name].setpoint is None


# ------------------------------------------------------------------------------ frames of commands


class Recorder:
    """Frames that go to the winch's drive."""

    def __init__(self, bench: HilBench) -> None:
        self.sets: list[list[tuple[int, bytes]]] = []
        self._ids = [pdo.can_id(WINCH.node_id) for pdo in WINCH.rpdos]
        self._near = bench.bridge.channels["winch"]._send
        bench.bridge.channels["winch"]._send = self._send

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == self._ids[0]:
            self.sets.append([])
        self.sets[-1].append((can_id, data))
        self._near(can_id, data)


def deliver(bench: HilBench, frames: list[tuple[int, bytes]]) -> None:
    for can_id, data in frames:
        bench._bridge_link.send(can_id, data)
    bench.settle()


def rejected(bench: HilBench) -> int:
    return bench.machine.drives["winch"]._counts["rejected_sets"]


def test_repeated_and_reordered_sets_are_never_executed(bench: HilBench):
    bench.arm()
    recorder = Recorder(bench)
    bench.cycles(0.1, winch(rate=0.1))
    bench.cycles(0.1, winch(rate=0.0))
    setpoint = bench.machine.drives["winch"].setpoint
    assert setpoint is not None
    before = rejected(bench)
    for old in recorder.sets:
        deliver(bench, old)
    assert rejected(bench) - before == len(recorder.sets)
    assert bench.machine.drives["winch"].setpoint is setpoint


def test_an_incomplete_set_is_never_executed(bench: HilBench):
    bench.arm()
    bench.cycles(0.1, winch(rate=0.0))
    drive = bench.machine.drives["winch"]
    setpoint = drive.setpoint
    channel = bench.bridge.channels["winch"]
    whole = channel._send
    for left_out in range(3):
        frames: list[tuple[int, bytes]] = []

        def keep(can_id: int, data: bytes, into: list[tuple[int, bytes]] = frames) -> None:
            into.append((can_id, data))

        channel._send = keep
        bench.bridge.on_command(
            topics.WINCH_COMMAND,
            JointSample(bench.simulation.stamp_ns, winch()[topics.WINCH_COMMAND].joints),
            bench.simulation.stamp_ns,
        )
        deliver(bench, [frame for k, frame in enumerate(frames) if k != left_out])
        assert drive.setpoint is setpoint
    channel._send = whole


def test_a_drive_that_is_not_known_as_enabled_yet_is_left_by_its_quick_stop(bench: HilBench):
    bench.arm()
    bench.impair("{kind: cut, target: winch, direction: to_bridge}")
    bench.cycles(STOP + 0.3, winch(), [])
    states = [
        change.values["state"]
        for _, change in bench.changes
        if change.name is EmulatorEvent.DRIVE_STATE and change.values["device"] == "winch"
    ]
    assert bench.has_event(BridgeEvent.FEEDBACK_LOST, "winch")
    assert states[states.index(ENABLED) :] == [ENABLED, QUICK_STOP, DISABLED]


def test_a_late_set_with_a_new_number_is_never_executed(bench: HilBench):
    bench.arm()
    bench.cycles(0.1, winch(rate=0.0))
    drive, channel = bench.machine.drives["winch"], bench.bridge.channels["winch"]
    frames: list[tuple[int, bytes]] = []
    whole = channel._send
    channel._send = lambda can_id, data: frames.append((can_id, data))
    now_ns = bench.simulation.stamp_ns
    bench.bridge.on_command(
        topics.WINCH_COMMAND, JointSample(now_ns, winch()[topics.WINCH_COMMAND].joints), now_ns
    )
    bench.bridge_is_on = False
    bench.cycles(0.6)
    channel._send = whole
    before = rejected(bench)
    deliver(bench, frames)
    assert rejected(bench) - before == 1
    assert drive.setpoint is None


def test_a_drive_that_executed_no_set_for_long_executes_the_next_ones():
    channel = DriveChannel(WINCH, lambda _id, _data: None)
    channel.on_state(FAULT)
    channel.on_executed(5)
    for number in range(0x9000):
        channel.send(0, number)
        channel.on_executed(5)
        assert (channel._sequence - 5) & 0xFFFF < 0x8000


def test_a_link_open_only_towards_the_drive_stops_it(bench: HilBench):
    paying_out(bench)
    network = bench._bridge_link.network
    answers = {can_id: network.subscribers.pop(can_id) for can_id in bench.bridge.can_ids}
    with pytest.raises(Refusal, match=r"does not answer|not armed"):
        bench.cycles(2.0, winch())
    assert_stops(bench, STOP)
    network.subscribers.update(answers)


def test_a_lost_answer_is_counted_and_its_topics_are_not_published(bench: HilBench):
    bench.cycles(0.1)
    station = bench.bridge.stations["winch"]
    pdo = WINCH.tpdos[1]
    can_id = pdo.can_id(WINCH.node_id)
    network = bench._bridge_link.network
    kept = network.subscribers.pop(can_id)
    bench.published.clear()
    bench.cycle()
    network.subscribers[can_id] = kept
    assert set(bench.published) == set(PUBLISHED) - {topics.WINCH_STATE, topics.MOTOR_CURRENTS}
    bench.cycle()
    assert station.lost == 1
    assert bench.bridge.incomplete_cycles == 1
    assert topics.WINCH_STATE in bench.published


def test_invalid_frames_are_counted_and_ignored(bench: HilBench):
    bench.cycles(0.1)
    can_id = WINCH.tpdos[0].can_id(WINCH.node_id)
    for data in (b"", b"\x00", bytes(7)):
        bench.bridge.on_tpdo(can_id, data, bench.simulation.stamp_ns)
    assert bench.bridge.stations["winch"].invalid == 3


def test_a_command_is_executed_within_its_cycle_by_the_measured_round_trip(bench: HilBench):
    bench.arm()
    bench.cycles(0.5, winch(rate=0.0))
    found = percentiles(bench.bridge.round_trip.copied_values())
    assert found is not None
    assert found.number >= 90
    assert found.largest == 0.0  # only the plant takes time here
    assert bench.bridge.overdue_round_trips == bench.bridge.late_cycles == 0


def test_a_set_that_arrives_during_a_tick_is_executed_at_its_arrival(bench: HilBench):
    bench.arm()
    bench.cycles(0.1, winch(rate=0.0))
    # Computed from the last state, but processed after the tick.
    (joints,) = (sample.joints for sample in winch(rate=0.0).values())
    state = bench.published[topics.WINCH_STATE]
    assert isinstance(state, JointSample)
    command = JointSample(state.stamp_ns, joints)
    bench.bridge.on_command(topics.WINCH_COMMAND, command, bench.simulation.stamp_ns)
    at_once = bench.machine.receive
    bench.machine.receive = partial(at_once, frame_age_ns=lambda _: 2_000_000)  # type: ignore[method-assign]
    bench.settle()
    bench.machine.receive = at_once  # type: ignore[method-assign]
    bench.cycle()
    found = percentiles(bench.bridge.round_trip.copied_values())
    assert found is not None
    assert found.largest == pytest.approx(SYNC_PERIOD - 0.002, abs=1e-5)


def test_the_command_delay_delays_the_motion(compiled_in_space: None):
    made = HilBench(simulation(), command_delay=0.1)
    try:
        made.arm()
        made.cycles(0.09, winch())
        assert not brake_is_open(made)
        made.cycles(0.15, winch())
        assert brake_is_open(made)
    finally:
        made.close()


def test_single_commands_by_sdo_are_refused(bench: HilBench):
    import struct

    drive = bench.machine.drives["winch"]
    request = struct.pack("<BHB4s", 0x2B, 0x6040, 0, b"\x0f\x00\x00\x00")
    answers: list[bytes] = []
    bench._bridge_link.network.subscribe(0x583, lambda _id, data, _t: answers.append(bytes(data)))
    deliver(bench, [(0x603, request)])
    assert answers[0][0] == 0x80  # abort
    assert struct.unpack_from("<I", answers[0], 4) == (0x0800_0022,)
    assert not drive.automaton.enabled


def test_a_pdo_keeps_its_counts():
    pdo: Pdo = WINCH.tpdos[0]
    counts = {"statusword": 0x0237, "position": -5, "inputs": 1, "sync_counter": 240}
    assert unpack(pdo, pdo.layout.pack(*counts.values())) == counts
    assert math.isclose(WINCH.by_key["position"].value(-5), -5e-6)
