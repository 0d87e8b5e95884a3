"""The document of the validation: it is what the command writes, from what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from rover_cli.command_line import main
from rover_verify.checks import CheckBatch, SetsNotGiven, measured_sets
from rover_verify.requirements.matrix import measure
from rover_verify.requirements.requirements import load_requirements
from rover_verify.requirements.validation_page import (
    BEGIN,
    END,
    ResultsError,
    ValidationResults,
    document,
    measured_of,
    results_of,
    summary_of,
)

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROWS = load_requirements()
MEASURED_SETS = [row for row in ROWS if row.area == "Measured sets"]
EMPTY = f"# Title\n\n{BEGIN}\n{END}\n\nAfter.\n"


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sets that the examples of the commands make, in the layout that the summary reads."""
    folder: Path = tmp_path_factory.mktemp("sets")
    cable = folder / "cables" / "thin"
    validate = ["validate", "cable"]
    assert main([*validate, "example", str(cable), "--takes", "3", "--duration", "1.2"]) == 0
    words = [*validate, "identify", str(cable / "identify"), "--out", str(cable / "cable.yaml")]
    assert main([*words, "--numbers", "5"]) == 0
    assert main(["validate", "wheel", "example", str(folder / "wheels" / "made_up")]) == 0
    (folder / "wheels" / "source.txt").write_text("A made-up\nsoil bin.\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def summary(sets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("summary") / "summary.yaml"
    assert main(["validate", "summary", str(sets), "--out", str(path)]) == 0
    return path


def test_the_document_is_what_the_command_writes():
    text = (DOCS / "validation.md").read_text(encoding="utf-8")
    results = results_of(DOCS / "validation.yaml")
    assert text == document(text, results, ROWS), "run: mother_rover validate page"
    assert results.summary is not None


def test_the_kept_results_are_within_the_limits_of_the_required_rows():
    measured = results_of(DOCS / "validation.yaml").measured
    rows = {row.id: row for row in ROWS if row.reference}
    assert set(measured) <= set(rows)
    assert not [
        name for name, value in measured.items()
        if rows[name].status == "required" and not rows[name].limit.holds(value)
    ]  # fmt: skip


def test_a_summary_becomes_a_document(summary: Path, tmp_path: Path):
    out, results = tmp_path / "page.md", tmp_path / "page.yaml"
    out.write_text(EMPTY, encoding="utf-8")
    verification = tmp_path / "verification.json"
    verification.write_text(
        json.dumps(
            [
                {"id": "TETHER-SAG-01", "measured": 1.25e-5},
                {"id": "TETHER-SAG-02", "measured": None},
                {"id": "SPEED-LINEAR-01", "measured": 3.0},
            ]
        ),
        encoding="utf-8",
    )
    words = ["validate", "page", "--out", str(out), "--results", str(results)]
    new = ["--summary", str(summary), "--verification", str(verification)]
    assert main([*words, *new]) == 0
    text = out.read_text(encoding="utf-8")
    assert text.startswith("# Title\n\n")
    assert text.endswith("\n\nAfter.\n")
    assert "Measured by: A made-up soil bin." in text
    assert "Measured by: not stated" in text
    assert "| thin | 3 | 2 |" in text
    assert "| smooth, at angles |" in text
    assert "`bending_stiffness` [m4/s2]" in text
    assert "| 1.25e-05 |" in text
    assert "SPEED-LINEAR-01" not in text
    assert main(words) == 0  # from what is kept
    assert out.read_text(encoding="utf-8") == text


def test_a_summary_is_read_as_it_was_written(summary: Path):
    content = yaml.safe_load(summary.read_text(encoding="utf-8"))
    assert summary_of(summary).to_mapping() == content


def test_without_sets_the_rows_are_open(tmp_path: Path):
    for row in MEASURED_SETS:
        result = measure(row, CheckBatch(runs=1, seed=1, folder=tmp_path))
        assert (result.state, result.measured) == ("OPEN", None), row.id
        assert "--sets" in result.note


def test_with_sets_every_row_is_measured(sets: Path, tmp_path: Path):
    batch = CheckBatch(runs=1, seed=1, folder=tmp_path, sets=sets)
    values = {row.id: measure(row, batch).measured or 0.0 for row in MEASURED_SETS}
    assert all(value > 0.0 for value in values.values()), values
    assert values["MEASURED-CABLE-01"] < 5.0  # simulated: predicted to a few mm
    assert values["MEASURED-WHEEL-05"] < 2.1


def test_a_folder_without_a_kind_of_set_leaves_its_rows_open(tmp_path: Path):
    batch = CheckBatch(runs=1, seed=1, folder=tmp_path, sets=tmp_path)
    with pytest.raises(SetsNotGiven, match="holds no cables/NAME"):
        measured_sets.cables(batch, "mean", "mean")
    with pytest.raises(SetsNotGiven, match="holds no wheels/NAME"):
        measured_sets.wheel(batch, "smooth", "sinkage", "at angles")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("# Title\n", BEGIN), (f"{BEGIN}\n", END)],
)
def test_a_document_without_its_markers_is_refused(text: str, complaint: str):
    with pytest.raises(ResultsError, match=f"lacks the line {complaint}"):
        document(text, ValidationResults(None, {}), ROWS)


@pytest.mark.parametrize(
    "content", ["", "3", "[1, 2]", "summary: 3", "{summary: null}", "cables: ["]
)
def test_files_that_are_no_results_are_refused(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "file"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ResultsError, match="file"):
        results_of(path)
    with pytest.raises(ResultsError, match="file"):
        summary_of(path)
    with pytest.raises(ResultsError, match="file"):
        measured_of(path, ROWS)
    out = tmp_path / "page.md"
    out.write_text(EMPTY, encoding="utf-8")
    words = ["validate", "page", "--out", str(out), "--results", str(tmp_path / "none")]
    assert main([*words, "--summary", str(path)]) == 2
    assert "mother_rover validate page:" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == EMPTY


def test_an_empty_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["validate", "summary", str(tmp_path), "--out", str(tmp_path / "summary.yaml")]
    assert main(words) == 2
    assert "neither cables/NAME nor wheels/NAME" in capsys.readouterr().err
