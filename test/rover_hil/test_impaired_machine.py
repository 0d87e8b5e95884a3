"""Bridge and machine with impairments: what continues, what stops, what never moves."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import pytest
from random_seeds import seeds

from msg_schemas import machine, topics
from msg_schemas.events import BridgeEvent, EmulatorEvent
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from rover_hil.bridge.drive_channel import ENABLED
from rover_hil.bridge.wiring import PUBLISHED
from rover_hil.canopen.devices import SYNC_PERIOD
from rover_sim import Simulation, build_interface, build_plant, load_spatial
from rover_verify.harness.hil_bench import HilBench

RATE = 0.3
PAY_OUT = {
    topics.WINCH_COMMAND: JointSample(
        0,
        {
            machine.WINCH_DRUM: JointValue(20.0, RATE, 16.2),
            machine.WINCH_BRAKE: JointValue(1.0),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
        },
    )
}
ROLL = {topics.WHEEL_COMMAND: JointSample(0, {machine.WHEEL_DRIVE: JointValue(0.0, 2.0, 1.0)})}
TIMED_OUT = 0.5  # no drive is active [s]
WITHIN = TIMED_OUT + RATE / 0.4 + 0.1  # after the winch's quick stop everything stands still [s]


def simulation() -> Simulation[Any]:
    scenario = load_spatial("free_hang", {"sensors.error_model": "ideal"})
    return Simulation(build_interface(build_plant(scenario), 1), SYNC_PERIOD)


@pytest.fixture
def bench(compiled_in_space: None) -> Iterator[HilBench]:
    """A bench whose winch pays out."""
    made = HilBench(simulation(), rover_offset=1.25)
    made.arm()
    made.cycles(0.4, PAY_OUT)
    yield made
    made.close()


def rate(bench: HilBench) -> float:
    """True payout rate [m/s]: exactly 0 where the brake holds."""
    return bench.simulation.interface.drive_feedback(bench.simulation.state).payout_rate


def length(bench: HilBench) -> float:
    """True length [m]."""
    return bench.simulation.interface.drive_feedback(bench.simulation.state).length


def reasons(bench: HilBench, name: str) -> list[str]:
    return [change.message for _, change in bench.changes if change.name == name]


@pytest.mark.parametrize(
    "impairment",
    [
        "{kind: loss, magnitude: 0.1}",
        "{kind: duplication, magnitude: 0.5}",
        "{kind: reorder, magnitude: 0.3}",
        "{kind: bit_errors, magnitude: 2.0e-4}",
        "{kind: stale_stamps, magnitude: 0.05}",
        "{kind: cut, target: rover}",
        "{kind: brown_out, target: imu}",
        "{kind: bus_off, target: load_cell}",
    ],
)
def test_a_mild_impairment_does_not_stop_the_winch(bench: HilBench, impairment: str):
    bench.impair(impairment)
    bench.cycles(1.0, PAY_OUT)
    assert rate(bench) == pytest.approx(RATE, rel=0.2)
    assert bench.bridge.channels["winch"].state == ENABLED
    assert reasons(bench, EmulatorEvent.IMPAIRMENT_STARTED)


@pytest.mark.parametrize(
    "impairment",
    [
        "{kind: cut}",
        "{kind: cut, target: winch, direction: to_devices}",
        "{kind: cut, target: winch, direction: to_bridge}",
        "{kind: cut, target: mother}",
        "{kind: loss, magnitude: 1.0}",
        "{kind: delay, magnitude: 0.5}",
        "{kind: jitter, magnitude: 1.0}",
        "[{kind: loss, magnitude: 0.3}, {kind: delay, magnitude: 0.5}]",
        *(
            f"[{{kind: loss, magnitude: 0.3, seed: {seed}}}, {{kind: delay, magnitude: {delay}}}]"
            for seed, delay in itertools.product(seeds(3), (0.3, 0.5))
        ),
        "{kind: bit_errors, magnitude: 0.05}",
        "{kind: stale_stamps, target: winch, magnitude: 5.0}",
        "{kind: bus_off, target: winch}",
        "{kind: bus_off}",
        "{kind: brown_out, target: winch}",
        "{kind: brown_out}",
        "{kind: drive_fault, target: winch, cause: undervoltage}",
        "{kind: drive_fault, target: winch, cause: overtemperature}",
        "{kind: drive_fault, target: winch, cause: encoder}",
    ],
)
def test_a_severe_impairment_stops_the_winch_until_it_is_armed_again(
    bench: HilBench, impairment: str
):
    start = length(bench)
    bench.impair(impairment)
    refused: list[Refusal] = []
    bench.cycles(WITHIN, PAY_OUT, refused)
    assert rate(bench) == 0.0
    assert length(bench) - start <= RATE * TIMED_OUT + RATE**2 / 0.8
    for text in (impairment, ""):  # while it is active and after its end
        bench.impair(text)
        for _ in range(20):
            bench.cycles(0.05, PAY_OUT, refused)
            assert rate(bench) == 0.0
            assert "winch" not in bench.driven
    assert {refusal.code for refusal in refused} <= {
        RefusalCode.NOT_ACTIVE,
        RefusalCode.NOT_ARMED,
    }
    assert refused[-1].code is RefusalCode.NOT_ARMED
    assert len(reasons(bench, EmulatorEvent.IMPAIRMENT_ENDED)) == impairment.count("kind")
    bench.arm()
    bench.cycles(0.5, PAY_OUT)
    assert rate(bench) == pytest.approx(RATE, rel=0.2)


def test_a_drive_whose_boot_up_message_is_lost_is_disarmed(bench: HilBench):
    bench.impair(
        "[{kind: brown_out, target: winch, duration: 0.2},"
        " {kind: cut, target: winch, direction: to_bridge, start: 0.195, duration: 0.02}]"
    )
    refused: list[Refusal] = []
    bench.cycles(1.0, PAY_OUT, refused)
    (text,) = reasons(bench, BridgeEvent.RESTARTED)
    assert "or was stopped: its NMT state is 127" in text
    assert refused[-1].code is RefusalCode.NOT_ARMED
    assert rate(bench) == 0.0


def test_a_fault_is_reset_although_a_command_set_is_lost(bench: HilBench):
    bench.impair("{kind: drive_fault, target: winch, cause: overtemperature, duration: 0.2}")
    bench.cycles(0.6, PAY_OUT, [])
    bench.impair("{kind: cut, target: winch, direction: to_devices, duration: 0.02}")
    bench.cycle()
    bench.bridge.arm(bench.simulation.stamp_ns)
    with pytest.raises(Refusal, match="the winch drive is in fault") as refused:
        bench.cycle(PAY_OUT)
    assert refused.value.code is RefusalCode.NOT_ACTIVE
    bench.cycles(0.5, PAY_OUT, [])
    assert bench.bridge.channels["winch"].state == ENABLED
    assert rate(bench) == pytest.approx(RATE, rel=0.2)


def test_a_cut_to_the_rover_stops_its_drives_and_its_topics_return_afterwards(bench: HilBench):
    bench.cycles(0.3, ROLL)
    wheel = bench.machine.drives["wheel"]
    assert wheel.setpoint is not None
    bench.impair("{kind: cut, target: rover, duration: 2.0}")
    refused: list[Refusal] = []
    bench.cycles(TIMED_OUT, ROLL, refused)
    assert wheel.setpoint is None
    assert not wheel.automaton.enabled
    bench.cycles(1.0, ROLL, refused)
    bench.published.clear()
    bench.cycles(0.3, ROLL, refused)
    assert set(bench.published) == {topics.WINCH_STATE, topics.LOAD_CELL}
    bench.cycles(0.5, ROLL, refused)
    assert set(bench.published) == set(PUBLISHED)
    assert wheel.setpoint is None
    assert "not armed" in refused[-1].reason


def test_samples_with_old_stamps_are_not_published(bench: HilBench):
    bench.impair("{kind: stale_stamps, target: imu, magnitude: 2.0}")
    bench.published.clear()
    bench.cycles(1.0, PAY_OUT)
    assert topics.IMU not in bench.published
    assert topics.WINCH_STATE in bench.published
    assert bench.has_event(BridgeEvent.SILENT, "imu")


def test_a_frozen_encoder_reports_a_constant_position_while_the_drum_turns(bench: HilBench):
    before = bench.published[topics.WINCH_STATE]
    bench.impair("{kind: frozen_encoder, target: winch}")
    bench.cycles(0.5, PAY_OUT)
    after = bench.published[topics.WINCH_STATE]
    assert isinstance(before, JointSample)
    assert isinstance(after, JointSample)
    assert rate(bench) == pytest.approx(RATE, rel=0.2)
    assert after.joints[machine.WINCH_DRUM].velocity == 0.0
    assert (
        after.joints[machine.WINCH_DRUM].position - before.joints[machine.WINCH_DRUM].position
        < 0.01
    )
    bench.impair("")
    bench.cycles(0.01, PAY_OUT)
    again = bench.published[topics.WINCH_STATE]
    assert isinstance(again, JointSample)
    assert again.joints[machine.WINCH_DRUM].velocity == pytest.approx(RATE, rel=0.2)


@pytest.mark.parametrize(
    ("target", "topic", "axis"),
    [("load_cell", topics.LOAD_CELL, -1.0), ("imu", topics.ROVER_LOAD_CELL, 1.0)],
)
def test_a_load_cell_drifts_at_its_rate_and_recovers_afterwards(
    bench: HilBench, target: str, topic: str, axis: float
):
    def error() -> float:
        """Difference of the published force from that of a sensor without drift."""
        right = dict(bench.simulation.interface.samples((topic,)))[topic]
        measured = bench.published[topic]
        assert isinstance(right, WrenchSample)
        assert isinstance(measured, WrenchSample)
        return axis * (measured.force[2] - right.force[2])

    assert error() == pytest.approx(0.0, abs=2.0)
    bench.impair(f"{{kind: drifted_load_cell, target: {target}, magnitude: 20.0}}")
    bench.cycles(1.0, PAY_OUT)
    assert error() == pytest.approx(20.0, abs=2.0)
    bench.impair("")
    bench.cycles(0.05, PAY_OUT)
    assert error() == pytest.approx(0.0, abs=2.0)


def test_impairments_start_and_end_in_time_and_report_their_effect(bench: HilBench):
    requested = bench.time
    bench.impair("[{kind: loss, target: load_cell, magnitude: 0.5, start: 0.2, duration: 0.3}]")
    bench.cycles(1.0, PAY_OUT)
    began, ended = (
        [(time, change) for time, change in bench.changes if change.name is name]
        for name in (EmulatorEvent.IMPAIRMENT_STARTED, EmulatorEvent.IMPAIRMENT_ENDED)
    )
    ((begin, impairment),) = began
    ((end, counts),) = ended
    assert begin - requested == pytest.approx(0.2, abs=SYNC_PERIOD + 1e-9)
    assert end - begin == pytest.approx(0.3, abs=1e-9)
    assert impairment.values["magnitude"] == 0.5
    assert impairment.values["unit"] == "-"
    # In each cycle a SYNC and, if it arrives, an answer; in addition heartbeats.
    frames, affected = counts.values["frames"], counts.values["frames_affected"]
    assert isinstance(frames, int)
    assert isinstance(affected, int)
    assert 80 <= frames <= 110
    assert 0.3 < affected / frames < 0.7


def test_an_active_impairment_continues_while_another_one_starts_and_ends(bench: HilBench):
    bench.impair("{kind: drifted_load_cell, magnitude: 1.0}")
    bench.cycles(0.1, PAY_OUT)
    bench.impair("[{kind: drifted_load_cell, magnitude: 1.0}, {kind: loss, magnitude: 0.1}]")
    bench.cycles(0.1, PAY_OUT)
    bench.impair("{kind: drifted_load_cell, magnitude: 1.0}")
    bench.cycles(0.1, PAY_OUT)
    assert len(reasons(bench, EmulatorEvent.IMPAIRMENT_STARTED)) == 2
    (ended,) = reasons(bench, EmulatorEvent.IMPAIRMENT_ENDED)
    assert "loss" in ended


def test_a_run_is_reproducible_by_its_seed(compiled_in_space: None):
    def run(seed: int) -> list[object]:
        made = HilBench(simulation())
        try:
            made.arm()
            made.impair(
                f"[{{kind: loss, magnitude: 0.3, seed: {seed}}}, {{kind: reorder, magnitude: 0.2}}]"
            )
            made.cycles(0.5, PAY_OUT, [])
            lost = [station.lost for station in made.bridge.stations.values()]
            stale = [station.stale for station in made.bridge.stations.values()]
            return [lost, stale, made.published, made.changes, made.simulation.state.time]
        finally:
            made.close()

    first = run(1)
    assert run(1) == first
    assert run(2)[:2] != first[:2]


def test_a_reset_plant_restarts_its_impairments(bench: HilBench):
    bench.impair("{kind: loss, magnitude: 0.1, start: 0.1, duration: 0.2}")
    bench.cycles(0.5, PAY_OUT)
    bench.simulation.reset_plant()
    bench.machine.restart()
    bench.cycles(0.5, PAY_OUT, [])
    assert len(reasons(bench, EmulatorEvent.IMPAIRMENT_STARTED)) == 2
    assert len(reasons(bench, EmulatorEvent.IMPAIRMENT_ENDED)) == 2


def test_a_reset_clock_loses_delayed_frames(bench: HilBench):
    bench.impair("{kind: delay, magnitude: 0.5}")
    bench.cycles(1.0, PAY_OUT, [])
    bench.simulation.reset()
    bench.machine.restart()
    bench.impair("")
    bench.cycles(0.6, PAY_OUT, [])  # frames since the reset are delayed, too
    bench.published.clear()
    bench.cycles(0.2, PAY_OUT, [])
    assert set(bench.published) == set(PUBLISHED)


def test_a_kill_is_passed_to_the_owner_of_the_processes(bench: HilBench):
    bench.impair("[{kind: bridge_kill, start: 0.1}, {kind: emulator_kill, start: 0.2}]")
    bench.cycles(0.15, PAY_OUT)
    assert bench.machine.take_kills() == ("bridge_kill",)
    bench.cycles(0.1, PAY_OUT)
    assert bench.machine.take_kills() == ("emulator_kill",)
    assert bench.machine.take_kills() == ()
