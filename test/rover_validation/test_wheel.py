"""Identification, prediction and refusals on a made-up soil bin."""

import csv
import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from rover_cli.command_line import main
from rover_sim import Soil
from rover_validation.refusals import SetError
from rover_validation.wheel import fitting
from rover_validation.wheel import report as wheel_report
from rover_validation.wheel.example import SOIL, WHEELS, write_example
from rover_validation.wheel.sets import read_indentation, read_runs, read_soil, write_soil


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("soil_bin")
    write_example(folder, seed=3)
    return folder


@pytest.fixture(scope="module")
def result(bin_folder: Path) -> fitting.SoilIdentification:
    runs = read_runs(bin_folder / "measured.csv")
    return fitting.identify(runs, read_indentation(bin_folder / "indentation.json"))


def test_the_plate_law_comes_from_the_standing_wheel(bin_folder: Path):
    k_c, k_phi, n = fitting.plate_law(read_indentation(bin_folder / "indentation.json"))
    assert k_c == 0.0
    at_20_mm = k_phi * 0.02**n / (SOIL.frictional_modulus * 0.02**SOIL.exponent)
    assert at_20_mm == pytest.approx(1.0, rel=0.02)
    assert n == pytest.approx(SOIL.exponent, abs=0.03)


def test_plates_give_both_moduli(bin_folder: Path, tmp_path: Path):
    content = json.loads((bin_folder / "indentation.json").read_text())
    depth = np.arange(1.0, 30.0, 1.0)
    plates = {"_about": content["_about"]}
    for diameter in (60.0, 80.0, 100.0):
        pressure = (3.0e3 / (diameter * 1e-3) + 9e5) * (depth * 1e-3) ** 1.1
        force = pressure * math.pi / 4 * (diameter * 1e-3) ** 2
        plates[f"plate_{diameter:g}"] = {
            "kind": "plate",
            "diameter_mm": diameter,
            "z_mm": depth.tolist(),
            "F_N": force.tolist(),
        }
    path = tmp_path / "plates.json"
    path.write_text(json.dumps(plates))
    k_c, k_phi, n = fitting.plate_law(read_indentation(path))
    assert (k_c, k_phi, n) == pytest.approx((3.0e3, 9e5, 1.1), rel=1e-3)


def test_held_back_runs_are_predicted_within_the_noise(
    bin_folder: Path, result: fitting.SoilIdentification
):
    runs = read_runs(bin_folder / "settings.csv", measured=False)
    truth = fitting.predict(SOIL, WHEELS, runs)
    centre, half = fitting.bands(result.found, runs)
    rms = np.sqrt(np.mean((centre - truth) ** 2, axis=0)) * [1.0, 1.0, 1e3]
    assert np.all(rms < [0.6, 0.5, 1.0])
    assert np.mean(np.abs(centre - truth) <= half) > 0.8


def test_the_numbers_return_within_their_intervals(result: fitting.SoilIdentification):
    inside = [low <= getattr(SOIL, name) <= high for name, (low, high) in result.interval.items()]
    assert sum(inside) >= len(inside) - 2
    assert len(inside) == 12


def test_numbers_that_are_no_soil_s_are_reported(result: fitting.SoilIdentification):
    assert "Rankine" in result.remarks["ploughing"]
    assert "grousers" in result.remarks["excavation"]
    assert "grousers" in result.remarks["grouser_thrust"]


def test_a_soil_file_is_read_as_it_was_written(result: fitting.SoilIdentification, tmp_path: Path):
    write_soil(tmp_path / "soil.yaml", result.found)
    found = read_soil(tmp_path / "soil.yaml")
    assert found.soil == result.found.soil
    assert found.wheels == result.found.wheels
    np.testing.assert_allclose(found.covariance, result.found.covariance, rtol=1e-5)


def test_a_soil_file_with_an_impossible_number_is_refused_by_file_and_name(
    result: fitting.SoilIdentification, tmp_path: Path
):
    path = tmp_path / "soil.yaml"
    write_soil(path, result.found)
    content = yaml.safe_load(path.read_text())
    content["soil"]["cohesion"] = -1.0
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(SetError, match=r"soil\.yaml: no soil of `identify`: cohesion = -1\.0"):
        read_soil(path)


def test_a_smooth_wheel_alone_has_no_excavation(bin_folder: Path, tmp_path: Path):
    lines = (bin_folder / "measured.csv").read_text().splitlines()
    path = tmp_path / "smooth.csv"
    path.write_text("\n".join([lines[0], *(x for x in lines if x.startswith("smooth"))]) + "\n")
    found = fitting.identify(read_runs(path), read_indentation(bin_folder / "indentation.json"))
    assert not {"excavation", "grouser_thrust"} & set(found.found.names)
    assert found.found.soil.excavation == Soil().excavation


def test_the_commands_identify_predict_and_report(
    bin_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    soil, predicted, report = (tmp_path / name for name in ("soil.yaml", "p.csv", "report"))
    measured, indentation = bin_folder / "measured.csv", bin_folder / "indentation.json"
    wheel = ["validate", "wheel"]
    assert (
        main([*wheel, "identify", f"{measured}", "--soil", f"{indentation}", "--out", f"{soil}"])
        == 0
    )
    assert "12 numbers of" in capsys.readouterr().out
    settings = bin_folder / "settings.csv"
    assert main([*wheel, "predict", f"{soil}", f"{settings}", "--out", f"{predicted}"]) == 0
    with predicted.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(settings.read_text().splitlines()) - 1
    assert all(float(r["Fx_N_lo"]) < float(r["Fx_N"]) < float(r["Fx_N_hi"]) for r in rows)
    assert {row["within_validity"] for row in rows} == {"1"}
    again = tmp_path / "again.csv"
    assert main([*wheel, "predict", f"{soil}", f"{predicted}", "--out", f"{again}"]) == 0
    assert again.read_text() == predicted.read_text()
    before = measured.read_text()
    assert main([*wheel, "predict", f"{soil}", f"{measured}", "--out", f"{measured}"]) == 2
    assert "which predictions would replace" in capsys.readouterr().err
    assert measured.read_text() == before
    assert main([*wheel, "report", f"{soil}", f"{measured}", "--out", f"{report}"]) == 0
    assert "smooth, at angles" in (report / "report.md").read_text()
    assert (report / "measured_over_predicted.png").stat().st_size > 10_000
    assert (report / "errors_over_slip.png").stat().st_size > 10_000


def test_each_of_many_wheels_is_in_the_picture(
    bin_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runs = read_runs(bin_folder / "measured.csv")
    names = [f"wheel {number % 6}" for number in range(len(runs.wheel))]
    figure, axes = wheel_report._figure(1)
    monkeypatch.setattr(wheel_report, "_figure", lambda _rows: (figure, axes))
    wheel_report._measured_over_predicted(
        tmp_path / "picture.png",
        dataclasses.replace(runs, wheel=tuple(names)),
        runs.measured,
        np.zeros_like(runs.measured),
    )
    legend = axes[0][0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == sorted(set(names))


def test_beyond_75_deg_a_prediction_is_marked(bin_folder: Path):
    runs = read_runs(bin_folder / "settings.csv", measured=False)
    steep = dataclasses.replace(runs, angle=np.full_like(runs.angle, math.radians(90.0)))
    assert not fitting.within_validity(steep).any()
    assert fitting.within_validity(runs).all()


@pytest.mark.parametrize(
    ("line", "column", "cell", "named"),
    [
        (3, "load_N", "heavy", "line 3: load_N = 'heavy'"),
        (2, "Fx_N", "nan", "line 2: Fx_N = 'nan'"),
        (4, "beta_deg", "95", "line 4: beta_deg = '95'"),
        (5, "Vx_mm_s", "0.02", "line 5: Vx_mm_s = '0.02'"),
        (1, "sinkage_mm", "sinkage_m", "line 1: no column sinkage_mm"),
    ],
)
def test_damaged_runs_are_refused_with_their_line(
    bin_folder: Path, tmp_path: Path, line: int, column: str, cell: str, named: str
):
    rows = [row.split(",") for row in (bin_folder / "measured.csv").read_text().splitlines()]
    rows[line - 1][rows[0].index(column)] = cell
    path = tmp_path / "damaged.csv"
    path.write_text("\n".join(",".join(row) for row in rows))
    with pytest.raises(SetError, match=named):
        read_runs(path)


def test_a_short_line_is_refused(bin_folder: Path, tmp_path: Path):
    lines = (bin_folder / "measured.csv").read_text().splitlines()
    lines[6] = lines[6].rsplit(",", 2)[0]
    path = tmp_path / "short.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(SetError, match="line 7: 8 cells: should be 10"):
        read_runs(path)


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("wheel_smooth_1", {"kind": "cone"}, "wheel_smooth_1: kind = 'cone'"),
        ("wheel_smooth_1", {"F_N": [1.0, 2.0]}, "wheel_smooth_1: 40 of z_mm, 2 of F_N"),
        ("_about", {"wheel": {"width_m": 0.05}}, "_about.wheel: radius_m = None"),
    ],
)
def test_damaged_indentation_is_refused(
    bin_folder: Path, tmp_path: Path, name: str, change: dict[str, object], named: str
):
    content = json.loads((bin_folder / "indentation.json").read_text())
    content[name].update(change)
    path = tmp_path / "damaged.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SetError, match=named):
        read_indentation(path)


def test_a_wheel_that_is_not_described_is_refused(
    bin_folder: Path, result: fitting.SoilIdentification
):
    runs = read_runs(bin_folder / "measured.csv")
    other = dataclasses.replace(runs, wheel=("spoked", *runs.wheel[1:]))
    with pytest.raises(
        SetError, match=r"run 1: wheel = 'spoked': should be one of grouser, smooth"
    ):
        fitting.check_wheels(result.found.wheels, other, "settings.csv")
