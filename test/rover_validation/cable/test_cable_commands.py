"""The commands on takes of a simulated cable, whose laws are known."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from rover_cli.command_line import main
from rover_sim import build_plant, load_spatial
from rover_validation.cable.example import LAWS, example_geometry, example_take
from rover_validation.cable.identification import identify
from rover_validation.cable.model import Cable, exchanged_ends, laws_of, natural_curvature
from rover_validation.cable.takes import Take, read_takes
from rover_validation.refusals import SetError

CABLE = ["validate", "cable"]
NOISE = 2e-4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Takes, and the cable identified from them."""
    root: Path = tmp_path_factory.mktemp("cable")
    assert main([*CABLE, "example", str(root), "--takes", "3", "--duration", "1.5"]) == 0
    words = [*CABLE, "identify", str(root / "identify"), "--out", str(root / "cable.yaml")]
    assert main([*words, "--numbers", "5"]) == 0
    return root


def test_the_known_laws_are_identified(folder: Path):
    cable = Cable.read(folder / "cable.yaml")
    assert len(cable.numbers) == 5
    found = {each.name: each for each in cable.numbers}
    stiffness = found["bending_stiffness"]
    assert stiffness.value == pytest.approx(LAWS["bending_stiffness"], rel=0.05)
    assert stiffness.low < stiffness.value < stiffness.high
    assert found["drag"].low < LAWS["drag"] < found["drag"].high
    damping = found["bending_damping_time"].value
    assert damping == pytest.approx(LAWS["bending_damping_time"], rel=0.1)
    assert not any(each.at_bound for each in cable.numbers)
    size = np.hypot(found["curvature_1_0"].value, found["curvature_2_0"].value)
    assert size == pytest.approx(np.hypot(LAWS["curvature_1_0"], LAWS["curvature_2_0"]), rel=0.3)


def test_takes_that_were_not_seen_are_predicted(folder: Path, tmp_path: Path):
    for path in sorted((folder / "check").glob("*.csv")):
        with path.open(encoding="utf-8") as stream:
            rows = list(csv.reader(stream))
        for row in rows[3:]:
            row[7:-6] = [""] * len(row[7:-6])
        (tmp_path / path.name).write_text("\n".join(map(",".join, rows)), encoding="utf-8")
    out = tmp_path / "predicted"
    words = [*CABLE, "predict", str(folder / "cable.yaml"), str(tmp_path), "--out", str(out)]
    assert main(words) == 0
    for take in read_takes(folder / "check"):
        with (out / f"{take.name}.csv").open(encoding="utf-8") as stream:
            table = list(csv.DictReader(stream))
        assert len(table) == len(take.times)
        predicted = np.array([
            [[float(row[f"{axis}{m}_m"]) for axis in "xyz"] for m in range(take.markers)]
            for row in table
        ])  # fmt: skip
        distance = np.linalg.norm(predicted - take.positions, axis=-1)[2:, 2:-2]
        assert distance.mean() < 0.004
        assert predicted[:, [0, 1, -2, -1]] == pytest.approx(take.positions[:, [0, 1, -2, -1]])
        low = np.array([[float(row[f"x{m}_m_lo"]) for m in range(2, 6)] for row in table])
        high = np.array([[float(row[f"x{m}_m_hi"]) for m in range(2, 6)] for row in table])
        assert (low < high).all()


def test_a_report_is_drawn(folder: Path, tmp_path: Path):
    out = tmp_path / "report.png"
    words = [*CABLE, "report", str(folder / "cable.yaml"), str(folder / "check"), "--out", str(out)]
    assert main(words) == 0
    assert out.stat().st_size > 20_000


def test_damaged_files_end_with_code_2(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "take.csv").write_text("time_s,x0_m\n0,1\n", encoding="utf-8")
    assert main([*CABLE, "identify", str(tmp_path), "--out", str(tmp_path / "c.yaml")]) == 2
    assert "take.csv:1: " in capsys.readouterr().err
    broken = tmp_path / "broken.yaml"
    broken.write_text((folder / "cable.yaml").read_text().replace("slope:", "slip:"))
    words = [*CABLE, "predict", str(broken), str(folder / "check"), "--out", str(tmp_path)]
    assert main(words) == 2
    assert "broken.yaml: is damaged" in capsys.readouterr().err


def test_predictions_do_not_replace_takes(folder: Path, capsys: pytest.CaptureFixture[str]):
    takes = folder / "check"
    before = {file.name: file.read_text() for file in takes.iterdir()}
    words = [*CABLE, "predict", str(folder / "cable.yaml"), str(takes), "--out", f"{takes}/"]
    assert main(words) == 2
    assert "which predictions would replace" in capsys.readouterr().err
    assert {file.name: file.read_text() for file in takes.iterdir()} == before


def test_a_take_of_another_cable_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    take = read_takes(folder / "check")[0]
    header = (folder / "check" / f"{take.name}.csv").read_text().splitlines()[0]
    rows = np.column_stack([take.times, 1.3 * take.positions.reshape(len(take.times), -1)])
    np.savetxt(tmp_path / "long.csv", rows, "%.5f", ",", header=header, comments="")
    words = [*CABLE, "predict", str(folder / "cable.yaml"), str(tmp_path), "--out", str(tmp_path)]
    assert main(words) == 2
    assert "long.csv:2: the cable is" in capsys.readouterr().err


def test_a_take_with_free_markers_only_between_the_frames_compared_is_refused():
    take = example_take(np.random.default_rng(5), 0.5, NOISE)
    later = np.arange(len(take.times)) > 3
    later[2] = True
    take.positions[later, 2:-2] = np.nan
    with pytest.raises(SetError, match=r"no free marker is given in the frames compared"):
        identify([take])


def test_a_prediction_that_fails_is_refused():
    """An end jumps by many times the cable's length."""
    take = example_take(np.random.default_rng(5), 0.5, NOISE)
    take.positions[len(take.times) // 2 :, :2, 0] += 5.0
    cable = Cable(example_geometry(), LAWS, ())
    with pytest.raises(
        SetError, match=r"example: the simulation of the cable fails after 0\.\d+ s"
    ):
        cable.predict(take)


def test_exchanged_held_markers_are_noticed(folder: Path):
    cable = Cable.read(folder / "cable.yaml")
    take = example_take(np.random.default_rng(5), 0.5, NOISE)
    assert exchanged_ends(cable.geometry.arcs, take) == []
    positions = take.positions[:, [0, 1, 2, 3, 4, 5, 7, 6]]
    assert exchanged_ends(cable.geometry.arcs, Take("x", take.times, positions)) == [1]


def test_an_identified_cable_becomes_the_tether_of_a_scenario(folder: Path, tmp_path: Path):
    """Mass per length and diameter turn the numbers per mass into those of a scenario."""
    density, diameter = 0.05, 0.004
    out = tmp_path / "hanging.yaml"
    identified = tmp_path / "cable.yaml"
    text = (folder / "cable.yaml").read_text(encoding="utf-8")
    identified.write_text(text.replace("relaxation_ratio: 0.0", "relaxation_ratio: 0.6"))
    words = [*CABLE, "scenario", str(identified), "--out", str(out)]
    sizes = ["--line-density", str(density), "--diameter", str(diameter)]
    assert main([*words, *sizes]) == 0
    own = tmp_path / "own.yaml"
    own.write_text("base: hanging.yaml\ntip: {mass: 0.2}\n", encoding="utf-8")
    scenario = load_spatial(own)
    cable = Cable.read(identified)
    laws, tether = laws_of(cable.values), scenario.tether
    assert tether.section.bending_stiffness == pytest.approx(
        laws.bending_stiffness * (1.0 + laws.relaxation_ratio) * density, rel=1e-5
    )
    assert tether.bending_relaxation_ratio == pytest.approx(laws.relaxation_ratio, rel=1e-5)
    assert laws.relaxation_ratio == 0.6
    assert scenario.environment.drag().normal == pytest.approx(laws.drag * density, rel=1e-5)
    assert scenario.environment.drag().axial == pytest.approx(
        laws.axial_drag * laws.drag * density, rel=1e-5
    )
    markers = cable.geometry.places[1:-1]
    assert [each.position for each in tether.masses] == pytest.approx(markers, rel=1e-5)
    assert tether.natural_curvature is not None
    nodes = np.linspace(0.0, tether.length, cable.geometry.elements + 1)
    along = tether.natural_curvature.at(nodes)
    expected = natural_curvature(cable.geometry, cable.values)
    assert along == pytest.approx(expected, rel=1e-4)
    # what hangs in the plant bears the weight of cable, markers and mass
    plant = build_plant(scenario)
    state = plant.initial_state()
    weight = 9.81 * (density * tether.length + sum(each.mass for each in tether.masses) + 0.2)
    assert plant.tension(state)[0] == pytest.approx(weight, rel=0.02)
    assert main([*words, "--line-density", "-1", "--diameter", "0.004"]) == 2
