"""Takes of a measured cable: what is read, what is refused with its line, what is written."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rover_validation.cable.takes import (
    Take,
    column_names,
    read_rest_shapes,
    read_take,
    read_takes,
    write_prediction,
)
from rover_validation.refusals import SetError

MARKERS, FRAMES = 6, 12
Rows = list[list[str]]


def rows_of_a_take() -> Rows:
    positions = np.zeros((FRAMES, MARKERS, 3))
    positions[:, :, 0] = 0.1 * np.arange(MARKERS)
    positions[:, :, 2] = 0.5 + 0.01 * np.arange(FRAMES)[:, None]
    body = [
        [f"{0.02 * frame:g}", *(f"{value:g}" for value in positions[frame].ravel())]
        for frame in range(FRAMES)
    ]
    return [column_names(MARKERS), *body]


def written(path: Path, rows: Rows) -> Path:
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    return path


def test_a_take_is_read_with_its_empty_cells(tmp_path: Path):
    rows = rows_of_a_take()
    rows[5][7:10] = ["", "", ""]  # marker 2 in frame 4
    take = read_take(written(tmp_path / "one.csv", rows))
    assert (take.name, take.markers, len(take.times)) == ("one", MARKERS, FRAMES)
    assert take.period == pytest.approx(0.02)
    assert np.isnan(take.positions[4, 2]).all()
    assert np.isnan(take.positions).sum() == 3
    assert take.positions[1, 3].tolist() == pytest.approx([0.3, 0.0, 0.51])


def cell(line: int, column: int, text: str) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        rows[line - 1][column] = text

    return change


def cells(line: int, first: int, count: int, text: str) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        rows[line - 1][first : first + count] = [text] * count

    return change


def without_line(line: int) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        del rows[line - 1]

    return change


def at_one_place(line: int, marker: int) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        row, at = rows[line - 1], 1 + 3 * marker
        row[at + 3 : at + 6] = row[at : at + 3]

    return change


def in_millimetres(rows: Rows) -> None:
    for row in rows[1:]:
        row[1:] = [f"{1000.0 * float(value):g}" for value in row[1:]]


def in_milliseconds(rows: Rows) -> None:
    for row in rows[1:]:
        row[0] = f"{1000.0 * float(row[0]):g}"


@pytest.mark.parametrize(
    ("change", "line", "reason"),
    [
        (cell(1, 4, "x1_mm"), 1, "must be x1_m"),
        (lambda rows: rows[0].append("q"), 1, "one too many"),
        (lambda rows: rows[4].pop(), 5, "18 cells"),
        (cell(6, 3, "nan"), 6, "finite number"),
        (cell(6, 3, "abc"), 6, "finite number"),
        (cell(7, 0, ""), 7, "time is missing"),
        (without_line(6), 6, "without gaps"),
        (cell(6, 0, "0.02"), 6, "does not increase"),
        (cells(8, 4, 3, ""), 8, "held marker 1 is missing"),
        (cells(3, 7, 3, ""), 3, "marker 2 is missing"),
        (cell(9, 8, ""), 9, "lacks others"),
        (in_millimetres, 2, "metres"),
        (in_milliseconds, 3, "milliseconds"),
        (cell(9, 3, "1.6"), 9, "jumps"),
        (at_one_place(9, 2), 9, "markers 2 and 3 are at one place"),
    ],
)
def test_a_damaged_take_is_refused_with_its_line(
    tmp_path: Path, change: Callable[[Rows], object], line: int, reason: str
):
    rows = rows_of_a_take()
    change(rows)
    path = written(tmp_path / "bad.csv", rows)
    with pytest.raises(SetError) as refused:
        read_take(path)
    assert str(refused.value).startswith(f"{path}:{line}: ")
    assert reason in str(refused.value)


def test_a_folder_holds_takes_of_one_cable(tmp_path: Path):
    with pytest.raises(SetError, match="no such folder"):
        read_takes(tmp_path / "none")
    with pytest.raises(SetError, match="no CSV file"):
        read_takes(tmp_path)
    written(tmp_path / "a.csv", rows_of_a_take())
    written(tmp_path / "b.csv", [row[:-3] for row in rows_of_a_take()])
    with pytest.raises(SetError, match=r"5 markers, but a\.csv has 6"):
        read_takes(tmp_path)


def test_a_prediction_has_the_band_beside_each_free_marker(tmp_path: Path):
    take = read_take(written(tmp_path / "one.csv", rows_of_a_take()))
    predicted = take.free.copy()
    path = tmp_path / "predictions" / "one.csv"
    write_prediction(path, take, predicted, predicted - 0.01, predicted + 0.02)
    with path.open(encoding="utf-8") as stream:
        table = list(csv.DictReader(stream))
    assert [name for name in table[0] if not name.endswith(("_lo", "_hi"))] == column_names(MARKERS)
    assert [name for name in table[0] if name.startswith("x")] == [
        "x0_m", "x1_m", "x2_m", "x2_m_lo", "x2_m_hi", "x3_m", "x3_m_lo", "x3_m_hi", "x4_m", "x5_m",
    ]  # fmt: skip
    last = table[-1]
    assert float(last["z3_m_lo"]) == pytest.approx(float(last["z3_m"]) - 0.01)
    assert float(last["z3_m_hi"]) == pytest.approx(float(last["z3_m"]) + 0.02)
    assert float(last["time_s"]) == pytest.approx(take.times[-1])


def test_rest_shapes_are_read_by_cable(tmp_path: Path):
    path = tmp_path / "rest.csv"
    path.write_text("cable,marker,x_m,y_m,z_m\n1,0,0,0,0\n1,1,1,0,0\n2,0,0,5,0\n", encoding="utf-8")
    first, second = read_rest_shapes(path)
    assert first.tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    assert second.tolist() == [[0.0, 5.0, 0.0]]
    path.write_text("cable,marker,x_m,y_m,z_m\n1,0,0,0,0\n1,2,1,0,0\n", encoding="utf-8")
    with pytest.raises(SetError, match=r"rest\.csv:3: marker 1 of the cable must come here"):
        read_rest_shapes(path)
    path.write_text("cable,marker,x_m,y_m,z_m\n1,0,0,0,0\n1,1,0,0,0\n", encoding="utf-8")
    with pytest.raises(SetError, match=r"rest\.csv:3: marker 1 is at the place of the marker"):
        read_rest_shapes(path)


def test_a_rest_shape_names_its_cable_by_a_word(tmp_path: Path):
    path = tmp_path / "rest.csv"
    path.write_text(
        "cable,marker,x_m,y_m,z_m\nred,0,0,0,0\nred ,1,1,0,0\nblue 2,0,0,5,0\n", encoding="utf-8"
    )
    first, second = read_rest_shapes(path)
    assert first.tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    assert second.tolist() == [[0.0, 5.0, 0.0]]


@pytest.mark.parametrize(
    "text", ["cable,marker,x_m,y_m,z_m\na,,0,0,0\n", "marker,x_m,y_m,z_m\n,0,0,0\n"]
)
def test_a_rest_shape_without_the_number_of_a_marker_is_refused(tmp_path: Path, text: str):
    path = tmp_path / "rest.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SetError, match=r"rest\.csv:2: marker 0 of the cable must come here"):
        read_rest_shapes(path)


def test_a_take_has_times_and_markers():
    take = Take("t", np.linspace(0.0, 0.2, 3), np.zeros((3, 7, 3)))
    assert take.free.shape == (3, 3, 3)
    assert take.period == pytest.approx(0.1)
