"""Re-simulation of recorded runs: bit-identical results and the location of differences."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contract_bag import MadeUp
from lockstep_run import NUT, PLANAR, SPATIAL, TICK, Recorder, all_drives, nut_until_trip

from msg_schemas import machine, topics
from msg_schemas.events import SimulationEvent
from msg_schemas.parameters import rules_of
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    OdometrySample,
    Sample,
    TextSample,
)
from rover_bags.resimulation import recorded_run, resim
from rover_bags.resimulation.resim import ResimError, resimulate
from rover_cli.command_line import main
from rover_sim import load_scenario
from rover_sim.node.sim_node import SimParameters

TICK_NS = 10_000_000


@pytest.fixture(scope="module")
def jump_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recorder = Recorder(PLANAR)
    recorder.run(120, nut_until_trip)
    return recorder.made.write(tmp_path_factory.mktemp("resim") / "bag")


def test_a_lockstep_jump_is_bit_identical(jump_bag: Path):
    found = resimulate(jump_bag)
    assert found.identical, found.text()
    assert found.compared > 800
    assert found.commands >= 5
    assert found.delayed == 0
    assert found.comparisons[topics.TRUTH_BODY1].compared == 120
    assert "bit-identical" in found.text()


@pytest.mark.usefixtures("compiled_in_space")
def test_a_spatial_lockstep_run_is_bit_identical_with_noise(tmp_path: Path):
    recorder = Recorder(SPATIAL, seed=11)
    recorder.run(25, all_drives)
    bag = recorder.made.write(tmp_path / "bag")
    found = resimulate(bag)
    assert found.identical, found.text()
    assert {topics.IMU, topics.LOAD_CELL, topics.WHEEL_STATE, topics.TRUTH_TETHER} <= set(
        found.comparisons
    )
    assert found.commands == 24 * 2 + 8
    assert found.refused == 0


def test_a_gap_in_the_record_is_reported(tmp_path: Path):
    recorder = Recorder(PLANAR)
    recorder.run(120, nut_until_trip)
    made = recorder.made
    made.rows = [row for row in made.rows if not 20.5 * TICK < row[0] < 80.5 * TICK]
    bag = made.write(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    found = resimulate(bag)
    unknown, gap = found.notes
    assert unknown.startswith("metadata.yaml is missing")
    between = f"from {20 * TICK:.3f} s to {81 * TICK:.3f} s"
    assert between in gap
    assert between in found.text()


def test_delays_of_commands_are_inferred_from_the_record(tmp_path: Path):
    recorder = Recorder(PLANAR)
    recorder.run(60, nut_until_trip, late=2)
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.delayed > 0


@pytest.mark.parametrize("first", range(6))
def test_a_command_that_was_taken_only_after_the_landing_is_followed(tmp_path: Path, first: int):
    def nut(tick: int) -> Iterable[tuple[str, Mapping[str, JointValue]]]:
        if tick >= 5 and tick % 6 == first:
            yield topics.JUMP_MOTOR_COMMAND, {machine.JUMP_SCREW: JointValue(0.05, 0.3, 400.0)}

    recorder = Recorder(PLANAR)
    recorder.run(75, nut, late=2)  # earlier, in flight, it would be refused without an effect
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.refused == 0


def nudged(sample: OdometrySample, by: float) -> OdometrySample:
    x, y, z = sample.linear
    return replace(sample, linear=(x, y, z + by))


@pytest.mark.parametrize(("size", "within"), [(1e-13, True), (1e-3, False)])
def test_the_first_difference_is_located(tmp_path: Path, size: float, within: bool):
    def change(name: str, stamp: int, sample: Sample) -> Sample:
        if name == topics.TRUTH_BODY2 and stamp >= 30 * TICK_NS:
            assert isinstance(sample, OdometrySample)
            return nudged(sample, size * (2.0 if stamp == 33 * TICK_NS else 1.0))
        return sample

    recorder = Recorder(PLANAR)
    recorder.run(40, lambda _tick: (), change=change)
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert not found.identical
    assert found.within is within
    assert found.first is not None
    assert found.first.time_s == pytest.approx(0.30)
    assert (found.first.topic, found.first.field) == (topics.TRUTH_BODY2, "linear.z")
    assert found.first.recorded - found.first.resimulated == pytest.approx(size, rel=1e-2)
    assert found.differing == 11
    row = found.comparisons[topics.TRUTH_BODY2]
    assert row.largest is not None
    assert row.largest.time_s == pytest.approx(0.33)
    assert row.error == pytest.approx(2.0 * size, rel=0.5)
    assert "truth/body2, linear.z" in found.text() if within else "outside" in found.text()


def test_a_different_scenario_fails(tmp_path: Path):
    recorder = Recorder(PLANAR, tether__elements=5)
    recorder.run(60, nut_until_trip)
    content = {
        "parameters": {"tick": TICK},
        "scenario": load_scenario(PLANAR, {"rover.m2": 2.01}).to_mapping(),
        "seed": 7,
    }
    del recorder.made.rows[0]
    recorder.made.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert not found.within


def test_resets_of_plant_and_clock_are_followed(tmp_path: Path):
    recorder = Recorder(PLANAR)
    recorder.run(40, nut_until_trip)
    simulation = recorder.simulation
    simulation.reset_plant()
    stamp = simulation.stamp_ns * 1e-9
    recorder.made.rows.append(event(recorder, stamp, SimulationEvent.PLANT_RESET))
    recorder.wall += 0.5
    recorder.record()
    recorder.run(20, nut_until_trip)
    simulation.reset()
    recorder.wall += 0.5
    recorder.record()
    recorder.run(30, nut_until_trip)
    # An accelerometer has no sample before the first tick.
    recorder.made.rows = [
        row for row in recorder.made.rows if not (row[1] == topics.IMU and is_at_start(row[2]))
    ]
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.resets == 2


def test_a_simulator_that_starts_again_as_another_is_followed(tmp_path: Path):
    first = Recorder(PLANAR)
    first.run(20, nut_until_trip)
    again = Recorder(PLANAR, tether__elements=5)
    again.wall = first.wall + 0.5
    again.made.rows = first.made.rows + [(again.wall, *row[1:]) for row in again.made.rows]
    again.run(20, nut_until_trip)
    found = resimulate(again.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.comparisons[topics.TRUTH_BODY1].compared == 40


def test_the_start_after_a_reset_of_the_plant_may_be_no_sample_that_was_due(tmp_path: Path):
    recorder = Recorder(PLANAR)
    recorder.run(41, nut_until_trip)
    simulation = recorder.simulation
    recorder.made.rows = [
        row for row in recorder.made.rows
        if row[1] != topics.TRUTH_TETHER or round(row[0] / TICK) % 2 == 0
    ]  # fmt: skip
    stamp = simulation.stamp_ns * 1e-9
    simulation.reset_plant()
    recorder.made.rows.append(event(recorder, stamp, SimulationEvent.PLANT_RESET))
    recorder.wall += 0.5
    for name, sample in simulation.interface.samples({topics.TRUTH_TETHER}):
        recorder.made.add(recorder.wall, name, sample)
    recorder.run(4, nut_until_trip)
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.comparisons[topics.TRUTH_TETHER].compared == 20 + 1 + 4


def is_at_start(data: bytes) -> bool:
    return not any(data[4:12])


def event(recorder: Recorder, stamp: float, name: str) -> tuple[float, str, bytes]:
    made = MadeUp()
    made.event(stamp, name, "reset", {})
    return (recorder.wall + 0.001, *made.rows[0][1:])


@pytest.mark.parametrize("tick", [0, -0.01, math.nan, math.inf, 10**400, 1e-9, 1e9, "0.01", None])
def test_a_tick_that_no_simulator_has_is_refused(tmp_path: Path, tick: object):
    made = MadeUp()
    scenario = load_scenario(PLANAR).to_mapping()
    content = {"scenario": scenario, "seed": 1, "parameters": {"tick": tick}}
    made.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))
    with pytest.raises(
        ResimError, match=r"parameters.tick = .*: should be a number at least 0.0001"
    ):
        resimulate(made.write(tmp_path / "bag"))


def test_the_limits_of_the_tick_are_those_of_the_simulator():
    rules = rules_of(SimParameters)
    for name, rule in (("tick", recorded_run.TICK), ("seed", recorded_run.SEED)):
        own = rules[name]
        assert (rule.kind, rule.minimum, rule.maximum) == (own.kind, own.minimum, own.maximum)


def test_a_sample_stamped_by_a_wall_clock_is_not_used(tmp_path: Path):
    def change(name: str, stamp: int, sample: Sample) -> Sample:
        if name == topics.TRUTH_BODY2 and stamp == 20 * TICK_NS:
            assert isinstance(sample, OdometrySample)
            return replace(sample, stamp_ns=1_790_000_000 * 10**9)
        return sample

    recorder = Recorder(PLANAR)
    recorder.run(40, lambda _tick: (), change=change)
    found = resimulate(recorder.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.comparisons[topics.TRUTH_BODY2].compared == 39
    assert found.simulated_s == pytest.approx(0.4)
    assert found.notes == [
        "samples of truth/body2 stamped after the end of simulated time, not used: 1"
    ]


def test_a_bag_without_a_scenario_is_refused(tmp_path: Path, capsys: Any):
    made = MadeUp()
    made.add(0.0, topics.CLOCK, ClockSample(0))
    bag = made.write(tmp_path / "bag")
    with pytest.raises(ResimError, match="holds no configuration of a simulator"):
        resimulate(bag)
    assert main(["bag", "resim", str(bag)]) == 2
    assert main(["bag", "resim", str(tmp_path / "nothing")]) == 2
    assert "there is no bag" in capsys.readouterr().err
    made.add(0.0, topics.CONFIG, TextSample(json.dumps({"scenario": {"name": "x"}, "seed": 1})))
    with pytest.raises(ResimError, match="cannot be simulated here"):
        resimulate(made.write(tmp_path / "unknown"))
    other = MadeUp()
    other.add(0.0, topics.CLOCK, ClockSample(0))
    scenario = load_scenario(PLANAR).to_mapping()
    other.add(0.0, topics.CONFIG, TextSample(json.dumps({"scenario": scenario, "seed": 1})))
    with pytest.raises(ResimError, match="lacks 'parameters': it holds scenario, seed"):
        resimulate(other.write(tmp_path / "lacking"))


def test_the_command_reports_by_text_json_and_exit_code(jump_bag: Path, capsys: Any):
    assert main(["bag", "resim", str(jump_bag), "--exact"]) == 0
    assert "every recorded sample" in capsys.readouterr().out
    assert main(["bag", "resim", str(jump_bag), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["identical"] is True
    assert result["differing"] == 0
    assert result["topics"][topics.TRUTH_BODY1]["compared"] == 120
    assert main(["bag", "resim", str(jump_bag), "--tolerance", "nan"]) == 2


def test_an_infinite_error_is_null_in_json():
    found = resim.Resimulation(Path("bag"), "none", 1, TICK, 1e-6)
    found.comparisons[topics.IMU] = resim.TopicComparison(error=math.inf)
    shown = json.loads(json.dumps(found.to_mapping(), allow_nan=False))
    assert shown["topics"][topics.IMU]["largest_error"] is None


def test_a_fork_is_identical_and_independent():
    simulation = Recorder(PLANAR).simulation
    twin = simulation.fork()
    twin.accept_command(topics.JUMP_MOTOR_COMMAND, JointSample(0, NUT))
    for _ in range(3):
        twin.tick()
    simulation.tick()
    assert simulation.stamp_ns == TICK_NS
    assert twin.stamp_ns == 3 * TICK_NS
    assert simulation.state.compression == 0.0
    assert twin.state.compression == pytest.approx(0.012)
    assert np.array_equal(simulation.fork().tick().after.nodes, simulation.tick().after.nodes)
