"""``mother_rover validate cable example``: takes of a simulated cable whose laws are known."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from msg_schemas.number_arguments import finite_number, positive, seed
from rover_validation.cable.model import CableGeometry, Prepared
from rover_validation.cable.takes import HELD, Floats, Take, column_names
from rover_validation.refusals import OK

LAWS: Final = {
    "relaxation_ratio": 0.0, "relaxation_time": 3.0,
    "bending_stiffness": 0.03, "bending_damping_time": 0.05, "drag": 0.4, "marker_mass": 0.03,
    "twist_ratio": 0.8, "length_ratio": 1.0, "curvature_1_0": 1.5, "curvature_2_0": -2.5,
    "root_tilt_1": 0.0, "root_tilt_2": 0.0, "tip_tilt_1": 0.0, "tip_tilt_2": 0.0,
}  # fmt: skip
"""The cable's numbers, per mass per length."""
_MARKERS: Final = 8
_SPACING: Final = 0.12
_HOLDER: Final = 0.03
"""Distance of the two held markers of an end [m]."""
_RATE: Final = 50.0
_SETTLING: Final = 2.0
"""Time in which the cable comes to rest before a take [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Write takes of a simulated cable into FOLDER/identify and FOLDER/check, in the format "
        "that identify and predict read. The cable's laws are known, so that one can judge the "
        "identification. Exit code 0."
    )
    parser.add_argument("folder", type=Path, help="folder to write")
    add = parser.add_argument
    add("--takes", type=positive, default=6, help="takes to identify with (default 6)")
    add("--duration", type=finite_number(0.2, 3600.0), default=2.0,
        help="of a take [s] (default 2)")  # fmt: skip
    add("--noise", type=finite_number(0.0, 1.0), default=2e-4,
        help="of a position [m] (default 2e-4)")  # fmt: skip
    add("--seed", type=seed, default=1, help="of motion and noise (default 1)")


def run(options: argparse.Namespace) -> int:
    """Write the takes; return the exit code."""
    generator = np.random.default_rng(options.seed)
    for use, count in (("identify", options.takes), ("check", 2)):
        for number in range(count):
            take = example_take(generator, options.duration, options.noise)
            path = options.folder / use / f"take_{number + 1}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            rows = np.column_stack([take.times, take.positions.reshape(len(take.times), -1)])
            head = ",".join(column_names(take.markers))
            np.savetxt(path, rows, "%.5f", ",", header=head, comments="")
        print(f"{options.folder / use}: {count} takes of {options.duration:g} s")
    known = ", ".join(f"{name} {value:g}" for name, value in LAWS.items() if value)
    print(f"the cable: {known}")
    return OK


def example_take(
    generator: np.random.Generator,
    duration: float,
    noise: float,
    numbers: Mapping[str, float] = LAWS,
) -> Take:
    """A take of a cable whose ends are moved at random.

    Args:
        generator: of motion and noise.
        duration: [s].
        noise: standard deviation of each coordinate [m].
        numbers: of the cable, by name.
    """
    geometry = example_geometry()
    times = np.arange(round((_SETTLING + duration) * _RATE) + 1) / _RATE
    held = _held_motion(generator, times)
    positions = np.full((len(times), _MARKERS, 3), np.nan)
    positions[:, [0, 1, -2, -1]] = held
    positions[:2, HELD:-HELD] = _sagging(held[0, 1], held[0, 2], geometry.places)
    free, _ = Prepared(geometry, Take("", times, positions)).simulate(numbers)
    positions[:, HELD:-HELD] = free
    positions += noise * generator.standard_normal(positions.shape)
    begin = round(_SETTLING * _RATE)
    return Take("example", times[begin:] - times[begin], positions[begin:])


def example_geometry() -> CableGeometry:
    """Geometry of the example's cable."""
    arcs = np.full(_MARKERS - 1, _SPACING)
    arcs[[0, -1]] = _HOLDER
    return CableGeometry(arcs, np.zeros((2, CableGeometry.elements + 1)))


def _held_motion(generator: np.random.Generator, times: Floats) -> Floats:
    """Positions of the held markers, (frames, 4, 3): at rest, then moved."""
    since = np.clip(times - _SETTLING + 0.3, 0.0, None)[:, None]
    started = 1.0 - np.exp(-((since / 0.3) ** 2))
    motions = []
    for centre in ((0.2, 0.0, 0.5), (-0.2, 0.0, 0.5)):
        size = generator.uniform(0.05, 0.12, 3)
        rate = generator.uniform(3.0, 7.0, 3)
        phase = generator.uniform(-1.0, 1.0, 3)
        motions.append(np.array(centre) + size * started * np.sin(rate * since + phase))
    down = np.array([0.0, 0.0, -_HOLDER])
    root, tip = motions
    return np.stack([root - down, root, tip, tip - down], axis=1)


def _sagging(root: Floats, tip: Floats, places: Floats) -> Floats:
    """Free markers on a parabola through the ends, as long as the cable, (markers, 3)."""
    parts = np.linspace(0.0, 1.0, 400)[:, None]
    line = root + parts * (tip - root)
    low, high = 0.0, float(places[-1])
    for _ in range(50):
        sag = 0.5 * (low + high)
        curve = line - np.array([0.0, 0.0, 4.0 * sag]) * parts * (1.0 - parts)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        low, high = (low, sag) if along[-1] > places[-1] else (sag, high)
    return np.stack([np.interp(places[1:-1], along, curve[:, k]) for k in range(3)], axis=1)
