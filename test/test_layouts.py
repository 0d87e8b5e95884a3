"""Layouts for RViz, PlotJuggler and Foxglove: of their formats, and of the contract's topics."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from msg_schemas import machine, topics
from msg_schemas.qos import describe
from msg_schemas.specifications import UNUSED, Topic
from msg_schemas.table import TOPICS

CONFIG = Path(__file__).parents[1] / "config"
PARTS = ("position", "velocity", "effort")

# What each of RViz's displays shows.
RVIZ_DISPLAYS = {
    "Grid": None,
    "TF": None,
    "RobotModel": "std_msgs/msg/String",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "Odometry": "nav_msgs/msg/Odometry",
}
RVIZ_QOS = {"Value", "Depth", "History Policy", "Reliability Policy", "Durability Policy"}
FOXGLOVE_PANELS = {"3D", "Plot", "DiagnosticSummary", "RawMessages"}


def row_of(path: str) -> tuple[Topic, str]:
    """The topic that a path of a layout begins with, and what comes behind."""
    text = path.removeprefix("/")
    (name,) = [n for n in TOPICS if text == n or text.startswith((f"{n}/", f"{n}."))]
    return TOPICS[name], text[len(name) + 1 :]


def must_be_used(row: Topic, joint: str, part: str) -> None:
    """Whether a plotted number of a joint says anything."""
    assert joint in (*row.joints, *row.optional_joints)
    assert part in PARTS
    assert row.by_path[f"{joint}.{part}"].about != UNUSED[1], (row.name, joint, part)


def must_be_a_number(row: Topic, path: str) -> None:
    """Whether a field path of a message of sensors leads to a number of the contract's row."""
    found = path.removeprefix("wrench.").removeprefix("wrench/").replace("/", ".")
    assert found in row.by_path, (row.name, path)


# ------------------------------------------------------------------------------------------- RViz


def rviz() -> dict[str, Any]:
    content = yaml.safe_load((CONFIG / "mother_rover.rviz").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


RVIZ_TOOLS = {
    "SetInitialPose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "SetGoal": "geometry_msgs/msg/PoseStamped",
}
"""What these tools publish."""


def rviz_topics() -> Iterator[tuple[str, dict[str, Any]]]:
    for display in rviz()["Visualization Manager"]["Displays"]:
        for key in ("Topic", "Description Topic"):
            if key in display:
                yield display["Class"].partition("/")[2], display[key]


def test_rviz_s_displays_are_of_classes_that_it_has():
    manager = rviz()["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == machine.WORLD_FRAME
    assert manager["Views"]["Current"]["Class"].startswith("rviz_default_plugins/")
    for display in manager["Displays"]:
        library, _, name = display["Class"].partition("/")
        assert library == "rviz_default_plugins"
        assert name in RVIZ_DISPLAYS
        assert display["Name"]
        assert isinstance(display["Enabled"], bool)
    assert all(panel["Class"].startswith("rviz_common/") for panel in rviz()["Panels"])


def test_rviz_s_topics_are_the_contract_s_with_their_types():
    for name, topic in rviz_topics():
        # Relative, so that it shows the rover of the namespace that it runs in.
        assert TOPICS[topic["Value"]].message == RVIZ_DISPLAYS[name]
    shown = {topic["Value"] for _, topic in rviz_topics()}
    types = {name: row.message for name, row in TOPICS.items()}
    assert {name for name in types if types[name] == RVIZ_DISPLAYS["MarkerArray"]} <= shown


def test_rviz_s_tools_set_the_pose_and_the_goal():
    tools = {each["Class"]: each for each in rviz()["Visualization Manager"]["Tools"]}
    for name, topic in (("SetInitialPose", topics.DRIVE_START), ("SetGoal", topics.DRIVE_GOAL)):
        given = tools[f"rviz_default_plugins/{name}"]["Topic"]
        assert (given["Value"], given["Durability Policy"]) == (topic, "Volatile")
        assert TOPICS[topic].message == RVIZ_TOOLS[name]


def test_rviz_receives_latched_messages_published_before_it_started():
    for _, topic in rviz_topics():
        assert topic.keys() == RVIZ_QOS
        durability = topic["Durability Policy"].lower()
        assert durability in describe(TOPICS[topic["Value"]].intent)


# ------------------------------------------------------------------------------------- PlotJuggler


def plotjuggler() -> ET.Element:
    return ET.parse(CONFIG / "plotjuggler.xml").getroot()


def test_plotjuggler_s_layout_has_its_parts():
    root = plotjuggler()
    assert root.tag == "root"
    (window,) = root.findall("tabbed_widget")
    assert window.get("parent") == "main_window"
    tabs = window.findall("Tab")
    assert tabs
    index = window.find("currentTabIndex")
    assert index is not None
    assert 0 <= int(index.get("index", "-1")) < len(tabs)
    for tab in tabs:
        assert tab.get("tab_name")
        assert len(tab.findall("Container")) == int(tab.get("containers", "0"))
    for splitter in root.iter("DockSplitter"):
        areas = splitter.findall("DockArea")
        assert splitter.get("orientation") in {"-", "|"}
        assert int(splitter.get("count", "0")) == len(areas)
        sizes = [float(size) for size in splitter.get("sizes", "").split(";")]
        assert len(sizes) == len(areas)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)
        assert all(len(area.findall("plot")) == 1 for area in areas)
    for plot in root.iter("plot"):
        assert plot.get("mode") == "TimeSeries"
        (edges,) = plot.findall("range")
        assert {*edges.keys()} == {"left", "right", "top", "bottom"}
        assert plot.findall("curve")
    for curve in root.iter("curve"):
        assert re.fullmatch("#[0-9a-f]{6}", curve.get("color", ""))


def test_plotjuggler_s_curves_are_numbers_of_the_contract_that_it_listens_to():
    root = plotjuggler()
    listened = {row_of(each.get("name", ""))[0].name for each in root.iter("topic")}
    plotted = set()
    for curve in root.iter("curve"):
        row, rest = row_of(curve.get("name", ""))
        plotted.add(row.name)
        if row.joints:
            joint, _, part = rest.partition("/")
            must_be_used(row, joint, part)
        else:
            must_be_a_number(row, rest)
    assert plotted == listened


# ---------------------------------------------------------------------------------------- Foxglove


def foxglove() -> dict[str, Any]:
    content = json.loads((CONFIG / "foxglove.json").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


def leaves(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
        return
    assert layout.keys() <= {"direction", "first", "second", "splitPercentage"}
    assert layout["direction"] in {"row", "column"}
    assert 0 < layout.get("splitPercentage", 50) < 100
    yield from leaves(layout["first"])
    yield from leaves(layout["second"])


def test_foxglove_s_panels_are_laid_out_once_each():
    content = foxglove()
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} <= {*content}
    laid_out = list(leaves(content["layout"]))
    assert sorted(laid_out) == sorted(content["configById"])
    assert {name.partition("!")[0] for name in laid_out} <= FOXGLOVE_PANELS
    assert all(name.partition("!")[2] for name in laid_out)


def test_foxglove_s_topics_are_the_contract_s():
    for name, panel in foxglove()["configById"].items():
        kind = name.partition("!")[0]
        if kind == "3D":
            layers = [layer["topic"] for layer in panel["layers"].values()]
            assert panel["topics"]
            assert all(row_of(topic)[1] == "" for topic in [*panel["topics"], *layers])
        elif kind == "DiagnosticSummary":
            row, _ = row_of(panel["topicToRender"])
            assert row.message == "diagnostic_msgs/msg/DiagnosticArray"
        elif kind == "RawMessages":
            assert row_of(panel["topicPath"])[1] == ""


def test_foxglove_s_plots_are_numbers_of_the_contract():
    plots = [c for n, c in foxglove()["configById"].items() if n.startswith("Plot!")]
    assert plots
    for path in (path for plot in plots for path in plot["paths"]):
        row, rest = row_of(path["value"])
        if row.joints:
            match = re.fullmatch(r"(\w+)\[(\d+)\]", rest)
            assert match
            joint = row.joints[int(match[2])]
            assert path["label"] == joint
            must_be_used(row, joint, match[1])
        else:
            must_be_a_number(row, rest)
