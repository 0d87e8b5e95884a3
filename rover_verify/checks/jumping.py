"""How well the rover jumps: as high as wanted, with a spring that it has to learn."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.jump_rig import JumpingRover, draw_stand

_JUMPS = 6  # of each rover
_RUNS = 20  # rovers
_STROKE_ERROR = 2.0e-3  # [m]
_HEIGHTS = (0.08, 0.35)  # wanted [m]
_NEAR = 0.10


class Leap(NamedTuple):
    """A jump as it was asked for and flown."""

    wanted: float  # [m]
    flown: float  # true [m]; nan = the rover did not leave the ground
    told: float  # as the rover measured it [m]; nan = it did not
    reason: str  # why it did not jump, or how it ended

    @property
    def is_near(self) -> bool:
        """Whether it came within 10 % of what was wanted."""
        return abs(self.flown / self.wanted - 1.0) <= _NEAR


def leaps_of(seed: int, index: int, learns: bool) -> tuple[Leap, ...]:
    """The jumps of one rover: its spring off by up to 5 %, each stroke by up to 2 mm."""
    generator = np.random.default_rng([seed, index, 61])
    stand = draw_stand(generator)
    rover = JumpingRover(stand, seed=1000 * seed + index)
    found = []
    for _ in range(_JUMPS):
        wanted = float(generator.uniform(*_HEIGHTS))
        rover.stroke_error = float(generator.uniform(-_STROKE_ERROR, _STROKE_ERROR))
        if not learns:
            rover.control.forget()
        records = len(rover.records)
        done = rover.leap(wanted)
        told = rover.records[-1].flown.height if len(rover.records) > records else math.nan
        reason = rover.changes[-1][1].reason if rover.changes else "; ".join(rover.refusals)
        found.append(Leap(wanted, rover.heights[-1] if done else math.nan, told, reason))
    return tuple(found)


def height_reached(batch: Batch) -> Measured:
    """Share of jumps whose height comes within 10 % of the wanted one."""
    runs = batch.runs if batch.runs > 0 else _RUNS
    rovers = fly_batch(batch, runs, leaps_of, True)
    open_loop = fly_batch(batch, runs, leaps_of, False)
    leaps = [leap for rover in rovers for leap in rover]
    first = [rover[0] for rover in rovers]
    errors = np.array([abs(leap.told - leap.flown) for leap in leaps])
    details: dict[str, float | str] = {
        "without learning": _share([leap for rover in open_loop for leap in rover]),
        "of the first jumps": _share(first),
        "of the later ones": _share([leap for rover in rovers for leap in rover[1:]]),
        "largest error of the measured height [m]": float(np.nanmax(errors)),
        "jumps not measured": float(np.isnan(errors).sum()),
    }
    for index, rover in enumerate(rovers):
        text = ", ".join(f"{leap.flown:.3f}/{leap.wanted:.3f}" for leap in rover)
        details[f"rover {index}"] = f"flown/wanted {text} m; {rover[-1].reason}"
    note = f"{len(leaps)} jumps of {runs} rovers, {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m"
    return Measured(_share(leaps), note, details)


def _share(leaps: list[Leap]) -> float:
    return float(np.mean([leap.is_near for leap in leaps]))
