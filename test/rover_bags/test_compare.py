"""Comparison of bags."""

import json
import shutil
from pathlib import Path

import pytest
from contract_bag import MadeUp, Parabola
from made_up_mission import SHORT, Leg, write_mission

from rover_bags.views import report
from rover_bags.views.compare import compare
from rover_cli.command_line import main


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    first, again, other = (folder / name / "bag" for name in ("a", "b", "c"))
    write_mission(first, legs=SHORT)
    shutil.copytree(first, again)
    slower = tuple(Leg(leg.what, leg.duration, 0.8 * leg.rate) for leg in SHORT)
    write_mission(other, legs=slower)
    return [first, again, other]


def test_identical_bags_have_no_differences(bags: list[Path]):
    found = compare(bags[:2])
    assert found.names == ("a/bag", "b/bag")
    assert [row.name for row in found.rows if row.differs] == []
    assert len(found.rows) > 100
    assert "metrics differ by more than 1 % and are marked" in found.as_page()


def test_only_different_metrics_are_marked(bags: list[Path]):
    found = compare(bags[::2]).rows
    for row in found:
        one, other = row.values
        if isinstance(one, int | float) and isinstance(other, int | float):
            assert row.differs == (abs(one - other) > 0.01 * max(abs(one), abs(other))), row
        elif row.group != "settings":
            assert row.differs is (one != other), row
    rows = {(row.group, row.name): row for row in found}
    rate = rows["descents", "descent 1: rate [m/s]"]
    assert rate.differs
    assert [float(value or 0.0) for value in rate.values] == pytest.approx([0.25, 0.2], rel=0.01)
    assert rate.spread == pytest.approx(0.05, rel=0.05)
    assert rows["descents", "descent 1: direction"].values == ("down", "down")
    assert not rows["activities", "hanging, count"].differs
    assert not rows["jumps", "jump 1: jump height [m]"].differs


def test_a_metric_missing_in_one_bag_is_a_difference(bags: list[Path], tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8)
    found = compare([bags[0], made.write(tmp_path / "planar")])
    rows = {(row.group, row.name): row for row in found.rows}
    row = rows["descents", "descent 1: rate [m/s]"]
    assert row.values[1] is None
    assert row.differs
    assert any(row.group == "settings" and row.name == "environment.gravity" for row in found.rows)


def test_page_json_and_text_agree(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["bag", "compare", *map(str, bags), "--quiet", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "a/bag" in shown
    assert any(line.startswith("*  descent 1: rate") for line in shown.splitlines())
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert content["bags"] == ["a/bag", "b/bag", "c/bag"]
    assert len(content["reports"]) == 3
    assert content["differing"] == sum(row["differs"] for row in content["rows"])
    page = (tmp_path / "out" / "comparison.html").read_text()
    assert page.count("<svg") >= 4
    assert 'class="bad"' in page
    same = sum(not row["differs"] for row in content["rows"])
    assert page.count('<tr class="same">') == same > 0
    assert "http" not in page


def test_an_unreadable_bag_is_refused(bags: list[Path], tmp_path: Path):
    assert (
        main(["bag", "compare", str(bags[0]), str(tmp_path / "none")])
        == report.ReportExitCode.REFUSED
    )
