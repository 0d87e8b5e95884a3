"""view_node as a process: the frames on tf and tf_static, drawn as a tree, with each plant."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from driving import ON_MOCK_PLANT

from msg_schemas import machine, topics
from msg_schemas.samples import PoseEstimateSample
from rover_runtime.component import ShutdownRequested
from rover_runtime.ros import interface_packages
from rover_runtime.ros.interface_packages import InterfacesMissing, load_interfaces
from rover_verify.harness.launching import CLOCK_REMAP

if TYPE_CHECKING:
    from pathlib import Path

    from rover_verify.harness import NodeHarness, Observer

pytestmark = [pytest.mark.ros, pytest.mark.process]

VIEW = "rover_view.view_node"
FLOOR = {
    "scenario": "floor_rubble",
    "overrides": '{"tether.length": 6.0, "start.position": [3.0, 0.0]}',
}
OF_BASE = {
    *("body2", "wheel_left", "wheel_right"),
    *("imu", "camera", "tether_attachment", "contact_switches"),
}


class Frames:
    """The frames of a namespace, as a listener of tf2 keeps them."""

    def __init__(self, observer: Observer) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.observer = observer
        self.of: dict[str, Any] = {}
        self._lock = threading.Lock()
        kind = load_interfaces("tf2_msgs", "msg", print).TFMessage
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        observer.node.create_subscription(kind, "tf", self._on_message, 100)
        observer.node.create_subscription(kind, "tf_static", self._on_message, latched)

    def _on_message(self, message: Any) -> None:
        with self._lock:
            for each in message.transforms:
                before = self.of.get(each.child_frame_id)
                # A frame has one parent.
                assert before is None or before.header.frame_id == each.header.frame_id
                self.of[each.child_frame_id] = each

    @property
    def children(self) -> dict[str, set[str]]:
        """The frames by their parents."""
        found: dict[str, set[str]] = {}
        with self._lock:
            for child, each in self.of.items():
                found.setdefault(each.header.frame_id, set()).add(child)
        return found

    def wait_for(self, *children: str) -> dict[str, set[str]]:
        """Wait until these frames have arrived; returns the tree."""
        self.observer.wait_until(
            lambda: set(children) <= self.of.keys(), f"no frames {children}: {self.children}"
        )
        return self.children

    def position(self, child: str) -> tuple[float, float, float]:
        """Position in the parent [m]."""
        with self._lock:
            at = self.of[child].transform.translation
        return at.x, at.y, at.z


def test_two_rovers_have_trees_of_their_own_with_estimate_and_truth(harness: NodeHarness):
    for name, begin in (("rover1", 3.0), ("rover2", 1.5)):
        place = FLOOR["overrides"].replace("3.0", str(begin))
        harness.processes.start(
            "rover_sim.node.mock_plant_node",
            {**FLOOR, "overrides": place},
            namespace=name,
            remap=CLOCK_REMAP,
        )
        for module, parameters in (
            (VIEW, {"use_sim_time": True}),
            ("rover_control.drive.drive_node", {"use_sim_time": True, **ON_MOCK_PLANT}),
        ):
            harness.processes.start(module, parameters, namespace=name, remap=CLOCK_REMAP)
    first, second = (Frames(harness.observer(name, CLOCK_REMAP)) for name in ("rover1", "rover2"))
    wheel = "truth/wheel_left"
    for frames in (first, second):
        tree = frames.wait_for(
            *("base_link", "truth/base_link", "truth/imu", wheel, *OF_BASE),
            *("winch_drum", "truth/winch_drum"),
        )
        assert tree["map"] == {
            *("odom", "fairlead", "winch_drum"),
            *("truth/map", "truth/base_link"),
        }
        assert tree["odom"] == {"base_link"}
        assert tree["base_link"] == OF_BASE
        assert tree["truth/base_link"] == {f"truth/{name}" for name in OF_BASE}
        assert tree["truth/map"] == {"truth/fairlead", "truth/winch_drum"}
    assert first.position("truth/base_link")[0] == pytest.approx(3.0, abs=0.05)
    assert second.position("truth/base_link")[0] == pytest.approx(1.5, abs=0.05)
    assert first.position("odom")[:2] == pytest.approx((0.0, 0.0))

    # The pose is corrected in map -> odom; the odometry does not jump.
    observer = first.observer
    observer.wait_until_ready("drive_node")
    given = PoseEstimateSample(0, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    observer.send(topics.DRIVE_START, given)
    observer.wait_until(
        lambda: first.position("odom")[0] == pytest.approx(3.0, abs=0.01), "not corrected"
    )
    assert first.position("base_link") == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert second.position("odom")[:2] == pytest.approx((0.0, 0.0))
    joints = observer.listen(topics.JOINT_STATES).wait().joints
    assert set(joints) == {"wheel_left", "wheel_right", "jump_slider", "winch_drum"}


@pytest.mark.usefixtures("compiled")
def test_the_planar_plant_has_the_frames_of_the_true_bodies(harness: NodeHarness):
    frames = Frames(harness.observer())
    harness.processes.start("rover_sim.node.sim_node", {"scenario": "paper_table1_high"})
    harness.processes.start(VIEW, {"use_sim_time": True})
    tree = frames.wait_for(machine.TRUTH_BODY1_FRAME, machine.TRUTH_BODY2_FRAME)
    assert tree == {
        "map": {"truth/map", machine.TRUTH_BODY1_FRAME},
        machine.TRUTH_BODY1_FRAME: {machine.TRUTH_BODY2_FRAME},
    }


def test_without_a_plant_the_description_is_read_from_a_file(harness: NodeHarness, tmp_path: Path):
    from rover_sim.interface.robot_description import robot_description
    from rover_sim.scenarios.scenario import SpatialScenario, load_overridden

    scenario = load_overridden("marius_hills", "")
    assert isinstance(scenario, SpatialScenario)
    file = tmp_path / "rover.urdf"
    file.write_text(robot_description(scenario))
    frames = Frames(harness.observer())
    harness.processes.start(VIEW, {"description_file": str(file)})
    tree = frames.wait_for("imu", "fairlead")
    assert tree["map"] == {"fairlead"}
    assert frames.observer.listen(topics.ROBOT_DESCRIPTION).wait().text == file.read_text()
    for transition in ("deactivate", "activate", "deactivate", "cleanup", "configure", "activate"):
        assert frames.observer.change_state("view_node", transition)
    published = ("tf", "tf_static", topics.ROBOT_DESCRIPTION)
    frames.observer.wait_until(
        lambda: [frames.observer.node.count_publishers(name) for name in published] == [1, 1, 1],
        "topics of the former activation are still open",
    )
    file.write_text("no URDF")
    os.mkfifo(tmp_path / "fifo")
    for name, complaint in (
        (str(file), "the robot description is not a URDF"),
        (str(tmp_path / "fifo"), "fifo: it is no regular file"),
    ):
        ended = harness.processes.start(VIEW, {"description_file": name})
        assert ended.wait() == 2
        assert complaint in ended.output


def test_without_a_compiler_it_reports_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr("shutil.which", lambda _name: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(interface_packages, "SOURCES", tmp_path)
    (tmp_path / "no_msgs").mkdir()
    with pytest.raises(InterfacesMissing, match=r"no_msgs cannot be built.*install gcc and g\+\+"):
        load_interfaces("no_msgs", "msg", print)


def test_a_cache_that_cannot_be_written_is_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    (tmp_path / "no_msgs").mkdir()
    monkeypatch.setattr(interface_packages, "SOURCES", tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: name)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nocache")
    with pytest.raises(InterfacesMissing, match=r"no_msgs cannot be built: .*/proc/nocache"):
        load_interfaces("no_msgs", "msg", print)


def test_a_shutdown_ends_the_building_of_messages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    shutil.copytree(interface_packages.SOURCES / "tf2_msgs", tmp_path / "late_msgs")
    monkeypatch.setattr(interface_packages, "SOURCES", tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: Any, **options: Any) -> subprocess.Popen[str]:
        started.append(subprocess.Popen(*arguments, **options))
        return started[-1]

    def check() -> None:
        if started:
            raise ShutdownRequested

    stand_in = SimpleNamespace(**{**vars(subprocess), "Popen": start})
    monkeypatch.setattr(interface_packages, "subprocess", stand_in)
    try:
        with pytest.raises(ShutdownRequested):
            load_interfaces("late_msgs", "msg", print, check)
    except InterfacesMissing as error:
        pytest.skip(str(error))
    (child,) = started
    assert child.returncode == -signal.SIGKILL
    assert [each.suffix for each in (tmp_path / "cache" / "mother_rover").iterdir()] == [".lock"]
