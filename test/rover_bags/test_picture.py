"""A bag as an animated picture in three dimensions."""

from pathlib import Path

import pytest
from contract_bag import MadeUp, Parabola
from PIL import Image, ImageSequence

from msg_schemas import machine, topics
from msg_schemas.samples import DrawingSample, JointSample, JointValue, TextSample
from rover_bags.analysis.timeline import Activity, ActivityInterval, Timeline
from rover_bags.views.picture import times_of, write_picture
from rover_cli.command_line import main
from rover_sim import load_spatial
from rover_sim.interface import drawing
from rover_sim.interface.robot_description import robot_description

MARIUS = load_spatial("marius_hills")


@pytest.fixture(scope="module")
def made() -> MadeUp:
    bag = MadeUp()
    bag.jumps([Parabola()], until=3.0, rate=50.0)
    shapes = drawing.ground(MARIUS.environment.build())
    bag.add(0.0, topics.PLACE, DrawingSample(0, shapes))
    bag.add(0.0, topics.ROBOT_DESCRIPTION, TextSample(robot_description(MARIUS)))
    for count in range(30):
        turned = {
            name: JointValue(0.1 * count) for name in (machine.WHEEL_LEFT, machine.WHEEL_RIGHT)
        }
        sample = JointSample(count * 100_000_000, turned)
        bag.add(0.1 * count, topics.WHEEL_STATE, sample)
    return bag


def test_a_bag_becomes_an_animation(made: MadeUp, tmp_path: Path):
    made.write(tmp_path / "bag")
    assert main(["picture", str(tmp_path / "bag"), str(tmp_path / "run.gif")]) == 0
    with Image.open(tmp_path / "run.gif") as image:
        frames = [each.convert("RGB") for each in ImageSequence.Iterator(image)]
    assert len(frames) > 10
    first, later = frames[0], frames[len(frames) // 2]
    assert first.size == later.size
    assert first.tobytes() != later.tobytes()
    assert len(first.getcolors() or ()) > 20


def test_one_image_is_the_middle_of_the_animation(made: MadeUp, tmp_path: Path):
    made.write(tmp_path / "bag")
    assert write_picture(tmp_path / "bag", tmp_path / "run.png") == 1
    with Image.open(tmp_path / "run.png") as image:
        assert image.size == (720, 420)


def test_another_namespace_is_refused(
    made: MadeUp, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    made.write(tmp_path / "bag", prefix="/rover1/")
    given = ["picture", str(tmp_path / "bag"), str(tmp_path / "run.png"), "--namespace"]
    assert main([*given, "/rover2"]) == 2
    assert "no topic in the namespace '/rover2'" in capsys.readouterr().err
    assert main([*given, "/rover1"]) == 0


def test_a_bag_without_a_rover_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    poor = MadeUp()
    poor.jumps([Parabola()], until=2.0)
    poor.write(tmp_path / "bag")
    assert main(["picture", str(tmp_path / "bag"), str(tmp_path / "run.gif")]) == 2
    assert f"the bag bag has no {topics.WHEEL_STATE}, " in capsys.readouterr().err
    assert main(["picture", str(tmp_path / "none"), str(tmp_path / "run.gif")]) == 2
    assert not (tmp_path / "run.gif").exists()


def test_a_bag_without_a_pit_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scenario = load_spatial("floor_rubble")
    flat = MadeUp()
    flat.jumps([Parabola()], until=2.0)
    flat.add(0.0, topics.PLACE, DrawingSample(0, drawing.ground(scenario.environment.build())))
    flat.add(0.0, topics.ROBOT_DESCRIPTION, TextSample(robot_description(scenario)))
    turned = {name: JointValue(0.1) for name in (machine.WHEEL_LEFT, machine.WHEEL_RIGHT)}
    flat.add(0.1, topics.WHEEL_STATE, JointSample(0, turned))
    flat.write(tmp_path / "bag")
    assert main(["picture", str(tmp_path / "bag"), str(tmp_path / "run.gif")]) == 2
    assert "the bag bag has no pit to draw" in capsys.readouterr().err
    assert not (tmp_path / "run.gif").exists()


def test_more_frames_show_what_happens_fast():
    timeline = Timeline(
        (
            ActivityInterval(Activity.DESCENDING, 0.0, 100.0, 0, 0),
            ActivityInterval(Activity.FLIGHT, 100.0, 101.0, 0, 0),
        )
    )
    times = times_of(timeline, 101.0)
    in_flight = [time for time, caption in times if caption == Activity.FLIGHT and time < 101.0]
    assert len(in_flight) >= len(times) / 2
    assert times == sorted(times)
    assert times[-1] == (101.0, Activity.FLIGHT)
