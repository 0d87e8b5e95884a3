"""`mother_rover picture`: a bag as an animated picture in three dimensions.

Left the pit, cut open, with the tether coloured by its tension; right the rover as its description
draws it. Pit, rover and motion are those of the bag.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, ImageDraw

from msg_schemas import machine, topics
from msg_schemas.samples import TETHER_COLUMNS, Shape
from rover_bags.analysis.geometry import rotations
from rover_bags.analysis.timeline import Activity, Timeline, timeline_of
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_bags.reading.read import Bag, TimeSeries, read_bag, received_messages
from rover_bags.views.animation import (
    element_curve,
    tension_colour,
    tension_colours,
    tension_scale_max,
)
from rover_bags.views.gif import save_gif
from rover_bags.views.perspective import Array, Camera, Painting, Rgb, as_rgb, sphere
from rover_bags.views.urdf import Part, read_robot

_SIZE: Final = (300, 420)
"""Size of the left view [pixel]."""
_CLOSE: Final = (420, 420)
_SKY: Final = (12, 13, 18)
_TEXT: Final = (235, 235, 235)
_ROVER: Final = (0.95, 0.55, 0.25)
_FRAME_TIME: Final = 90  # [ms]
_LAST_TIME: Final = 1500
_MOST: Final = 260  # frames
# Frames per simulated second of each activity.
_PACE: Final = {
    Activity.HANGING: 0.15, Activity.DESCENDING: 0.22, Activity.ASCENDING: 0.06,
    Activity.STANDING: 0.10, Activity.SLACK: 0.15, Activity.DRIVING: 1.5, Activity.TURNING: 1.2,
    Activity.COMPRESSING: 1.0, Activity.FLIGHT: 24.0,
}  # fmt: skip
_CURVE: Final = 4  # points of a tether element
_FAR: Final = 60.0  # distance up to which the ground is drawn behind the rover [m]


@dataclass(frozen=True)
class _Tether:
    points: Array  # (N, 3) [m]
    colours: Array  # (N - 1, 3)


class PitScene:
    """Pit, rover and tether of a bag.

    Args:
        bag: with the topics of `TOPICS`.
        place: shapes of pit and floor.

    Raises:
        ValueError: the bag lacks what is drawn.
    """

    TOPICS = (
        topics.TRUTH_BODY1, topics.TRUTH_BODY2, topics.TRUTH_TETHER, topics.WHEEL_STATE,
        topics.ROBOT_DESCRIPTION,
    )  # fmt: skip

    def __init__(self, bag: Bag, place: tuple[Shape, ...]) -> None:
        found = {name: bag.series(name) for name in self.TOPICS}
        missing = [name for name, series in found.items() if series is None]
        if missing or not place:
            names = ", ".join(missing or [topics.PLACE])
            raise ValueError(f"the bag {bag.path.name} has no {names}: nothing can be drawn")
        if not any(shape.namespace == "wall" for shape in place):
            raise ValueError(
                f"the bag {bag.path.name} has no pit to draw; give one of a run in a hole, such as "
                "out/demo/bag"
            )
        self._series: dict[str, TimeSeries] = {n: s for n, s in found.items() if s is not None}
        self._turned = {
            name: rotations(self._series[name]) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2)
        }
        robot = read_robot(self._series[topics.ROBOT_DESCRIPTION].texts[-1])
        self._parts, self._joints = robot.parts, robot.joints
        self._ground = _triangles(place, "floor")
        self._wall = _triangles(place, "wall")
        self._boulders = [shape for shape in place if shape.kind == "sphere"]
        shapes = self._series[topics.TRUTH_TETHER].shapes
        tensions = [float(each[:, -1].max()) for each in shapes[:: max(1, len(shapes) // 500)]]
        self._tension_max = tension_scale_max(np.array(tensions)[:, None])
        points = np.concatenate([self._wall, self._ground]).reshape(-1, 3)
        self._middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        self._span = float(np.ptp(points[:, 2]))

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return float(self._series[topics.TRUTH_BODY1].time[-1])

    def colours(self) -> list[Rgb]:
        """Colours of small things."""
        parts = [as_rgb(share * np.array(p.colour)) for p in self._parts for share in (0.7, 1.0)]
        return [*tension_colours(), *parts, as_rgb(np.array(_ROVER)), _TEXT]

    def frame(self, time: float, caption: str) -> Image.Image:
        """Draw both views at a simulated time [s]."""
        body, _ = self._pose(topics.TRUTH_BODY1, time)
        tether = self._tether(time)
        made = Image.new("RGB", (_SIZE[0] + _CLOSE[0], _SIZE[1]), _SKY)
        made.paste(self._whole(body, tether), (0, 0))
        made.paste(self._close(time, body, tether), (_SIZE[0], 0))
        draw = ImageDraw.Draw(made)
        draw.line([(_SIZE[0], 0), (_SIZE[0], _SIZE[1])], fill=(70, 72, 80), width=1)
        words = f"{caption}   {time:.0f} s   {-float(body[2]):.1f} m deep"
        draw.text((_SIZE[0] + 12, _SIZE[1] - 22), words, fill=_TEXT)
        return made

    def _whole(self, body: Array, tether: _Tether) -> Image.Image:
        """The pit, cut open along its axis, seen from the side."""
        centre = np.array([0.45 * self._middle[0], 0.0, self._middle[2]])
        eye = centre + np.array([0.0, -2.6 * self._span, 0.35 * self._span])
        painting = Painting(Camera(eye, centre, math.radians(30.0)), _SIZE, _SKY)
        behind = self._wall[self._wall[:, :, 1].mean(axis=1) > 0.0]
        painting.polygons(behind, (0.62, 0.58, 0.54))
        floor = self._ground[self._ground[:, :, 1].mean(axis=1) > -2.0]
        painting.polygons(floor, (0.50, 0.48, 0.46))
        painting.line(tether.points, tether.colours, 2)
        painting.disc(body, 4, _ROVER)
        return painting.image()

    def _close(self, time: float, body: Array, tether: _Tether) -> Image.Image:
        """The rover, followed from its side."""
        eye = body + np.array([0.75, -1.75, 0.65])
        target = body + np.array([0.0, 0.0, 0.12])
        painting = Painting(Camera(eye, target, math.radians(42.0)), _CLOSE, _SKY)
        for surface, colour in (
            (self._ground, (0.55, 0.53, 0.50)),
            (self._wall, (0.6, 0.56, 0.52)),
        ):
            away = np.linalg.norm(surface.mean(axis=1) - body, axis=1)
            painting.polygons(surface[away < _FAR], colour)
        for shape in self._boulders:
            if math.dist(shape.position, body) < 0.3 * _FAR:
                for faces in sphere(0.5 * shape.size[0]):
                    placed = faces + np.array(shape.position)
                    above = placed[:, :, 2].max(axis=1) > self._floor_at(shape)
                    painting.polygons(placed[above], (0.42, 0.40, 0.38))
        painting.line(tether.points, tether.colours, 2)
        for part in self._parts:
            pose = self._link(part, time)
            if pose is not None:
                place, turned = pose
                for faces in part.faces:
                    painting.polygons(faces @ turned.T + place, part.colour)
        return painting.image()

    def _floor_at(self, shape: Shape) -> float:
        near = np.abs(self._ground[:, :, :2].mean(axis=1) - shape.position[:2]).max(axis=1)
        return float(self._ground[int(np.argmin(near)), :, 2].min())

    def _link(self, part: Part, time: float) -> tuple[Array, Array] | None:
        """Place [m] and rotation of a part's link; None = it belongs to no body."""
        for frame, name in (
            (machine.BODY1_FRAME, topics.TRUTH_BODY1),
            (machine.BODY2_FRAME, topics.TRUTH_BODY2),
        ):
            if part.link == frame:
                return self._pose(name, time)
        joint = self._joints.get(part.link)
        if part.link not in (machine.WHEEL_LEFT, machine.WHEEL_RIGHT) or joint is None:
            return None
        place, turned = self._pose(topics.TRUTH_BODY1, time)
        angle = self._at(topics.WHEEL_STATE, time, f"{part.link}.position")
        return place + turned @ joint.place, turned @ joint.rotation @ _about(joint.axis, angle)

    def _pose(self, name: str, time: float) -> tuple[Array, Array]:
        series = self._series[name]
        row = _row(series, time)
        place = np.array([series.columns[f"position.{axis}"][row] for axis in "xyz"])
        return place, self._turned[name][row]

    def _at(self, name: str, time: float, path: str) -> float:
        series = self._series[name]
        return float(series.columns[path][_row(series, time)])

    def _tether(self, time: float) -> _Tether:
        series = self._series[topics.TRUTH_TETHER]
        table = dict(zip(TETHER_COLUMNS, series.shapes[_row(series, time)].T, strict=True))
        nodes = np.stack([table[name] for name in ("x", "y", "z")], axis=1)
        slopes = np.stack([table[name] for name in ("tx", "ty", "tz")], axis=1)
        points, tension = [nodes[:1]], []
        for k in range(len(nodes) - 1):
            length = float(np.linalg.norm(nodes[k + 1] - nodes[k]))
            ends = [np.stack([nodes[i], slopes[i]]) for i in (k, k + 1)]
            points.append(element_curve(ends[0], ends[1], length, _CURVE)[1:])
            tension += [0.5 * (table["tension"][k] + table["tension"][k + 1])] * _CURVE
        line = np.concatenate(points)
        colours = [np.array(tension_colour(each, self._tension_max)) / 255.0 for each in tension]
        return _Tether(line, np.array(colours))


def _about(axis: Array, angle: float) -> Array:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew
    return turned


def _row(series: TimeSeries, time: float) -> int:
    return min(int(np.searchsorted(series.time, time)), len(series) - 1)


def _triangles(place: tuple[Shape, ...], namespace: str) -> Array:
    """Triangles of the shapes of a namespace, (K, 3, 3) [m]."""
    points = [
        np.array(shape.points).reshape(-1, 3, 3)
        for shape in place
        if shape.namespace == namespace and shape.kind == "triangles"
    ]
    return np.concatenate(points) if points else np.zeros((0, 3, 3))


def times_of(timeline: Timeline, end: float) -> list[tuple[float, str]]:
    """Times of the frames [s] and their captions: more where more happens."""
    found = []
    for interval in timeline.intervals:
        duration = interval.end_s - interval.begin_s
        count = max(1, round(duration * _PACE[interval.activity]))
        at = interval.begin_s + duration * (np.arange(count) + 0.5) / count
        found += [(float(time), interval.activity.value) for time in at]
    found = found[:: max(1, math.ceil(len(found) / _MOST))]
    return [*found, (end, found[-1][1])] if found else [(end, "")]


def write_picture(
    bag_path: Path, picture: Path, progress: Any = iter, *, namespace: str | None = None
) -> int:
    """Write the animated picture of a bag; returns the number of frames.

    Args:
        bag_path: the bag.
        picture: file to write, .gif; with another suffix the middle of the animation.
        progress: wraps the frames' times.
        namespace: of the rover, if the bag holds several.

    Raises:
        BagError: the bag cannot be read.
        ValueError: it lacks what is drawn.
    """
    bag = read_bag(bag_path, namespace=namespace)
    bag = bag.run_at(bag.start_ns)  # a reset repeats times
    scene = PitScene(bag, _place_of(bag))
    times = times_of(timeline_of(bag), scene.end)
    if picture.suffix != ".gif":
        times = times[len(times) // 2 : len(times) // 2 + 1]
    frames = [scene.frame(*each) for each in progress(times)]
    if len(frames) == 1:
        frames[0].save(picture)
        return 1
    save_gif(picture, frames, scene.colours(), _FRAME_TIME, _LAST_TIME)
    return len(frames)


def _place_of(bag: Bag) -> tuple[Shape, ...]:
    for received in received_messages(BagScan(bag.path), {topics.PLACE}, namespace=bag.namespace):
        shapes: tuple[Shape, ...] = received.sample.shapes
        return shapes
    return ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Draw a bag of the simulator as an animated picture in three dimensions: the pit cut open, "
        "the tether coloured by its tension, and the rover."
    )
    parser.add_argument("bag", type=Path, help="bag of a run in a hole, such as out/demo/bag")
    parser.add_argument("picture", type=Path, help="file to write: .gif, or .png for one image")
    parser.add_argument("--namespace", metavar="NS", help="of the rover, if the bag holds several")


def run(options: argparse.Namespace) -> int:
    """Write the picture."""
    from tqdm import tqdm  # noqa: PLC0415 - not needed for --help

    def progress(times: list[tuple[float, str]]) -> Any:
        return tqdm(times, unit="frame", leave=False, disable=not sys.stderr.isatty())

    try:
        count = write_picture(options.bag, options.picture, progress, namespace=options.namespace)
    except (BagError, ValueError) as error:
        print(f"mother_rover picture: {error}", file=sys.stderr)
        return 2
    size = options.picture.stat().st_size
    print(f"wrote {options.picture}: {count} frames, {size / 1e6:.1f} MB")
    return 0
