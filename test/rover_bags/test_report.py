"""The report as page, text and JSON."""

import json
import math
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from contract_bag import MadeUp, Parabola
from made_up_mission import SHORT, mission
from PIL import Image

from msg_schemas import topics
from msg_schemas.samples import TextSample
from rover_bags.analysis.metrics import measure
from rover_bags.reading.read import read_bag
from rover_bags.views import report, summary
from rover_bags.views.animation import scene_of
from rover_bags.views.bag_analysis import Drawings
from rover_bags.views.compare import compare
from rover_bags.views.report_page import as_page
from rover_bags.views.spatial_scene import spatial_scene
from rover_cli.command_line import main

VOID = {"meta", "input", "br", "link", "img", "hr"}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = MadeUp()
    second = Parabola(take_off=2.0, up=1.0, forward=-0.2, turning=0.3, start=Parabola().landing)
    made.jumps([Parabola(), second], until=2.8)
    made.rows = [r for r in made.rows if not (r[1] == topics.LOAD_CELL and 0.5 < r[0] < 0.8)]
    made.event(1.003, "take_off", "the <latch> has tripped & flown", {"speed": "2.0"})
    made.refusal(0.5, topics.JUMP_REQUEST, "position is nan")
    return made.write(tmp_path_factory.mktemp("bags") / "two jumps")


@pytest.fixture(scope="module")
def written(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "out"
    assert main(["bag", "report", str(bag), "--out", str(folder)]) == report.ReportExitCode.OK
    return folder


class Page(HTMLParser):
    """Asserts that tags close in order; collects addresses, identifiers and scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.names: list[str] = []
        self.seen: list[str] = []
        self.data: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        for key, value in attrs:
            if key in {"src", "href", "xlink:href", "action", "data", "srcset"}:
                self.addresses.append(value or "")
            if key == "id":
                self.names.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.data.append(data)


@pytest.fixture(scope="module")
def page(written: Path) -> Page:
    parsed = Page()
    parsed.feed((written / "report.html").read_text())
    return parsed


def test_the_page_is_well_formed_and_its_identifiers_are_unique(page: Page):
    assert page.open == []
    assert len(page.names) == len(set(page.names))
    assert page.seen.count("svg") >= 12
    assert page.seen.count("canvas") == 2


def test_the_page_needs_no_external_resources(written: Path, page: Page):
    text = (written / "report.html").read_text()
    assert all(a.startswith(("#", "data:image/png;base64,")) for a in page.addresses)
    assert {a[1:] for a in page.addresses if a.startswith("#")} <= set(page.names)
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\((?!#)", text)


def test_texts_of_the_bag_are_escaped_in_the_page(written: Path):
    text = (written / "report.html").read_text()
    assert "the &lt;latch&gt; has tripped &amp; flown" in text
    assert "position is nan" in text
    assert f"{Parabola().height:.4f} m" in text
    assert "1 gap, the longest 0.300 s at 0.500 s" in text


def test_the_player_shows_the_recorded_motion(page: Page, bag: Path):
    scenes = [json.loads(text) for text in page.data if text.startswith("{")]
    assert len(scenes) == 2
    scene = scenes[0]
    assert len(scene["time"]) == len(scene["body1"]) == len(scene["tether"])
    jump = Parabola()
    for time, (x, z, theta) in zip(scene["time"], scene["body1"], strict=True):
        expected, _ = jump.at(time + jump.take_off)
        assert (x, z, theta) == pytest.approx(tuple(expected), abs=2e-4)
    assert scene["time"][0] < 0.0 < jump.flight_time < scene["time"][-1]


def test_the_json_report_has_its_documented_keys(written: Path):
    content = json.loads((written / "metrics.json").read_text(), parse_constant=_refuse)
    jump = Parabola()
    assert content["jump_height_m"] == pytest.approx(jump.height)
    assert content["attitude_variation_rad"] == pytest.approx(0.8 * jump.flight_time)
    assert content["flight_time_s"] == pytest.approx(jump.flight_time)
    assert content["travel_m"] == pytest.approx(0.5 * jump.flight_time)
    assert content["slack"] == pytest.approx(0.5)
    assert content["peak_tension_N"] == pytest.approx(7.5)
    assert content["energy_drift_J"] == pytest.approx(4.2e-7)
    assert len(content["jumps"]) == 2
    assert content["topics"][topics.LOAD_CELL]["gaps"] == 1
    assert content["seed"] == 7


def _refuse(text: str) -> float:
    raise AssertionError(f"{text} is no JSON")


def test_the_animation_has_different_frames(written: Path):
    with Image.open(written / "animation.gif") as picture:
        frames = int(getattr(picture, "n_frames", 1))
        assert frames > 60
        assert picture.size[0] == 640
        first = picture.convert("RGB").tobytes()
        picture.seek(frames // 2)
        assert picture.convert("RGB").tobytes() != first


def test_the_plots_are_valid_svg_files(written: Path):
    plots = sorted(path.stem for path in written.glob("*.svg"))
    assert plots == [
        "along", "attitude", "drift", "energy", "height", "overview", "path", "strips", "tension",
    ]  # fmt: skip
    for name in plots:
        root = ET.parse(written / f"{name}.svg").getroot()
        assert root.tag.endswith("svg")
        words = " ".join(text for text in root.itertext() if text.strip())
        assert "[" in words, f"{name} has axes without units"


def test_the_terminal_shows_the_same_values(bag: Path, tmp_path: Path, capsys: Any):
    assert main(["bag", "report", str(bag), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert f"{Parabola().height:.4f} m" in printed
    assert "jump 2, take-off at 2.000 s" in printed
    assert topics.TRUTH_TETHER in printed
    assert "position is nan" in printed


@pytest.mark.parametrize("option", ["--json", "--html"])
def test_printing_one_format_writes_no_files(bag: Path, capsys: Any, option: str):
    before = sorted(bag.parent.iterdir())
    assert main(["bag", "report", str(bag), option]) == 0
    printed = capsys.readouterr().out
    if option == "--json":
        assert json.loads(printed)["jump_height_m"] == pytest.approx(Parabola().height)
    else:
        assert printed.startswith("<!DOCTYPE html>")
    assert sorted(bag.parent.iterdir()) == before


def test_a_closed_pipe_does_not_stop_the_report_from_being_written(bag: Path, tmp_path: Path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "rover_cli",
        "bag",
        "report",
        str(bag),
        "--quiet",
        "--out",
        str(out),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert process.returncode == report.ReportExitCode.OK, errors
    assert "Error" not in errors
    assert (out / "report.html").exists()


def test_a_bag_without_a_jump_makes_a_report(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola(take_off=99.0)], until=1.0)
    path = made.write(tmp_path / "bag")
    assert main(["bag", "report", str(path)]) == 0
    folder = tmp_path / "bag_report"
    assert json.loads((folder / "metrics.json").read_text())["jump_height_m"] is None
    assert "No jump in this bag" in (folder / "report.html").read_text()
    assert (folder / "animation.gif").exists()


def test_a_folder_holds_the_report_of_its_last_bag(tmp_path: Path):
    folder = tmp_path / "report"
    for name, until in (("jump", 3.0), ("rest", 1.0)):
        made = MadeUp()
        made.jumps([Parabola()], until=until)
        path = made.write(tmp_path / name)
        assert main(["bag", "report", str(path), "--out", str(folder), "--quiet"]) == 0
        (folder / "own.svg").touch()
        listed = set(json.loads((folder / "metrics.json").read_text())["files"])
        assert {file.name for file in folder.iterdir()} == {*listed, "own.svg"}
        assert ("height.svg" in listed) == (name == "jump")


@pytest.mark.parametrize(
    ("command", "folder"),
    [("report .", "report"), ("compare . .", "comparison"), ("export . --format csv", "export")],
)
def test_a_bag_may_be_the_current_folder(
    command: str, folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    made = MadeUp()
    made.jumps([Parabola(take_off=99.0)], until=1.0)
    monkeypatch.chdir(made.write(tmp_path / "bag"))
    assert main(["bag", *command.split(), "--quiet"]) == 0
    assert (tmp_path / f"bag_{folder}").is_dir()


def test_an_almost_empty_bag_makes_a_report(tmp_path: Path):
    made = MadeUp()
    made.refusal(0.1, topics.JUMP_REQUEST, "position is nan")
    assert (
        main(["bag", "report", str(made.write(tmp_path / "bag")), "--out", str(tmp_path / "out")])
        == 0
    )
    assert not (tmp_path / "out" / "animation.gif").exists()


def test_refused_bags_and_unwritable_folders_have_exit_codes(
    tmp_path: Path, bag: Path, capsys: Any
):
    assert main(["bag", "report", str(tmp_path / "none")]) == report.ReportExitCode.REFUSED
    assert "there is no bag" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    code = main(["bag", "report", str(bag), "--out", str(tmp_path / "file" / "out")])
    assert code == report.ReportExitCode.NOT_WRITTEN


def test_non_finite_numbers_become_null():
    assert summary.finite({"a": [math.nan, 1.0], "b": math.inf}) == {"a": [None, 1.0], "b": None}


def test_the_scene_contains_all_bodies(bag: Path):
    read = read_bag(bag)
    scene = scene_of(read, measure(read).jumps[0])
    assert scene is not None
    for points in (scene.body1, scene.body2, scene.tether.reshape(-1, 5)):
        assert (points[:, 0] >= scene.low[0]).all()
        assert (points[:, 0] <= scene.high[0]).all()
        assert (points[:, 1] >= scene.low[1]).all()
        assert (points[:, 1] <= scene.high[1]).all()


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")

DRIVE = """
<script>
window.onerror = (text) => { document.title = 'broken: ' + text; };
window.addEventListener('load', () => {
  const box = document.querySelector('.player'), pen = box.querySelector('canvas').getContext('2d');
  const look = () => pen.getImageData(0, 0, pen.canvas.width, pen.canvas.height).data;
  const differs = (a, b) => a.some((v, k) => v !== b[k]);
  box.seek(-0.2); const before = look(), text = box.querySelector('output').textContent;
  box.seek(0.2); const after = look();
  const cursor = box.closest('section').querySelector('.cursor');
  document.title = ['moved', differs(before, after), text, cursor.style.display,
                    document.querySelectorAll('.cursor').length].join('|');
});
</script>
"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_player_draws_and_follows_in_a_browser(written: Path, tmp_path: Path):
    assert CHROMIUM is not None
    text = (written / "report.html").read_text().replace("</body>", DRIVE + "</body>")
    (tmp_path / "driven.html").write_text(text)
    run = subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", f"--user-data-dir={tmp_path / 'profile'}",
            "--virtual-time-budget=5000", "--dump-dom", f"file://{tmp_path / 'driven.html'}",
        ],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    title = re.search(r"<title>(.*?)</title>", run.stdout)
    assert title is not None
    word, moved, shown, cursor, cursors = title[1].split("|")
    assert (word, moved, cursor) == ("moved", "true", "block")
    assert shown.startswith("\u22120.200 s")
    assert int(cursors) == 12


FOREIGN = (
    None,
    True,
    "text",
    [1.0, 2.0, "a"],
    [10**400] * 3,
    {"a": 1},
    math.nan,
    math.inf,
    10**400,
)


def foreign(value: object) -> dict[str, Any]:
    """A configuration with a value that no scenario has."""
    rover = dict.fromkeys(
        ("m1", "m2", "inertia1", "body1_size", "body2_size", "body1_centre"), value
    )
    inner = {"inertia": value, "wheel_inertia": value, "momentum_limit": value, "radius": value}
    parts = dict.fromkeys(("jump_drive", "wheel_drive", "wheels"), inner)
    tether = {"length": value, "line_density": value}
    scenario = {"name": value, "gravity": value, "tether": tether, "rover": rover | parts}
    return {"node": "/sim_node", "seed": 7, "scenario": scenario}


@pytest.mark.parametrize("value", FOREIGN, ids=lambda value: str(value)[:20])
def test_a_scenario_with_foreign_values_is_reported(tmp_path: Path, value: object):
    bags: list[Path] = []
    jumps, spatial = MadeUp(), mission(legs=SHORT)
    jumps.jumps([Parabola()], until=1.8, rate=20, without=[topics.CONFIG])
    spatial.rows = [row for row in spatial.rows if row[1] != topics.CONFIG]
    for made, environment in ((jumps, {}), (spatial, {"environment": {"gravity": value}})):
        content = foreign(value)
        content["scenario"] |= environment
        made.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))
        bags.append(made.write(tmp_path / str(len(bags))))
        bag = read_bag(bags[-1])
        json.dumps(summary.as_mapping(bag, measure(bag)), allow_nan=False)
        for scene in (scene_of(bag, None), spatial_scene(bag)):
            assert scene is None or json.dumps(scene.to_mapping(), allow_nan=False)
    json.dumps(compare(bags).to_mapping(), allow_nan=False)


def test_a_single_jump_has_its_heading(tmp_path: Path):
    made = MadeUp()
    made.jumps([Parabola()], until=1.8, rate=50)
    found = read_bag(made.write(tmp_path / "bag"))
    nothing = Drawings(scenes=(None,), plots=((),), run=None, overall=(), recording=())
    assert "<h2>Jump</h2>" in as_page(found, measure(found), nothing)


def test_half_a_character_of_a_configuration_is_replaced(tmp_path: Path):
    made = MadeUp()
    text = '{"node": "/sim_node", "scenario": {"name": "pit \\ud800", "\\ud800": 1}}'
    made.add(0.0, topics.CONFIG, TextSample(text))
    bag = read_bag(made.write(tmp_path / "bag"))
    assert bag.scenario == {"name": "pit ?", "?": 1}
