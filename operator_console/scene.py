"""Geometry to draw: the place around the machine, the tether and the rover.

All values are plain numbers for JSON, in the frame ``map``. The page draws them from the side (x to
the right, z up) and from above (x to the right, y up).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from msg_schemas.fields import FieldRule, read_or_none
from msg_schemas.samples import DrawingSample, OdometrySample, Shape, TetherSample

Floats = NDArray[np.float64]

BY_TRUTH: Final = "simulation"
"""Source of the geometry: the plant publishes it."""
BY_PAYOUT: Final = "payout"
"""Source of the geometry: a straight line of the paid-out length."""

_SECTION: Final = 1e-4
"""Offset of the cutting plane from the meshes' vertices [m]."""
_LEVEL_STEP: Final = 4.0  # [m]
_MOST_NODES: Final = 80
_DEFAULT_SIZES: Final = {
    "body1_size": (0.30, 0.24, 0.15),
    "body2_size": (0.24, 0.24, 0.08),
    "attachment": (0.0, 0.0, 0.28),
}
_LENGTH: Final = FieldRule(kind=float)
_VECTOR: Final = FieldRule(kind=float, length=3)
_DEFAULT_WHEELS: Final = {"radius": 0.15, "track_width": 0.44, "axle_x": 0.08, "axle_z": 0.0}


def place_of(sample: DrawingSample) -> dict[str, Any]:
    """The place, cut along the plane y = 0 and at several heights.

    Returns:
        ``wall`` and ``floor``: lines (x, z, x, z) of the cut from the side; ``levels``: lines
        (x, y, x, y) of the wall at heights ``z``; ``boulders``: spheres (x, y, z, radius). [m]
    """
    meshes = {name: _triangles(sample.shapes, name) for name in ("wall", "floor")}
    found: dict[str, Any] = {
        name: _rounded(cut(mesh, 1, _SECTION)) for name, mesh in meshes.items()
    }
    wall = meshes["wall"]
    heights = wall[:, :, 2] if len(wall) else np.zeros(1)
    found["levels"] = [
        {"z": round(z, 2), "lines": _rounded(cut(wall, 2, z + _SECTION))}
        for z in np.arange(heights.min() + 0.5, heights.max(), _LEVEL_STEP).tolist()
    ]
    found["boulders"] = [
        [*(round(value, 3) for value in shape.position), round(0.5 * shape.size[0], 3)]
        for shape in sample.shapes
        if shape.kind == "sphere"
    ]
    return found


def cut(triangles: Floats, axis: int, value: float) -> Floats:
    """Intersect triangles with the plane on which one coordinate has a value.

    Args:
        triangles: vertices, shape (n, 3, 3) [m].
        axis: index of the coordinate.
        value: value of that coordinate [m].

    Returns:
        End points of the lines by the other two coordinates, shape (m, 4) [m].
    """
    lines = []
    others = [index for index in range(3) if index != axis]
    beyond = triangles[:, :, axis] > value
    crossing = np.flatnonzero(beyond.any(axis=1) & ~beyond.all(axis=1))
    for triangle, sides in zip(triangles[crossing], beyond[crossing], strict=True):
        ends = []
        for first, second in ((0, 1), (1, 2), (2, 0)):
            if sides[first] != sides[second]:
                a, b = triangle[first], triangle[second]
                part = (value - a[axis]) / (b[axis] - a[axis])
                ends.append((a + part * (b - a))[others])
        lines.append(np.concatenate(ends))
    return np.array(lines) if lines else np.zeros((0, 4))


def machine_of(configuration: str) -> dict[str, Any] | None:
    """Sizes of the rover [m] from the simulator's configuration; None for another node's.

    Sizes that are missing, or no finite numbers, are those of the default machine.
    """
    try:
        content = json.loads(configuration)
    except ValueError:
        return None
    scenario = content.get("scenario") if isinstance(content, dict) else None
    if not isinstance(scenario, Mapping):
        return None
    rover = scenario.get("rover")
    rover = rover if isinstance(rover, Mapping) else {}
    found: dict[str, Any] = {"scenario": str(scenario.get("name", ""))}
    for name, usual in _DEFAULT_SIZES.items():
        found[name] = list(read_or_none(_VECTOR, rover.get(name)) or usual)
    wheels = rover.get("wheels")
    given = wheels if isinstance(wheels, Mapping) else {}
    lengths = {name: read_or_none(_LENGTH, given.get(name)) for name in _DEFAULT_WHEELS}
    found["wheels"] = {
        name: usual if lengths[name] is None else lengths[name]
        for name, usual in _DEFAULT_WHEELS.items()
    }
    return found


DEFAULT_MACHINE: Final = {
    "scenario": "",
    **{name: list(size) for name, size in _DEFAULT_SIZES.items()},
    "wheels": dict(_DEFAULT_WHEELS),
}
"""Default sizes [m]."""


@dataclass(frozen=True)
class SceneGeometry:
    """Positions of tether and rover.

    Attributes:
        source: ``BY_TRUTH`` or ``BY_PAYOUT``.
        tether: nodes from the fairlead to the rover: x, y, z [m], tension [N] (None: unknown).
        body1: x, y, z [m] and the quaternion x, y, z, w; None: unknown.
        body2: as body1.
    """

    source: str
    tether: tuple[tuple[float | None, ...], ...] = ()
    body1: tuple[float, ...] | None = None
    body2: tuple[float, ...] | None = None


def geometry(
    tether: TetherSample | None,
    body1: OdometrySample | None,
    body2: OdometrySample | None,
    payout: float | None,
) -> SceneGeometry | None:
    """The known geometry; None if not even the payout [m] is known."""
    if tether is not None or body1 is not None:
        nodes = _nodes(tether.nodes) if tether is not None else ()
        return SceneGeometry(BY_TRUTH, nodes, _pose(body1), _pose(body2))
    if payout is None or not math.isfinite(payout):
        return None
    line = ((0.0, 0.0, 0.0, None), (0.0, 0.0, -round(payout, 4), None))
    return SceneGeometry(BY_PAYOUT, line)


def _nodes(nodes: Floats) -> tuple[tuple[float | None, ...], ...]:
    at = np.linspace(0, len(nodes) - 1, min(len(nodes), _MOST_NODES)).round().astype(int)
    chosen = nodes[at]
    return tuple(
        (round(x, 4), round(y, 4), round(z, 4), round(tension, 3))
        for x, y, z, tension in chosen[:, [0, 1, 2, 6]].tolist()
    )


def _pose(body: OdometrySample | None) -> tuple[float, ...] | None:
    if body is None:
        return None
    return tuple(round(value, 5) for value in (*body.position, *body.orientation))


def _triangles(shapes: Sequence[Shape], name: str) -> Floats:
    corners = [
        shape.points for shape in shapes if shape.kind == "triangles" and shape.namespace == name
    ]
    points = [point for part in corners for point in part]
    return np.array(points, dtype=np.float64).reshape(-1, 3, 3)


def _rounded(lines: Floats) -> list[list[float]]:
    return [[round(value, 3) for value in line] for line in lines.tolist()]
