"""The table of faults with processes: emulator, bridge and a command source over DDS and a link.

Simulated time waits for them: a busy computer does not change the result.
"""

from __future__ import annotations

import random
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.events import BridgeEvent, EmulatorEvent, EventName
from msg_schemas.samples import JointSample, JointValue, StatusSample
from rover_hil.canopen.devices import ErrorCode
from rover_hil.canopen.link import SYNC_ID, Link
from rover_hil.canopen.transport import open_bus
from rover_hil.emulator.cia402 import DriveState
from rover_verify.harness.command_source import CommandSource

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

EMULATOR, BRIDGE = "rover_hil.emulator.emulator_node", "rover_hil.bridge.bridge_node"
RATE = 0.1  # of the winch [m/s]
FUZZED = 1000
MINE, STRANGER = f"/{CommandSource.NAME}#", "/stranger#2"
TIMEOUT = 120.0
ATTEMPTS = 60
LOCKSTEP = f"drive_emulator,hil_bridge,{CommandSource.NAME}"
PERIOD = 0.01  # of the commands, in simulated time [s]


def winch(rate: float) -> dict[str, JointValue]:
    return {
        machine.WINCH_DRUM: JointValue(20.0, rate, 16.2),
        machine.WINCH_BRAKE: JointValue(1.0),
        machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
    }


ROLL = {machine.WHEEL_DRIVE: JointValue(0.0, 1.0, 1.0)}
PAY_OUT = winch(RATE)


class Rig:
    """Emulator and bridge in lockstep with a command source."""

    def __init__(self, harness: NodeHarness) -> None:
        self._processes = harness.processes
        self.link = harness.link
        self.emulator = self.start_emulator()
        self.bridge = self.start_bridge()
        self.commands: dict[str, dict[str, JointValue]] = {topics.WINCH_COMMAND: winch(0.0)}
        self.source = CommandSource(
            harness.domain, "hil_bridge", PERIOD, lambda: dict(self.commands)
        )
        self.observer: Observer = harness.observer()
        self.clock = self.observer.listen(topics.CLOCK)
        self.states = self.observer.listen(topics.WINCH_STATE)
        self.events = self.observer.listen(topics.EVENTS)
        for name in (topics.IMU, topics.WHEEL_STATE):
            self.observer.listen(name)
        for node in ("drive_emulator", "hil_bridge"):
            self.observer.wait_until_ready(node)
        self.clock.wait()

    def start_emulator(self) -> Process:
        # Rates of unused topics.
        seldom = dict.fromkeys(("truth_rate", "tether_rate", "camera_rate", "marker_rate"), 0.1)
        parameters = {"link": self.link, "lockstep": LOCKSTEP, "scenario": "free_hang"}
        return self._processes.start(EMULATOR, {**parameters, **seldom})

    def start_bridge(self) -> Process:
        return self._processes.start(BRIDGE, {"link": self.link, "lockstep": LOCKSTEP})

    def send(self, name: str, joints: dict[str, JointValue], sender: str) -> None:
        """Send a command from outside."""
        sample = JointSample(self.clock.last.stamp_ns, joints)
        self.observer.publisher(name).publish(pack(name, sample, sender))

    # --- actions ---------------------------------------------------------------------------------

    def impair(self, text: str) -> None:
        result = self.observer.set_parameter("drive_emulator", "impairments", text)
        assert result.successful, result.reason

    def arm(self) -> None:
        """Arm as soon as all devices answer."""
        for _ in range(ATTEMPTS):
            if self.observer.call(topics.DRIVES_ARM, True).success:
                return
            self.pass_time(0.1)
        raise AssertionError("the drives could not be armed")

    def pass_time(self, seconds: float) -> None:
        end_ns = self.time_ns + round(seconds * 1e9)
        self.clock.wait(lambda s: s.stamp_ns >= end_ns, len(self.clock) - 1, TIMEOUT)

    def begin(self, text: str) -> int:
        """Start an impairment; returns its start [ns]."""
        since = len(self.events)
        self.impair(text)
        status = self.event(EmulatorEvent.IMPAIRMENT_STARTED, since)
        return int(status.stamp_ns)

    # --- observations ----------------------------------------------------------------------------

    @property
    def time_ns(self) -> int:
        return int(self.clock.last.stamp_ns)

    def event(self, name: EventName, since: int, **values: str) -> StatusSample:
        def is_it(sample: StatusSample) -> bool:
            return any(
                s.name == name and values.items() <= s.values.items() for s in sample.statuses
            )

        found = self.events.wait(is_it, since)
        assert isinstance(found, StatusSample)
        return found

    def state(self, after_ns: int) -> JointSample:
        """The first state of the winch stamped after a time."""
        found = self.states.wait(lambda s: s.stamp_ns > after_ns, 0, TIMEOUT)
        assert isinstance(found, JointSample)
        return found

    def pay_out(self) -> None:
        """Arm and pay out at a constant rate; arm again after a timeout of a busy computer."""
        self.commands = {topics.WINCH_COMMAND: PAY_OUT}
        for _ in range(ATTEMPTS):
            self.arm()
            since, end_ns = len(self.states), self.time_ns + 1_000_000_000

            def is_over(state: JointSample, end_ns: int = end_ns) -> bool:
                return moves(state) or state.stamp_ns > end_ns

            if moves(self.states.wait(is_over, since)):
                return
        raise AssertionError("the winch never paid out")


def moves(state: JointSample) -> bool:
    return is_open(state) and state.joints[machine.WINCH_DRUM].velocity > 0.9 * RATE


def is_open(state: JointSample) -> bool:
    return state.joints[machine.WINCH_BRAKE].position == 1.0


def length(state: JointSample) -> float:
    return state.joints[machine.WINCH_DRUM].position


@pytest.fixture(scope="module")
def rig(shared_harness: NodeHarness, compiled_in_space: None) -> Iterator[Rig]:
    made = Rig(shared_harness)
    yield made
    made.source.close()


@pytest.mark.parametrize(
    "impairment",
    [
        "{kind: loss, magnitude: 0.1}",
        "{kind: duplication, magnitude: 0.5}",
        "{kind: reorder, magnitude: 0.3}",
        "{kind: bit_errors, magnitude: 2.0e-4}",
        "{kind: stale_stamps, magnitude: 0.05}",
        "{kind: drifted_load_cell, magnitude: 1.0}",
        "{kind: bus_off, target: imu}",
    ],
)
def test_a_mild_impairment_does_not_stop_the_winch(rig: Rig, impairment: str):
    rig.pay_out()
    since = len(rig.events)
    begun_ns = rig.begin(impairment)
    state = rig.state(begun_ns + 400_000_000)
    rig.impair("")
    assert is_open(state)
    assert state.joints[machine.WINCH_DRUM].velocity > 0.8 * RATE
    ended = rig.event(EmulatorEvent.IMPAIRMENT_ENDED, since)
    assert ended.statuses[0].values["kind"] in impairment


@pytest.mark.parametrize(
    ("impairment", "event_name", "values"),
    [
        ("{kind: cut}", BridgeEvent.SILENT, {}),
        (
            "{kind: cut, target: winch, direction: to_devices}",
            BridgeEvent.EMERGENCY,
            {"error_code": str(ErrorCode.RPDO_TIMEOUT)},
        ),
        ("{kind: cut, target: winch, direction: to_bridge}", BridgeEvent.FEEDBACK_LOST, {}),
        ("{kind: delay, magnitude: 0.5}", BridgeEvent.SILENT, {}),
        ("{kind: jitter, magnitude: 1.0}", BridgeEvent.SILENT, {}),
        (
            "[{kind: loss, magnitude: 0.3}, {kind: delay, magnitude: 0.5}]",
            BridgeEvent.SILENT,
            {},
        ),
        ("{kind: bit_errors, magnitude: 0.05}", BridgeEvent.SILENT, {}),
        ("{kind: stale_stamps, target: winch, magnitude: 5.0}", BridgeEvent.SILENT, {}),
        ("{kind: bus_off, target: winch}", BridgeEvent.SILENT, {}),
        (
            "{kind: brown_out, target: winch}",
            EmulatorEvent.DRIVE_STATE,
            {"state": DriveState.NOT_READY},
        ),
        (
            "{kind: drive_fault, target: winch, cause: overtemperature}",
            BridgeEvent.EMERGENCY,
            {"error_code": str(ErrorCode.DRIVE_OVERTEMPERATURE)},
        ),
    ],
)
def test_a_severe_impairment_stops_the_winch_with_a_reason_until_it_is_armed(
    rig: Rig, impairment: str, event_name: EventName, values: dict[str, str]
):
    rig.pay_out()
    since, refused = len(rig.events), len(rig.observer.listen(topics.DIAGNOSTICS))
    begun_ns = rig.begin(impairment)
    before = length(rig.state(begun_ns - 20_000_000))
    rig.event(event_name, since, **values)
    rig.pass_time(0.6)
    rig.impair("")
    rig.event(EmulatorEvent.IMPAIRMENT_ENDED, since)
    # After the impairment commands continue, and the brake stays closed.
    first = rig.state(rig.time_ns)
    again = rig.state(first.stamp_ns + 200_000_000)
    assert not is_open(first)
    assert not is_open(again)
    assert length(again) == pytest.approx(length(first), abs=1e-3)
    assert length(first) - before < RATE * 0.5 + 0.05
    rig.observer.wait_for_refusal(topics.WINCH_COMMAND, "not_armed", refused)
    rig.pay_out()


def test_a_frozen_encoder_reports_a_constant_position_and_the_drive_continues(rig: Rig):
    rig.pay_out()
    begun_ns = rig.begin("{kind: frozen_encoder, target: winch}")
    first, later = (rig.state(begun_ns + after) for after in (50_000_000, 450_000_000))
    rig.impair("")
    # The first state after the end of the impairment has a later stamp than the response.
    thawed = rig.state(rig.time_ns + 50_000_000)
    assert is_open(later)
    assert length(later) == length(first)
    assert later.joints[machine.WINCH_DRUM].velocity == 0.0
    assert length(thawed) - length(first) > 0.8 * RATE * 0.4


def test_the_link_to_the_rover_is_cut_for_30_s(rig: Rig):
    rig.pay_out()
    rig.commands = {topics.WINCH_COMMAND: winch(0.0), topics.WHEEL_COMMAND: ROLL}
    wheels = rig.observer.listen(topics.WHEEL_STATE)
    wheels.wait(lambda s: max(v.velocity for v in s.joints.values()) > 0.5, len(wheels))
    since = len(rig.events)
    begun_ns = rig.begin("{kind: cut, target: rover, duration: 30.0}")
    rig.event(BridgeEvent.TRIPPED, since)
    rig.event(BridgeEvent.SILENT, since)
    ended = rig.events.wait(
        lambda s: s.statuses[0].name == EmulatorEvent.IMPAIRMENT_ENDED, since, 4.0 * TIMEOUT
    )
    assert ended.stamp_ns - begun_ns == pytest.approx(30e9, abs=20e6)
    # The mother machine continued; nothing was received from the rover.
    during = [s for s in rig.states.samples if begun_ns + 10**9 < s.stamp_ns < ended.stamp_ns]
    assert len(during) > 0.99 * 29 * 200
    assert all(map(is_open, during))
    imu_stamps = [s.stamp_ns for s in rig.observer.listen(topics.IMU).samples]
    margin_ns = 20_000_000  # clocks of two processes are a tick or two apart
    assert not any(begun_ns + margin_ns < at < ended.stamp_ns - margin_ns for at in imu_stamps)
    back = wheels.wait(lambda s: s.stamp_ns > ended.stamp_ns, 0, TIMEOUT)
    later = wheels.wait(lambda s: s.stamp_ns > back.stamp_ns + 300_000_000, 0, TIMEOUT)
    turned = [abs(v.position - back.joints[name].position) for name, v in later.joints.items()]
    assert max(turned) < 0.05
    rig.observer.wait_for_refusal(topics.WHEEL_COMMAND, "not_armed")


def test_a_second_command_source_is_refused_with_the_name_of_the_owner(rig: Rig):
    rig.pay_out()
    since = len(rig.observer.listen(topics.DIAGNOSTICS))
    for _ in range(100):
        rig.send(topics.WINCH_COMMAND, winch(-RATE), STRANGER)
        rig.pass_time(0.05)
    status = rig.observer.wait_for_refusal(topics.WINCH_COMMAND, "owned", since)
    assert MINE in status.message
    assert STRANGER in status.message
    assert min(s.joints[machine.WINCH_DRUM].velocity for s in rig.states.samples[-20:]) > 0.8 * RATE


def test_fuzzed_messages_have_no_effect_and_the_bridge_continues(rig: Rig):
    from rover_verify.harness.hil_invalid import fuzzed_message

    rig.pay_out()
    rig.commands = {topics.WINCH_COMMAND: winch(0.0)}
    rig.pass_time(1.0)
    generator = np.random.default_rng(random.SystemRandom().randrange(2**32))
    before = rig.states.last
    publishers: dict[str, Any] = {}
    for _ in range(FUZZED):
        # Stamps are wrong by years, or right.
        topic, message = fuzzed_message(generator, rig.time_ns)
        publishers.setdefault(topic, rig.observer.publisher(topic)).publish(message)
    rig.pass_time(0.3)
    after = rig.state(rig.time_ns)
    assert is_open(after)  # the owner's commands still hold it
    assert length(after) == pytest.approx(length(before), abs=1e-3)
    assert rig.bridge.is_running
    assert rig.emulator.is_running


@pytest.mark.parametrize("data", [b"", b"\x01\x02"])
def test_a_sync_without_a_counter_does_not_stop_the_emulator(rig: Rig, data: bytes):
    stranger = Link(open_bus(rig.link))
    stranger.send(SYNC_ID, data)
    stranger.close()
    rig.pass_time(0.2)
    assert rig.emulator.is_running


def test_an_invalid_impairment_is_refused_with_the_expected_value(rig: Rig):
    answer = rig.observer.set_parameter("drive_emulator", "impairments", "{kind: lost}")
    assert not answer.successful
    assert "should be one of delay, jitter, loss" in answer.reason


def test_a_killed_bridge_brakes_and_a_new_one_moves_nothing_until_it_is_armed(rig: Rig):
    rig.pay_out()
    since, refused = len(rig.events), len(rig.observer.listen(topics.DIAGNOSTICS))
    rig.impair("{kind: bridge_kill}")
    assert rig.bridge.wait() == -signal.SIGKILL

    def is_watchdog_fault(sample: StatusSample) -> bool:
        codes = [
            s.values.get("error_code")
            for s in sample.statuses
            if s.name == EmulatorEvent.DRIVE_FAULT
        ]
        return bool({str(ErrorCode.RPDO_TIMEOUT), str(ErrorCode.HEARTBEAT_ERROR)} & set(codes))

    rig.events.wait(is_watchdog_fault, since)
    rig.impair("")
    back = len(rig.states)
    rig.bridge = rig.start_bridge()
    rig.observer.wait_for_refusal(topics.WINCH_COMMAND, "not_armed", refused)
    assert not any(map(is_open, rig.states.samples[back:]))
    rig.observer.wait_until_ready("hil_bridge", refused)
    rig.pay_out()


def test_a_killed_emulator_times_out_and_a_new_one_stays_braked_until_it_is_armed(rig: Rig):
    rig.pay_out()
    since, refused = len(rig.events), len(rig.observer.listen(topics.DIAGNOSTICS))
    # After the response to the request.
    rig.impair("{kind: emulator_kill, start: 0.5}")
    assert rig.emulator.wait() == -signal.SIGKILL
    rig.event(BridgeEvent.SILENT, since)
    rig.event(BridgeEvent.TRIPPED, since)
    back, clocks, before_ns = len(rig.states), len(rig.clock), rig.time_ns
    rig.emulator = rig.start_emulator()
    rig.clock.wait(lambda s: s.stamp_ns < before_ns, clocks, TIMEOUT)
    rig.observer.wait_for_refusal(topics.WINCH_COMMAND, "not_armed", refused)
    assert not any(map(is_open, rig.states.samples[back:]))
    rig.observer.wait_until_ready("drive_emulator", refused)
    rig.pay_out()
