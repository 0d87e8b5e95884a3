"""States of a plant from its record: the nearest one before a time, as it was."""

import json
import re
from pathlib import Path

import pytest
from contract_bag import MadeUp
from lockstep_run import PLANAR, TICK, Recorder, nut_until_trip

from msg_schemas import topics
from msg_schemas.samples import TextSample
from rover_bags.resimulation.resim import resimulate
from rover_cli.command_line import main
from rover_sim import STAMP, build_interface, build_plant, read_state, simulation_from

TICKS = 60


@pytest.fixture(scope="module")
def recorder() -> Recorder:
    recorder = Recorder(PLANAR)
    recorder.run(TICKS, nut_until_trip)
    return recorder


@pytest.fixture(scope="module")
def bag(recorder: Recorder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorder.made.write(tmp_path_factory.mktemp("state") / "bag")


def test_a_plant_continues_from_a_bag_bit_by_bit(bag: Path, recorder: Recorder, tmp_path: Path):
    file = tmp_path / "flight.json"
    at = 45.5 * TICK  # in flight: the latch has tripped
    assert main(["bag", "state", str(bag), "--at", str(at), "-o", str(file)]) == 0
    content = json.loads(file.read_text())
    assert content[STAMP] == 450_000_000
    assert content["state"]["phase"] == "flight"
    values = read_state(str(file), recorder.scenario)
    continued = simulation_from(build_interface(build_plant(recorder.scenario), 1), TICK, values)
    for _ in range(TICKS - 45):
        continued.tick()
    due = (topics.TRUTH_BODY1, topics.TRUTH_TETHER, topics.TRUTH_ENERGY)
    for (_, found), (_, flown) in zip(
        continued.interface.samples(due), recorder.simulation.interface.samples(due), strict=True
    ):
        assert list(found.scalars()) == list(flown.scalars())


@pytest.mark.parametrize(("at", "stamp"), [("0.1", 0.1), ("0.3", 0.3), ("inf", 0.15)])
def test_the_nearest_state_of_several_runs_is_saved_with_its_scenario(
    at: str, stamp: float, tmp_path: Path
):
    first, again = Recorder(PLANAR), Recorder(PLANAR, tether__elements=5)
    first.run(40, nut_until_trip)
    again.wall = first.wall
    again.made.rows = first.made.rows + [(again.wall, *row[1:]) for row in again.made.rows]
    again.run(15, nut_until_trip)
    bag, file = again.made.write(tmp_path / "bag"), tmp_path / "state.json"
    assert main(["bag", "state", str(bag), "--at", at, "-o", str(file)]) == 0
    assert json.loads(file.read_text())[STAMP] == pytest.approx(1e9 * stamp)
    read_state(str(file), first.scenario if stamp == 0.3 else again.scenario)


def test_a_run_that_started_from_a_state_is_simulated_again(recorder: Recorder, tmp_path: Path):
    state = recorder.simulation.state
    again = Recorder(PLANAR, start=state)
    again.run(20, lambda _tick: ())
    found = resimulate(again.made.write(tmp_path / "bag"))
    assert found.identical, found.text()
    assert found.compared > 100


@pytest.mark.parametrize(
    ("at", "missing", "message"),
    [
        (
            "0.005",
            None,
            "the first state in .* is that of 0.010 s of simulated time, after 0.005 s",
        ),
        ("0.3", topics.TRUTH_STATE, "does not hold truth/state: a state can be saved only from"),
        ("0.3", topics.CONFIG, "does not hold a plant's config"),
    ],
)
def test_what_a_bag_does_not_hold_is_named(
    recorder: Recorder,
    tmp_path: Path,
    at: str,
    missing: str | None,
    message: str,
    capsys: pytest.CaptureFixture[str],
):
    rows = recorder.made.rows
    recorder.made.rows = [row for row in rows if row[1] != missing]
    bag = recorder.made.write(tmp_path / "bag")
    recorder.made.rows = rows
    file = tmp_path / "state.json"
    assert main(["bag", "state", str(bag), "--at", at, "-o", str(file)]) == 2
    assert not file.exists()
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize("text", [
    "{}", '{"stamp_ns": "x", "state": {}}', '{"stamp_ns": 1e400, "state": {}}',
    '{"stamp_ns": -1, "state": {}}', '{"stamp_ns": true, "state": {}}', '{"stamp_ns": 5}',
    '{"stamp_ns": 5, "state": []}', f'{{"stamp_ns": {2**63}, "state": {{}}}}',
])  # fmt: skip
def test_states_of_foreign_publishers_do_not_count(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
):
    made = MadeUp()
    made.add(0.5, topics.CONFIG, TextSample(json.dumps({"scenario": {"model": "spatial"}})))
    made.add(1.0, topics.TRUTH_STATE, TextSample(text))
    bag = made.write(tmp_path / "bag")
    assert main(["bag", "state", str(bag), "-o", str(tmp_path / "state.json")]) == 2
    assert "does not hold truth/state" in capsys.readouterr().err
    assert not (tmp_path / "state.json").exists()


def test_a_scenario_that_no_plant_has_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    made = MadeUp()
    made.add(0.5, topics.CONFIG, TextSample('{"scenario": {"model": "spatial", "speed": 1}}'))
    made.add(1.0, topics.TRUTH_STATE, TextSample('{"stamp_ns": 5, "state": {}}'))
    bag = made.write(tmp_path / "bag")
    assert main(["bag", "state", str(bag), "-o", str(tmp_path / "state.json")]) == 2
    assert "is not one of a plant: speed = 1: no such key" in capsys.readouterr().err


def test_an_existing_file_is_kept(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "state.json"
    file.write_text("kept")
    assert main(["bag", "state", str(bag), "-o", str(file)]) == 3
    assert file.read_text() == "kept"
    assert f"cannot write {file}: it exists and is never overwritten" in capsys.readouterr().err
    assert main(["bag", "state", str(bag), "-o", str(tmp_path / "no" / "state.json")]) == 3
    assert "its folder does not exist; create it first" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["bag", "state", str(bag), "--at", "nan", "-o", str(tmp_path / "other.json")])
