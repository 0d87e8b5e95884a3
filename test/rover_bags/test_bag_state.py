"""States of a plant from its record: the nearest one before a time, as it was."""

import json
import re
from pathlib import Path

import pytest
from lockstep_run import PLANAR, TICK, Recorder, nut_until_trip

from msg_schemas import topics
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
