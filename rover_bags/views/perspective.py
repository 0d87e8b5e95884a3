"""Draws solids and lines in perspective: a camera, and polygons painted from far to near."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

Array = NDArray[np.float64]
Rgb = tuple[int, int, int]

_FINE: Final = 2  # supersampling, for smooth edges
_SUN: Final = np.array([0.45, -0.55, 0.70]) / np.linalg.norm([0.45, -0.55, 0.70])
_AMBIENT: Final = 0.45  # share of light in the shade
_NEAREST: Final = 0.05  # distance of the front clipping plane [m]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without roll.

    Attributes:
        eye: its place [m].
        target: the point in the middle of the image [m].
        view: vertical angle of view [rad].
    """

    eye: Array
    target: Array
    view: float

    def project(self, points: Array, size: tuple[int, int]) -> tuple[Array, Array]:
        """Return pixels (N, 2) and distances along the view [m] (N,) of points (N, 3)."""
        ahead = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        local = (points - self.eye) @ np.stack([right, np.cross(right, ahead), ahead]).T
        distance = local[:, 2]
        focal = 0.5 * size[1] / np.tan(0.5 * self.view)
        scaled = focal * local[:, :2] / np.maximum(distance, _NEAREST)[:, None]
        pixels = np.array([0.5 * size[0], 0.5 * size[1]]) + scaled * [1.0, -1.0]
        return pixels, distance


@dataclass
class Painting:
    """Polygons and lines of one image.

    Args:
        camera: that sees them.
        size: of the image [pixel].
        sky: colour of the background.
    """

    camera: Camera
    size: tuple[int, int]
    sky: Rgb
    _items: list[tuple[float, Array, Rgb, int]] = field(default_factory=list)

    def polygons(self, corners: Array, colour: ArrayLike, *, is_shaded: bool = True) -> None:
        """Add polygons.

        Args:
            corners: of K polygons of M corners each [m], (K, M, 3).
            colour: red, green, blue in 0..1.
            is_shaded: whether the sun shades them; their two sides look the same.
        """
        count, sides = corners.shape[:2]
        pixels, distance = self._project(corners.reshape(-1, 3))
        pixels, distance = pixels.reshape(count, sides, 2), distance.reshape(count, sides)
        light = np.ones(count)
        if is_shaded:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
            light = _AMBIENT + (1.0 - _AMBIENT) * np.abs(normal @ _SUN) / length
        for k in np.flatnonzero(distance.min(axis=1) > _NEAREST):
            shade = as_rgb(light[k] * np.asarray(colour, dtype=np.float64))
            self._items.append((float(distance[k].mean()), pixels[k], shade, 0))

    def line(self, points: Array, colours: Array, width: int) -> None:
        """Add a line through points (N, 3) [m] with the colour of each part (N - 1, 3) in 0..1."""
        pixels, distance = self._project(points)
        for k in range(len(points) - 1):
            if distance[k : k + 2].min() > _NEAREST:
                part = pixels[k : k + 2]
                self._items.append((float(distance[k]) - 0.02, part, as_rgb(colours[k]), width))

    def disc(self, centre: Array, radius: int, colour: ArrayLike) -> None:
        """Add a disc of a radius [pixel] at a point (3,) [m], in front of all else."""
        (pixel,), (distance,) = self._project(centre[None, :])
        if distance > _NEAREST:
            angle = np.linspace(0.0, 2.0 * np.pi, 16)[:, None]
            round_ = pixel + _FINE * radius * np.hstack([np.cos(angle), np.sin(angle)])
            self._items.append((0.0, round_, as_rgb(np.asarray(colour, dtype=np.float64)), 0))

    def _project(self, points: Array) -> tuple[Array, Array]:
        fine = (_FINE * self.size[0], _FINE * self.size[1])
        return self.camera.project(points, fine)

    def image(self) -> Image.Image:
        """Paint from far to near."""
        made = Image.new("RGB", (_FINE * self.size[0], _FINE * self.size[1]), self.sky)
        draw = ImageDraw.Draw(made)
        for _, pixels, colour, width in sorted(self._items, key=lambda item: -item[0]):
            corners = [(float(x), float(y)) for x, y in pixels]
            if width:
                draw.line(corners, fill=colour, width=_FINE * width)
            else:
                draw.polygon(corners, fill=colour, outline=colour)
        return made.resize(self.size, Image.Resampling.LANCZOS)


def as_rgb(colour: Array) -> Rgb:
    """Return red, green, blue in 0..255 of a colour in 0..1."""
    red, green, blue = (255.0 * np.clip(colour[:3], 0.0, 1.0)).round().astype(int).tolist()
    return red, green, blue


# --- solids --------------------------------------------------------------------------------------

_BOX_FACES: Final = np.array(
    [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
    ],
    dtype=np.float64,
)
_SECTORS: Final = 20


def box(size: ArrayLike) -> list[Array]:
    """Return the faces of a box about the origin: arrays of polygons (K, M, 3) [m]."""
    return [(_BOX_FACES - 0.5) * np.asarray(size, dtype=np.float64)]


def cylinder(radius: float, length: float) -> list[Array]:
    """Return the sides and ends of a cylinder along z about the origin."""
    angle = np.linspace(0.0, 2.0 * np.pi, _SECTORS + 1)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle], axis=1)
    up = np.array([0.0, 0.0, 0.5 * length])
    low, high = ring - up, ring + up
    sides = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    return [sides, np.stack([low[:-1], high[:-1]])]


def sphere(radius: float) -> list[Array]:
    """Return the faces of a sphere about the origin."""
    turn, rise = np.linspace(0.0, 2.0 * np.pi, 15), np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
    grid = radius * np.stack(
        [
            np.outer(np.cos(rise), np.cos(turn)),
            np.outer(np.cos(rise), np.sin(turn)),
            np.outer(np.sin(rise), np.ones_like(turn)),
        ],
        axis=-1,
    )
    around = (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:])
    return [np.stack(around, axis=2).reshape(-1, 4, 3)]
