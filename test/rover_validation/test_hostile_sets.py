"""Damaged files of measurements are read or refused with their place, in a time by their length."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from damage import damaged_text, damaged_tree
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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
        began = time.thread_time()
        try:
            reader(path)
        except SetError as error:
            refused = str(error)
        else:
            refused = name
        assert time.thread_time() - began < 1.0
    assert name in refused
    assert len(refused) < 2000
