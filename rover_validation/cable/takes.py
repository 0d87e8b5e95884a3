"""Takes of a measured cable: read CSV files, refuse damaged ones by line, write predictions.

A take is a CSV file with the columns `time_s, x0_m, y0_m, z0_m, x1_m, ...`, one row a frame, z up.
The first two and the last two markers are held: given at every frame. The others move freely; they
are given in the first two frames, and an empty cell later is a position that is not known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from msg_schemas.csv_reader import number_of
from msg_schemas.fields import shown
from rover_validation.refusals import SetError, read_table

Floats: TypeAlias = NDArray[np.float64]

MIN_MARKERS: Final = 5
MIN_FRAMES: Final = 10
GIVEN_FRAMES: Final = 2
"""Frames in which the free markers are given."""
HELD: Final = 2
"""Held markers at each end."""
_LARGEST: Final = 1.0e9
"""Largest time [s] and coordinate [m]; beyond it a double does not resolve a micrometre."""
_LARGEST_SPAN: Final = 2.0
"""Distance between neighbouring markers from which the unit cannot be metres [m]."""
_SMALLEST_SPAN: Final = 1.0e-6
"""Distance below which two neighbouring markers are at one place [m]."""
_LONGEST_PERIOD: Final = 0.2
"""Time between frames from which the unit cannot be seconds, or the motion is lost [s]."""
_UNEVEN: Final = 0.2
"""Deviation of a time between frames from the median, as a fraction of it."""
_FASTEST: Final = 20.0
"""Speed of a held marker from which its positions jump [m/s]."""


@dataclass(frozen=True)
class Take:
    """Measured motion of a cable.

    Attributes:
        name: of the file, without suffix.
        times: of the frames [s], (frames,), evenly spaced.
        positions: of the markers [m], (frames, markers, 3); NaN where not known.
    """

    name: str
    times: Floats
    positions: Floats

    @property
    def period(self) -> float:
        """Time between frames [s]."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))

    @property
    def markers(self) -> int:
        """Number of markers."""
        return int(self.positions.shape[1])

    @property
    def free(self) -> Floats:
        """Positions of the free markers."""
        return self.positions[:, HELD:-HELD]


def column_names(markers: int) -> list[str]:
    """Names of a take's columns."""
    return ["time_s", *(f"{axis}{m}_m" for m in range(markers) for axis in "xyz")]


def read_takes(folder: Path) -> list[Take]:
    """Read all takes of a folder, by name.

    Raises:
        SetError: there is none, one is damaged, or they differ in their number of markers.
    """
    if not folder.is_dir():
        raise SetError(f"{folder}: no such folder; give a folder of CSV files, one a take")
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        raise SetError(f"{folder}: holds no CSV file; put one file a take there")
    takes = [read_take(path) for path in paths]
    for path, take in zip(paths, takes, strict=True):
        if take.markers != takes[0].markers:
            raise SetError(
                f"{path}:1: {take.markers} markers, but {paths[0].name} has {takes[0].markers}; "
                "the takes of a folder are of one cable"
            )
    return takes


def read_take(path: Path) -> Take:
    """Read one take.

    Raises:
        SetError: the file is damaged; the message states its line.
    """
    rows = read_table(path)
    markers = _markers_of(path, rows[0][1] if rows else [])
    lines = [line for line, _ in rows[1:]]
    values = [_numbers(path, line, row, 1 + 3 * markers) for line, row in rows[1:]]
    for line, numbers in zip(lines, values, strict=True):
        if math.isnan(numbers[0]):
            raise SetError(f"{path}:{line}: the time is missing")
    if len(values) < MIN_FRAMES:
        raise SetError(
            f"{path}:{rows[-1][0]}: ends after {len(values)} frames; "
            f"{MIN_FRAMES} or more are needed"
        )
    table = np.array(values)
    take = Take(path.stem, table[:, 0], table[:, 1:].reshape(len(values), markers, 3))
    _check_times(path, lines, take)
    _check_positions(path, lines, take)
    return take


def _markers_of(path: Path, header: Sequence[str]) -> int:
    names = [name.strip() for name in header]
    markers = (len(names) - 1) // 3
    expected = column_names(markers)
    for place, name in enumerate(names):
        required = expected[place] if place < len(expected) else None
        if name != required:
            hint = f"must be {required}" if required else "is one too many: three a marker"
            raise SetError(f"{path}:1: column {place + 1} is {shown(name)}, {hint}")
    if markers < MIN_MARKERS:
        raise SetError(
            f"{path}:1: {max(markers, 0)} markers; {MIN_MARKERS} or more are needed, of which two "
            "at each end are held"
        )
    return markers


def _numbers(path: Path, line: int, row: Sequence[str], count: int, first: int = 0) -> list[float]:
    """Numbers of a row from its cell `first` on; NaN for an empty cell."""
    if len(row) != count:
        raise SetError(f"{path}:{line}: {len(row)} cells, but the header has {count}")
    numbers = []
    for place, cell in enumerate(row[first:], first):
        if not cell.strip():
            numbers.append(math.nan)
            continue
        number = number_of(cell)
        if not abs(number) <= _LARGEST:
            raise SetError(
                f"{path}:{line}: column {place + 1} is {cell.strip()!r:.60}; write a "
                f"finite number within {_LARGEST:g}, "
                "or nothing for a free marker that is not known"
            )
        numbers.append(number)
    return numbers


def _check_times(path: Path, lines: Sequence[int], take: Take) -> None:
    steps = np.diff(take.times)
    median = float(np.median(steps))
    for frame, step in enumerate(steps.tolist(), 1):
        line = lines[frame]
        if step <= 0.0:
            raise SetError(f"{path}:{line}: time_s does not increase ({step:+.6g} s)")
        if abs(step - median) > _UNEVEN * median:
            raise SetError(
                f"{path}:{line}: {step:.6g} s after the previous frame, elsewhere {median:.6g} s; "
                "frames must be evenly spaced, without gaps"
            )
    if median > _LONGEST_PERIOD:
        raise SetError(
            f"{path}:{lines[1]}: {median:.6g} s between frames; at most {_LONGEST_PERIOD} s. Is "
            "time_s in milliseconds, or a number of frames?"
        )


def _check_positions(path: Path, lines: Sequence[int], take: Take) -> None:
    missing = np.isnan(take.positions)
    partly = missing.any(axis=2) & ~missing.all(axis=2)
    for frame, marker in np.argwhere(partly)[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame]}: marker {marker} has some coordinates and lacks others"
        )
    gone: NDArray[np.bool_] = np.asarray(missing.all(axis=2))
    held = [0, 1, take.markers - 2, take.markers - 1]
    for frame, place in np.argwhere(gone[:, held])[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame]}: held marker {held[place]} is missing; the first two and the "
            "last two are given at every frame"
        )
    for frame, marker in np.argwhere(gone[:GIVEN_FRAMES])[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame]}: marker {marker} is missing; all are given in the first "
            f"{GIVEN_FRAMES} frames"
        )
    spans = np.linalg.norm(np.diff(take.positions, axis=1), axis=-1)
    largest = np.nanmax(spans, axis=1)
    for frame in np.flatnonzero(largest > _LARGEST_SPAN)[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame]}: neighbouring markers are {largest[frame]:.4g} m apart, at "
            f"most {_LARGEST_SPAN} m. Are the positions in metres?"
        )
    if float(np.nanmax(spans)) == 0.0 or float(np.nanmedian(spans)) < 1.0e-3:
        raise SetError(
            f"{path}:{lines[0]}: neighbouring markers are {float(np.nanmedian(spans)):.2g} m "
            "apart. Are the positions in metres?"
        )
    for frame, marker in np.argwhere(spans < _SMALLEST_SPAN)[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame]}: markers {marker} and {marker + 1} are at one place; two "
            "markers never are"
        )
    speeds = np.linalg.norm(np.diff(take.positions[:, held], axis=0), axis=-1) / take.period
    for frame, place in np.argwhere(speeds > _FASTEST)[:1].tolist():
        raise SetError(
            f"{path}:{lines[frame + 1]}: held marker {held[place]} moves at "
            f"{speeds[frame, place]:.3g} m/s, at most {_FASTEST:g} m/s: it jumps"
        )


def write_prediction(path: Path, take: Take, predicted: Floats, low: Floats, high: Floats) -> None:
    """Write a prediction: the take's columns, and `..._lo` and `..._hi` beside each free one.

    Args:
        path: file to write.
        take: the take, whose held markers and first two frames are copied.
        predicted: of the free markers [m], (frames, free markers, 3).
        low: lower bounds of the band.
        high: upper bounds of the band.
    """
    names = column_names(take.markers)
    free = range(1 + 3 * HELD, 1 + 3 * (take.markers - HELD))
    header: list[str] = []
    columns: list[Floats] = []
    flat = [each.reshape(len(take.times), -1) for each in (predicted, low, high)]
    measured = take.positions.reshape(len(take.times), -1)
    for place, name in enumerate(names):
        if place in free:
            header += [name, f"{name}_lo", f"{name}_hi"]
            columns += [each[:, place - free.start] for each in flat]
        else:
            header.append(name)
            columns.append(measured[:, place - 1] if place else take.times)
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.column_stack(columns)
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(header) + "\n")
        for row in rows:
            stream.write(",".join(_cell(value) for value in row) + "\n")


def _cell(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".")


def read_rest_shapes(path: Path) -> list[Floats]:
    """Read the shapes of cables at rest: columns `marker, x_m, y_m, z_m`, in front maybe `cable`.

    The rows with the same text in `cable` are one cable's.

    Returns:
        Positions of the markers of each cable [m], (markers, 3), in the order of the file.

    Raises:
        SetError: the file is damaged; the message states its line.
    """
    rows = read_table(path)
    header = [name.strip() for name in rows[0][1]] if rows else []
    names = ["marker", "x_m", "y_m", "z_m"]
    if header not in (names, ["cable", *names]):
        raise SetError(f"{path}:1: the columns must be {', '.join(names)}, with cable in front")
    first = len(header) - len(names)
    shapes: dict[str, list[list[float]]] = {}
    for line, row in rows[1:]:
        marker, *position = _numbers(path, line, row, len(header), first)
        shape = shapes.setdefault(row[0].strip() if first else "", [])
        if any(map(math.isnan, position)) or marker != len(shape):
            raise SetError(
                f"{path}:{line}: marker {len(shape)} of the cable must come here, with its position"
            )
        if shape and math.dist(shape[-1], position) < _SMALLEST_SPAN:
            raise SetError(
                f"{path}:{line}: marker {len(shape)} is at the place of the marker before it; two "
                "markers never are"
            )
        shape.append(position)
    return [np.array(shape) for shape in shapes.values()]
