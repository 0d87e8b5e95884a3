"""Animations of rover and tether: frames for the page's player, and a GIF.

Side view in the plane of x (forward) and z (up), equal scales, metres.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from msg_schemas import topics
from msg_schemas.samples import TETHER_COLUMNS
from rover_bags.analysis.geometry import number_setting, vector_setting
from rover_bags.analysis.jumps import JumpWindow, MotionSeries, RecordedJump, motion
from rover_bags.reading.read import Bag, Floats
from rover_bags.views.gif import save_gif

LEAD: Final = 0.25
"""Simulated time [s] shown before take-off."""
TRAIL: Final = 0.45
"""Simulated time [s] shown after touchdown."""
_MAX_FRAMES: Final = 600
_MAX_GIF_FRAMES: Final = 200
"""Frames of a GIF of a whole run."""
_FINE: Final = 2
"""Supersampling factor of the frames, for smooth edges."""
_SIZES: Final = {"body1_size": (0.30, 0.15), "body2_size": (0.20, 0.10)}
_TENSION: Final = TETHER_COLUMNS.index("tension")
# Positions and slopes in the plane, and the tension.
_SHOWN: Final = [TETHER_COLUMNS.index(name) for name in ("x", "z", "tx", "tz", "tension")]
_LAST_TIME: Final = 1200  # of the last frame of a GIF [ms]
_TEXT: Final = (33, 37, 41)
_BODY1: Final = (0, 114, 178)
_BODY2: Final = (213, 94, 0)
_SCALE_STEPS: Final = 12  # of the tension's colours in a palette
_SCALE: Final = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (230, 190, 30))
"""Colour scale from slack to taut, dark to light, readable for colour-blind readers."""


@dataclass(frozen=True)
class MovingScene:
    """The moving parts of a scene, sampled in time.

    Attributes:
        time: Time of each frame since take-off [s], shape (F,).
        body1, body2: x [m], z [m], theta [rad] of the bodies' centres, shape (F, 3).
        tether: x, z [m], slopes dx/ds, dz/ds [-] and tension [N] by node, shape (F, n + 1, 5).
        element: Length of a tether element [m].
        sizes: Width and height of the bodies [m].
        ground: Height of the lowest point of Body 1 in the first frame [m].
        low, high: Corners (x, z) of the whole view [m].
        close_up: Corners (x, z) of the close-up view [m].
        tension_max: Tension at the end of the colour scale [N]; larger tensions have its colour.
        ground_lines: x and z [m] of ground and walls, (k, 2) each; empty: level ground at `ground`.
        wheels: x and z of the wheels' centres and half their width and height as seen [m], shape
            (F, wheels, 4).
        follow: Half the width of a close-up that follows Body 1 [m]; 0: it is fixed.
        is_run: Whether times are simulated times of a whole run, not times since a take-off.
        readout: Value shown beside the time: rise of Body 1 since take-off, or in a whole run its
            depth below the fairlead [m], shape (F,).
    """

    time: Floats
    body1: Floats
    body2: Floats
    tether: Floats
    element: float
    sizes: Mapping[str, tuple[float, ...]]
    ground: float
    low: tuple[float, float]
    high: tuple[float, float]
    close_up: tuple[tuple[float, float], tuple[float, float]]
    tension_max: float
    readout: Floats
    ground_lines: tuple[Floats, ...] = ()
    wheels: Floats | None = None
    follow: float = 0.0
    is_run: bool = False

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for the player."""
        return {
            "time": np.round(self.time, 5).tolist(),
            "body1": np.round(self.body1, 5).tolist(),
            "body2": np.round(self.body2, 5).tolist(),
            "tether": np.round(self.tether, 4).tolist(),
            "element": self.element,
            "sizes": {name: list(size) for name, size in self.sizes.items()},
            "ground": self.ground,
            "low": list(self.low),
            "high": list(self.high),
            "close_up": [list(corner) for corner in self.close_up],
            "tension_max": self.tension_max,
            "beyond": bool(self.tether[:, :, -1].max() > self.tension_max),
            "scale": [list(colour) for colour in _SCALE],
            "lines": [np.round(line, 3).tolist() for line in self.ground_lines],
            "wheels": None if self.wheels is None else np.round(self.wheels, 4).tolist(),
            "follow": self.follow,
            "run": self.is_run,
            "readout": np.round(self.readout, 5).tolist(),
        }


def scene_of(bag: Bag, jump: RecordedJump | None) -> MovingScene | None:
    """Return the scene of a jump or of a whole run; None if bodies or tether are not recorded."""
    all_series = [
        bag.series(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2, topics.TRUTH_TETHER)
    ]
    if any(series is None for series in all_series):
        return None
    first, second, tether = (series for series in all_series if series is not None)
    if tether.nodes is None:
        return None
    body1, body2 = motion(first), motion(second)
    if jump is None:
        chosen = np.arange(len(tether))
        origin = float(tether.time[0])
    else:
        chosen = shown(body1, jump).indices(tether)
        origin = jump.take_off_s
    chosen = chosen[np.concatenate([[True], np.diff(tether.time[chosen]) > 0.0])]
    chosen = chosen[:: max(1, math.ceil(len(chosen) / _MAX_FRAMES))]
    if len(chosen) < 2:
        return None
    time = tether.time[chosen]
    poses = [_poses(body, time, tether.log_ns[chosen]) for body in (body1, body2)]
    nodes = tether.nodes[chosen][:, :, _SHOWN]
    sizes = {name: vector_setting(bag, 2, "rover", name) or usual for name, usual in _SIZES.items()}
    points = np.concatenate([nodes[:, :, :2].reshape(-1, 2), poses[0][:, :2], poses[1][:, :2]])
    margin = 0.5 * max(sizes["body1_size"]) + 0.15
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    ground = min(z for _, z in _corners(poses[0][0], sizes["body1_size"]))
    return MovingScene(
        time=time - origin,
        body1=poses[0],
        body2=poses[1],
        tether=nodes,
        element=_element(bag, tether.nodes[chosen[0]]),
        sizes=sizes,
        ground=ground,
        low=(float(low[0]), float(min(low[1], ground - 0.1))),
        high=(float(high[0]), float(high[1])),
        close_up=_close_up(poses, ground, margin),
        tension_max=tension_scale_max(nodes[:, :, -1]),
        readout=poses[0][:, 1] - (poses[0][0, 1] if jump is None else jump.start_height_m),
    )


def tension_scale_max(tension: Floats) -> float:
    """Return the end of the colour scale of tensions [N], shape (F, points).

    It is 1.2 times the 90th percentile of the frames' peaks: a single snatch shall not darken the
    rest.
    """
    peaks = tension.max(axis=1)
    usual = 1.2 * float(np.percentile(peaks, 90))
    return max(min(usual, float(peaks.max())), 1e-3)


def _close_up(
    poses: list[Floats], ground: float, margin: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    points = np.concatenate([pose[:, :2] for pose in poses])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return (
        (float(low[0]), float(min(low[1], ground - 0.1))),
        (float(high[0]), float(high[1])),
    )


def shown(body: MotionSeries, jump: RecordedJump) -> JumpWindow:
    """Return the time window that drawings of a jump show."""
    end = jump.take_off_s + jump.flight_time_s
    at = int(np.argmin(np.abs(body.time - jump.take_off_s)))
    window = JumpWindow.of(body, at, at)
    begin, stop = jump.take_off_s - LEAD, end + TRAIL
    span = int((stop - begin) * 60e9)
    return JumpWindow(begin, stop, window.log_begin - span, window.log_end + span)


def _poses(body: MotionSeries, time: Floats, log_ns: NDArray[np.int64]) -> Floats:
    """Pose x, z [m], theta [rad] of a body at given times, by linear interpolation."""
    margin = 2_000_000_000
    near = (body.log_ns >= log_ns[0] - margin) & (body.log_ns <= log_ns[-1] + margin)
    t = body.time[near]
    columns = (body.position[near, 0], body.position[near, 2], body.theta[near])
    return np.stack([np.interp(time, t, column) for column in columns], axis=1)


def _element(bag: Bag, nodes: Floats) -> float:
    length = number_setting(bag, "tether", "length")
    if length is None:
        length = float(np.linalg.norm(np.diff(nodes[:, :3], axis=0), axis=1).sum())
    return length / (len(nodes) - 1)


# --- GIF ----------------------------------------------------------------------------------------


def write_gif(
    scene: MovingScene, path: Path, *, width: int = 640, slower: float = 4.0, rate: float = 20.0
) -> None:
    """Write a GIF.

    Args:
        scene: Scene to show.
        path: File to write.
        width: Width of the image [pixel].
        slower: Factor by which playback is slower than simulated time.
        rate: Frames per second.
    """
    span = float(scene.time[-1] - scene.time[0])
    most = _MAX_GIF_FRAMES if scene.is_run else _MAX_FRAMES
    step = max(1.0 / (rate * slower), span / most)
    times = np.arange(scene.time[0], scene.time[-1] + 0.5 * step, step)
    pace = step * rate
    words = f"{1.0 / pace:.3g} x slower" if pace < 1.0 else f"{pace:.3g} x faster"
    frames = [_frame(scene, float(time), width, words) for time in times]
    save_gif(
        path, frames, [*tension_colours(), _BODY1, _BODY2, _TEXT], round(1000.0 / rate), _LAST_TIME
    )


class _View:
    """Maps metres to pixels of a panel with equal scales."""

    def __init__(
        self,
        low: tuple[float, float],
        high: tuple[float, float],
        panel: tuple[int, int, int, int],
    ) -> None:
        left, top, right, bottom = panel
        self.corner = (left, top)
        self.size = (right - left, bottom - top)
        self.scale = min(self.size[0] / (high[0] - low[0]), self.size[1] / (high[1] - low[1]))
        self._x = 0.5 * self.size[0] - 0.5 * self.scale * (low[0] + high[0])
        self._z = 0.5 * self.size[1] + 0.5 * self.scale * (low[1] + high[1])

    def at(self, x: float, z: float) -> tuple[float, float]:
        return (self._x + self.scale * x, self._z - self.scale * z)


def _frame(scene: MovingScene, time: float, width: int, pace: str) -> Image.Image:
    """One frame: the whole scene on the left, a close-up of the rover on the right."""
    height = round(0.62 * width)
    image = Image.new("RGB", (_FINE * width, _FINE * height), "white")
    draw = ImageDraw.Draw(image)
    poses = [_at(scene, values, time) for values in (scene.body1, scene.body2)]
    tether = _at(scene, scene.tether, time)
    top, bottom = 52 * _FINE, (height - 10) * _FINE
    middle, right = round(0.42 * width) * _FINE, (width - 8) * _FINE
    views = (
        _View(scene.low, scene.high, (8 * _FINE, top, middle, bottom)),
        _View(*_close_up_box(scene, poses[0]), (middle + 10 * _FINE, top, right, bottom)),
    )
    for view in views:
        panel = Image.new("RGB", view.size, "white")
        _draw_scene(ImageDraw.Draw(panel), view, scene, time, poses, tether)
        image.paste(panel, view.corner)
        edge = (*view.corner, view.corner[0] + view.size[0], view.corner[1] + view.size[1])
        draw.rectangle(edge, outline=(206, 212, 218), width=_FINE)
    large, small = (_font(size) for size in (15, 12))
    title = f"{time:.1f} s" if scene.is_run else f"{time:+.2f} s after take-off"
    draw.text((10 * _FINE, 7 * _FINE), title, fill=_TEXT, font=large)
    readout = float(np.interp(time, scene.time, scene.readout))
    place = f"depth {readout:.2f} m" if scene.is_run else f"rise {readout:.3f} m"
    note = f"{place},  tension up to {max(tether[:, -1].max(), 0.0):.1f} N,  {pace}"
    draw.text((10 * _FINE, 29 * _FINE), note, fill=(80, 86, 92), font=small)
    return image.reduce(_FINE)


def _close_up_box(
    scene: MovingScene, pose: Floats
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Corners of the close-up view."""
    half = scene.follow
    if not half:
        return scene.close_up
    x, z = float(pose[0]), float(pose[1])
    return (x - half, z - half), (x + half, z + half)


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size=size * _FINE)


def _draw_scene(
    draw: ImageDraw.ImageDraw,
    view: _View,
    scene: MovingScene,
    time: float,
    poses: list[Floats],
    tether: Floats,
) -> None:
    _draw_ground(draw, view, scene)
    past = scene.body1[scene.time <= time]
    if len(past) > 1:
        draw.line([view.at(x, z) for x, z in past[:, :2]], fill=(150, 160, 170), width=_FINE)
    _draw_tether(draw, view, scene, tether)
    rod = [*poses, tether[-1]] if scene.follow else poses
    draw.line([view.at(*point[:2]) for point in rod], fill=(134, 142, 150), width=4 * _FINE)
    for pose, name, colour in (
        (poses[1], "body2_size", _BODY2),
        (poses[0], "body1_size", _BODY1),
    ):
        corners = [view.at(*corner) for corner in _corners(pose, scene.sizes[name])]
        draw.polygon(corners, fill=colour, outline="white")
    if scene.wheels is not None:
        for x, z, wide, high in _at(scene, scene.wheels, time):
            left, top = view.at(x - wide, z + high)
            right, bottom = view.at(x + wide, z - high)
            draw.ellipse((left, top, right, bottom), outline=_TEXT, width=2 * _FINE)
    x, z = view.at(*tether[0, :2])
    draw.rectangle((x - 6, z - 6, x + 6, z + 6), fill=_TEXT)
    _draw_ruler(draw, view)


def _at(scene: MovingScene, values: Floats, time: float) -> Floats:
    index = int(np.clip(np.searchsorted(scene.time, time) - 1, 0, len(scene.time) - 2))
    share = (time - scene.time[index]) / (scene.time[index + 1] - scene.time[index])
    share = float(np.clip(share, 0.0, 1.0))
    blended: Floats = (1.0 - share) * values[index] + share * values[index + 1]
    return blended


def _corners(pose: Floats, size: tuple[float, ...]) -> list[tuple[float, float]]:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    width = float(pose[3]) if len(pose) > 3 else size[0]
    return [
        (
            pose[0] + c * a * width / 2 - s * b * size[1] / 2,
            pose[1] + s * a * width / 2 + c * b * size[1] / 2,
        )
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]


def _draw_ground(draw: ImageDraw.ImageDraw, view: _View, scene: MovingScene) -> None:
    for line in scene.ground_lines:
        draw.line([view.at(x, z) for x, z in line], fill=(120, 110, 100), width=4)
    if scene.ground_lines:
        return
    # Draw the ground under the rover only: the mother machine stands at another height.
    reach = scene.body1[:, 0]
    left, right = float(reach.min()) - 0.35, float(reach.max()) + 0.35
    top, bottom = view.at(left, scene.ground), view.at(right, scene.ground)
    draw.line([top, bottom], fill=(120, 110, 100), width=4)


def _draw_tether(draw: ImageDraw.ImageDraw, view: _View, scene: MovingScene, nodes: Floats) -> None:
    for left, right in pairwise(nodes):
        curve = element_curve(left[:4].reshape(2, 2), right[:4].reshape(2, 2), scene.element, 8)
        tension = np.linspace(left[4], right[4], len(curve))
        for piece in range(len(curve) - 1):
            colour = tension_colour(float(tension[piece]), scene.tension_max)
            ends = [view.at(*curve[piece]), view.at(*curve[piece + 1])]
            draw.line(ends, fill=colour, width=3 * _FINE)


def element_curve(left: Floats, right: Floats, length: float, pieces: int) -> Floats:
    """Return points on a tether element's Hermite cubic, shape (pieces + 1, D) [m].

    Args:
        left: One end: place [m] and slope along the tether [-], shape (2, D).
        right: The other end.
        length: Length of the element [m].
        pieces: Number of straight pieces.
    """
    s = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    cubic: Floats = (
        (2 * s**3 - 3 * s**2 + 1) * left[0]
        + (s**3 - 2 * s**2 + s) * length * left[1]
        + (3 * s**2 - 2 * s**3) * right[0]
        + (s**3 - s**2) * length * right[1]
    )
    return cubic


def tension_colour(tension: float, tension_max: float) -> tuple[int, int, int]:
    """Return the colour of a tension [N] on the scale of the player."""
    place = min(max(tension / tension_max, 0.0), 1.0) * (len(_SCALE) - 1)
    index = min(int(place), len(_SCALE) - 2)
    share = place - index
    first, second = _SCALE[index], _SCALE[index + 1]
    red, green, blue = (
        round((1 - share) * a + share * b) for a, b in zip(first, second, strict=True)
    )
    return (red, green, blue)


def tension_colours() -> list[tuple[int, int, int]]:
    """Return colours spread over the scale of the player."""
    return [tension_colour(each, 1.0) for each in np.linspace(0.0, 1.0, _SCALE_STEPS)]


def _draw_ruler(draw: ImageDraw.ImageDraw, view: _View) -> None:
    """Draw a scale bar of a round length."""
    span = view.size[0] / view.scale
    length = next((v for v in (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1) if v <= 0.35 * span), 0.05)
    y, x = view.size[1] - 14 * _FINE, 12 * _FINE
    end = x + view.scale * length
    label, font, corner = f"{length:g} m", _font(12), (end + 6 * _FINE, y - 8 * _FINE)
    left, top, right, bottom = draw.textbbox(corner, label, font=font)
    margin = 4 * _FINE  # of the white background, as the tether may cross the label
    plate = (min(x, left) - margin, top - margin, right + margin, bottom + margin)
    draw.rectangle(plate, fill="white")
    draw.line([(x, y), (end, y)], fill=_TEXT, width=2 * _FINE)
    for place in (x, end):
        draw.line([(place, y - 4 * _FINE), (place, y + 4 * _FINE)], fill=_TEXT, width=2 * _FINE)
    draw.text(corner, label, fill=_TEXT, font=font)
