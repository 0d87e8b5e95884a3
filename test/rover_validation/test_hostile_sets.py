"""Damaged files of measurements are read or refused with their place, in a time by their length."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from damage import damaged_text, damaged_tree, little_time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rover_validation.cable.example import LAWS, example_geometry
from rover_validation.cable.model import FORMAT, Cable
from rover_validation.cable.takes import column_names, read_rest_shapes, read_take
from rover_validation.refusals import SetError
from rover_validation.wheel.sets import MEASURED, SETTINGS, read_indentation, read_runs

MARKERS, FRAMES = 6, 12


def lines(header: str, row: Callable[[int], str]) -> str:
    return "\n".join([header, *map(row, range(FRAMES))]) + "\n"


def take_row(frame: int) -> str:
    places = (f"{0.1 * marker:g},0,{0.5 + 0.01 * frame:g}" for marker in range(MARKERS))
    return ",".join([f"{0.02 * frame:g}", *places])


INDENTATION = {
    "_about": {
        "wheel": {"radius_m": 0.1, "width_m": 0.06},
        "soil": {"specific_weight_N_m3": 16000.0, "repose_deg": 35.0},
    },
    "plate": {
        "kind": "plate", "diameter_mm": 60.0, "z_mm": [1.0, 2.0, 3.0, 4.0, 5.0],
        "F_N": [1.0, 2.5, 4.0, 6.0, 8.5],
    },
}  # fmt: skip
SETS: dict[str, tuple[Callable[[Path], object], str]] = {
    "take.csv": (read_take, lines(",".join(column_names(MARKERS)), take_row)),
    "rest.csv": (
        read_rest_shapes,
        lines("marker,x_m,y_m,z_m", lambda marker: f"{marker},{0.1 * marker:g},0,1"),
    ),
    "runs.csv": (
        read_runs,
        lines(
            ",".join((*SETTINGS, *MEASURED)),
            lambda _: ",".join(["smooth", *["1.5"] * (len(SETTINGS) - 1 + len(MEASURED))]),
        ),
    ),
    "indentation.json": (read_indentation, json.dumps(INDENTATION, indent=1)),
}


@pytest.mark.parametrize("name", SETS)
def test_the_sets_are_good_before_they_are_damaged(tmp_path: Path, name: str):
    reader, good = SETS[name]
    (tmp_path / name).write_text(good, "utf-8")
    assert reader(tmp_path / name) is not None


@pytest.mark.fuzz
@given(name=st.sampled_from(sorted(SETS)), data=st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_set_is_read_or_refused(name: str, data: st.DataObject):
    reader, good = SETS[name]
    text = data.draw(damaged_text(good, ",:"))
    if name.endswith(".json") and data.draw(st.booleans()):
        text = json.dumps(data.draw(damaged_tree(INDENTATION)))
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(text, "utf-8", "surrogatepass")
        refused = name
        try:
            with little_time(1.0):
                reader(path)
        except SetError as error:
            refused = str(error)
    assert name in refused
    assert len(refused) < 2000


def edited(name: str, line: int, column: int, cell: str) -> str:
    """A good set with another text in one cell; lines count from 0."""
    rows = [row.split(",") for row in SETS[name][1].splitlines()]
    rows[line][column] = cell
    return "\n".join(map(",".join, rows))


@pytest.mark.parametrize("name", ["take.csv", "rest.csv", "runs.csv"])
@pytest.mark.parametrize("change", [
    lambda text: "\ufeff" + text,
    lambda text: text.replace("\n", "\r\n"),
    lambda text: text.replace("\n", "\n\n") + "\n\n",
], ids=["byte order mark", "CRLF", "empty lines"])  # fmt: skip
def test_a_spreadsheet_s_csv_holds_the_same(
    tmp_path: Path, name: str, change: Callable[[str], str]
):
    reader, good = SETS[name]
    path = tmp_path / name
    path.write_text(good, "utf-8")
    expected = reader(path)
    path.write_bytes(change(good).encode())
    assert repr(reader(path)) == repr(expected)


@pytest.mark.parametrize("name", ["take.csv", "rest.csv", "runs.csv"])
@pytest.mark.parametrize("separator", [";", "\t", "|"])
def test_another_separator_is_named(tmp_path: Path, name: str, separator: str):
    (tmp_path / name).write_text(SETS[name][1].replace(",", separator), "utf-8")
    with pytest.raises(SetError, match=r"line 1: the cells are separated by .*should be by ','"):
        SETS[name][0](tmp_path / name)


@pytest.mark.parametrize("name", ["take.csv", "runs.csv"])
@pytest.mark.parametrize("cell", ["1_5", "\u0661", "0x1", "1e999", "nan", "infinity", "1'000"])
def test_what_is_no_decimal_number_is_refused(tmp_path: Path, name: str, cell: str):
    (tmp_path / name).write_text(edited(name, 3, 2, cell), "utf-8")
    with pytest.raises(SetError, match=r"(line |:)4: "):
        SETS[name][0](tmp_path / name)


def test_a_column_that_stands_twice_is_refused(tmp_path: Path):
    good = SETS["runs.csv"][1].splitlines()
    rows = [good[0] + ",load_N", *(row + ",9" for row in good[1:])]
    (tmp_path / "runs.csv").write_text("\n".join(rows), "utf-8")
    with pytest.raises(SetError, match="line 1: the column 'load_N' stands twice"):
        read_runs(tmp_path / "runs.csv")


def test_a_line_is_counted_in_the_file_after_empty_ones(tmp_path: Path):
    rows = edited("take.csv", 5, 2, "x").splitlines()
    (tmp_path / "take.csv").write_text("\n".join([rows[0], "", "", *rows[1:]]), "utf-8")
    with pytest.raises(SetError, match=":8: column 3 is 'x'"):
        read_take(tmp_path / "take.csv")


def test_a_huge_cell_is_refused_with_its_line(tmp_path: Path):
    (tmp_path / "runs.csv").write_text(edited("runs.csv", 3, 0, "w" * 200_000), "utf-8")
    with pytest.raises(SetError, match=r"runs.csv, line 4: field larger"):
        read_runs(tmp_path / "runs.csv")


@pytest.mark.parametrize(("section", "name", "value", "words"), [
    ("plate", "F_N", [-1.0, -2.5, -4.0, -6.0, -8.5], "a force above 0 at the deepest"),
    ("plate", "z_mm", [3.0] * 5, "several depths"),
    ("plate", "z_mm", ["1", "2", "3", "4", "5"], "lists of numbers"),
    ("plate", "z_mm", [True, 2, 3, 4, 5], "lists of numbers"),
    ("plate", "F_N", [1.0, 2.5, 4.0, 6.0, 1e300], "within 1e6 N"),
    ("plate", "diameter_mm", True, "diameter_mm = True: should be a number from 1 to 5000"),
    ("wheel", "radius_m", "0.1", "radius_m = '0.1': should be a number"),
    ("wheel", "radius_m", 58.0, "radius_m = 58.0: should be a number from 0.001 to 10"),
    ("wheel", "width_m", None, "width_m = None: should be a number"),
    ("soil", "repose_deg", 120.0, "repose_deg = 120.0: should be a number from 1 to 89"),
])  # fmt: skip
def test_an_indentation_that_cannot_be_is_refused(
    tmp_path: Path, section: str, name: str, value: object, words: str
):
    content = json.loads(json.dumps(INDENTATION))
    (content if section == "plate" else content["_about"])[section][name] = value
    (tmp_path / "indentation.json").write_text(json.dumps(content), "utf-8")
    with pytest.raises(SetError, match=words):
        read_indentation(tmp_path / "indentation.json")


def test_a_name_that_stands_twice_in_an_indentation_is_refused(tmp_path: Path):
    text = SETS["indentation.json"][1].replace('"kind"', '"kind": "wheel", "kind"')
    (tmp_path / "indentation.json").write_text(text, "utf-8")
    with pytest.raises(SetError, match="the name 'kind' stands twice"):
        read_indentation(tmp_path / "indentation.json")


def cable_content() -> dict[str, dict[str, object]]:
    geometry = example_geometry()
    free = len(geometry.arcs) - 3
    return {
        "geometry": {"arcs": geometry.arcs.tolist(), "rest": geometry.rest.tolist()},
        "fixed": dict(LAWS),
        "identified": {},
        "band": {"low": [[-0.01] * 3] * free, "high": [[0.01] * 3] * free, "slope": 0.5,
                 "speed": 0.3, "rise": 0.2},
    }  # fmt: skip


def write_cable(path: Path, content: object) -> None:
    path.write_text(json.dumps({"format": FORMAT, **content}), "utf-8")  # type: ignore[dict-item]


def test_a_cable_is_read(tmp_path: Path):
    write_cable(tmp_path / "cable.yaml", cable_content())
    assert Cable.read(tmp_path / "cable.yaml").values == LAWS


@pytest.mark.parametrize(("section", "name", "value", "words"), [
    ("fixed", "drag", None, "no number drag"),
    ("fixed", "drag", 10**400, "is damaged"),
    ("fixed", "bending_stiffness", -1.0, "bending_stiffness = -1.0, should be finite, above 0"),
    ("geometry", "elements", 10**9, "elements = 1000000000, should be a whole number from 1"),
    ("geometry", "longest_step", 0.0, "longest_step = 0.0, should be finite, above 0"),
    ("geometry", "reference", 3, "reference = 3, should be 0, 1 or 2"),
    ("geometry", "rest", [[0.0], [0.0]], r"rest has the shape \(2, 1\)"),
    ("band", "low", [[0.0] * 3], r"low has the shape \(1, 3\)"),
    ("band", "speed", 0.0, "speed = 0.0, should be finite, above 0"),
])  # fmt: skip
def test_a_damaged_cable_is_refused(
    tmp_path: Path, section: str, name: str, value: object, words: str
):
    content = cable_content()
    if value is None:
        del content[section][name]
    else:
        content[section][name] = value
    write_cable(tmp_path / "cable.yaml", content)
    with pytest.raises(SetError, match=words):
        Cable.read(tmp_path / "cable.yaml")


@pytest.mark.parametrize("section", ["geometry", "fixed", "identified", "band"])
@pytest.mark.parametrize("value", [[], "text", 3, None])
def test_a_cable_without_a_section_is_refused(tmp_path: Path, section: str, value: object):
    write_cable(tmp_path / "cable.yaml", cable_content() | {section: value})
    with pytest.raises(SetError, match="is damaged"):
        Cable.read(tmp_path / "cable.yaml")
