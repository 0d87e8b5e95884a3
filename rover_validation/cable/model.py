"""A cable as it is identified: geometry, laws and band, kept as YAML; it predicts takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from scipy.interpolate import CubicSpline

from msg_schemas.fields import FieldError
from msg_schemas.yaml_reader import read_yaml
from rover_sim import CableLaws, EndMotion, HeldCable
from rover_validation.cable.takes import HELD, Floats, Take
from rover_validation.estimation import Identified
from rover_validation.refusals import SetError

FORMAT: Final = "cable 1"
_ARC_FRAMES: Final = 40
"""Frames of a take from which the distances along the cable are taken."""
_OFF: Final = 0.12
"""Relative deviation of a take's marker distances from the cable's that is refused."""
_SMALLEST: Final = 1.0e-4
"""Width of a band at the first frames [m]."""

_POSITIVE: Final = ("bending_stiffness", "length_ratio", "relaxation_time")
_REQUIRED: Final = (
    *_POSITIVE, "relaxation_ratio", "bending_damping_time", "drag", "marker_mass", "twist_ratio",
    "root_tilt_1", "root_tilt_2", "tip_tilt_1", "tip_tilt_2",
)  # fmt: skip
"""Numbers that every cable has."""
_MOST_ELEMENTS: Final = 1000


@dataclass(frozen=True)
class CableGeometry:
    """What is given of a cable.

    Attributes:
        arcs: distance along the cable from each marker to the next [m], (markers - 1,).
        rest: natural curvature of the shape at rest at the nodes [1/m], (2, n + 1); zero if none
            is given.
        elements: number of elements between the driven ends.
        longest_step: of the simulation [s].
        cutoff: of the ends' motion [Hz].
        reference: axis of the world nearest to which the frames of the ends begin: 0 x, 1 y, 2 z.
    """

    arcs: Floats
    rest: Floats
    elements: int = 16
    longest_step: float = 0.01
    cutoff: float = 15.0
    reference: int = 1

    @property
    def places(self) -> Floats:
        """Places of the markers between and at the driven ends [m]."""
        inner = self.arcs[1:-1]
        return np.concatenate([[0.0], np.cumsum(inner)])


@dataclass(frozen=True)
class Band:
    """Band about predictions that holds 90 % of the coordinates of the takes identified with.

    Attributes:
        low, high: bounds of the error of each free marker's coordinates, over the factor
            1 + slope v / v0 of the cable's predicted speed v, (markers, 3) [m].
        slope: see above [-].
        speed: v0, the mean speed [m/s].
        rise: time constant with which the band opens after the first frames [s].
    """

    low: Floats
    high: Floats
    slope: float
    speed: float
    rise: float

    def bounds(self, predicted: Floats, period: float) -> tuple[Floats, Floats]:
        """Lower and upper bound about a prediction (frames, markers, 3) [m]."""
        factor = band_factor(predicted, period, self.slope, self.speed, self.rise)
        low = np.minimum(self.low * factor, -_SMALLEST)
        high = np.maximum(self.high * factor, _SMALLEST)
        return predicted + low, predicted + high


def band_factor(
    predicted: Floats, period: float, slope: float, speed: float, rise: float
) -> Floats:
    """Factor of the band's width at each frame, (frames, 1, 1)."""
    moving = np.linalg.norm(np.gradient(predicted, period, axis=0), axis=-1).mean(axis=1)
    window = max(1, round(1.0 / period))  # the error remembers about a second of motion
    total = np.concatenate([[0.0], np.cumsum(moving)])
    frames = np.arange(1, len(moving) + 1)
    first = np.maximum(frames - window, 0)
    mean = (total[frames] - total[first]) / (frames - first)
    opening = 1.0 - np.exp(-np.arange(len(moving)) * period / rise)
    return np.asarray((opening * (1.0 + slope * mean / speed))[:, None, None])


@dataclass(frozen=True)
class Cable:
    """An identified cable.

    Attributes:
        geometry: what is given.
        fixed: numbers that are not identified, by name.
        numbers: identified numbers.
        band: about its predictions; None while it is identified.
    """

    geometry: CableGeometry
    fixed: Mapping[str, float]
    numbers: tuple[Identified, ...]
    band: Band | None = None

    @property
    def values(self) -> dict[str, float]:
        """All numbers by name."""
        return {**self.fixed, **{each.name: each.value for each in self.numbers}}

    def predict(self, take: Take) -> Floats:
        """Positions of the free markers [m], (frames, markers, 3); the first two are measured.

        Raises:
            SetError: the take is of another cable, or the simulation does not reach its end.
        """
        if take.markers != len(self.geometry.arcs) + 1:
            raise SetError(
                f"{take.name}: {take.markers} markers, the cable has {len(self.geometry.arcs) + 1}"
            )
        predicted, reached = Prepared(self.geometry, take).simulate(self.values)
        if reached < len(take.times):
            raise SetError(
                f"{take.name}: the simulation of the cable fails after "
                f"{take.times[reached - 1]:g} s of {take.times[-1]:g} s; do the held markers jump "
                "there?"
            )
        predicted[:2] = take.free[:2]
        return predicted

    def to_yaml(self) -> str:
        """The cable as text."""
        assert self.band is not None
        geometry, band = self.geometry, self.band
        content = {
            "format": FORMAT,
            "geometry": {
                "arcs": _plain(geometry.arcs), "rest": _plain(geometry.rest),
                "elements": geometry.elements, "longest_step": geometry.longest_step,
                "cutoff": geometry.cutoff, "reference": geometry.reference,
            },
            "fixed": dict(self.fixed),
            "identified": {each.name: each.to_mapping() for each in self.numbers},
            "band": {
                "low": _plain(band.low), "high": _plain(band.high), "slope": band.slope,
                "speed": band.speed, "rise": band.rise,
            },
        }  # fmt: skip
        return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100))

    @classmethod
    def read(cls, path: Path) -> Cable:
        """Read what `to_yaml` wrote.

        Raises:
            SetError: the file is none or damaged.
        """
        try:
            content = read_yaml(path)
            if not isinstance(content, Mapping) or content.get("format") != FORMAT:
                raise SetError(f"{path}: is no cable (format: {FORMAT}) that identify wrote")
            geometry, band = dict(content["geometry"]), dict(content["band"])
            for mapping, names in ((geometry, ("arcs", "rest")), (band, ("low", "high"))):
                mapping.update({name: np.array(mapping[name], dtype=float) for name in names})
            cable = cls(
                CableGeometry(**geometry),
                {str(name): float(value) for name, value in content["fixed"].items()},
                tuple(Identified(name, **one) for name, one in content["identified"].items()),
                Band(**band),
            )
            problem = _problem(cable)
        except FieldError as error:
            raise SetError(str(error)) from None
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            problem = str(error)
        if problem:
            raise SetError(f"{path}: is damaged ({problem}); identify the cable again")
        return cable


def _problem(cable: Cable) -> str:
    """What of a cable that was read cannot be; empty if nothing."""
    geometry, band, values = cable.geometry, cable.band, cable.values
    assert band is not None
    missing = [name for name in _REQUIRED if name not in values]
    if missing:
        return f"no number {', '.join(missing)}"
    for name, value in values.items():
        least = 0.0 if name in _POSITIVE else -math.inf
        if not least < value < math.inf:
            return f"{name} = {value!r:.40}, should be finite{', above 0' if least == 0.0 else ''}"
    elements, free = geometry.elements, geometry.arcs.size - 2 * HELD + 1
    if type(elements) is not int or not 1 <= elements <= _MOST_ELEMENTS:
        return f"elements = {elements!r:.40}, should be a whole number from 1 to {_MOST_ELEMENTS}"
    if geometry.reference not in (0, 1, 2):
        return f"reference = {geometry.reference!r:.40}, should be 0, 1 or 2"
    for name, array, shape in (
        ("arcs", geometry.arcs, (geometry.arcs.size,)), ("rest", geometry.rest, (2, elements + 1)),
        ("low", band.low, (free, 3)), ("high", band.high, (free, 3)),
    ):  # fmt: skip
        if free < 1 or array.shape != shape or not np.isfinite(array).all():
            return f"{name} has the shape {array.shape}, should be finite numbers in {shape}"
    if not (geometry.arcs > 0.0).all():
        return f"arcs from {geometry.arcs.min():g} m, should be above 0"
    for name, value in (
        ("longest_step", geometry.longest_step), ("cutoff", geometry.cutoff),
        ("speed", band.speed), ("rise", band.rise), ("slope + 1", band.slope + 1.0),
    ):  # fmt: skip
        if not 0.0 < value < math.inf:
            return f"{name} = {value!r:.40}, should be finite, above 0"
    return ""


def _plain(array: Floats) -> Any:
    return np.round(array, 6).tolist()


class Prepared:
    """A take as the simulation needs it.

    Args:
        geometry: of the cable.
        take: its first two frames and its held markers are used.
    """

    def __init__(self, geometry: CableGeometry, take: Take) -> None:
        self.take = take
        self.exchanged = exchanged_ends(geometry.arcs, take)
        held = [0, 1, take.markers - 2, take.markers - 1]
        for end in self.exchanged:
            first = 2 * end
            held[first], held[first + 1] = held[first + 1], held[first]
        outer0, inner0, inner1, outer1 = (take.positions[:, each] for each in held)
        axis = np.eye(3)[geometry.reference]
        self._geometry = geometry
        self._ends = (
            EndMotion.from_table(take.times, inner0, inner0 - outer0, geometry.cutoff, axis),
            EndMotion.from_table(take.times, inner1, outer1 - inner1, geometry.cutoff, axis),
        )
        self._first = np.concatenate([inner0[:2, None], take.free[:2], inner1[:2, None]], axis=1)

    def turned(self, axis: int) -> Prepared:
        """The take with frames of the ends that begin near another axis of the world."""
        return Prepared(replace(self._geometry, reference=axis), self.take)

    def simulate(self, values: Mapping[str, float]) -> tuple[Floats, int]:
        """Simulate the take for values of the numbers, as `HeldCable.simulate`."""
        geometry = self._geometry
        cable = HeldCable(geometry.places * values["length_ratio"], geometry.elements)
        motion = cable.motion(
            self._first[0],
            self._first[1],
            self._ends,
            self.take.times,
            geometry.longest_step,
            (
                (values["root_tilt_1"], values["root_tilt_2"]),
                (values["tip_tilt_1"], values["tip_tilt_2"]),
            ),
            values.get("tip_roll"),
        )
        return cable.simulate(laws_of(values), natural_curvature(geometry, values), motion)


def laws_of(values: Mapping[str, float]) -> CableLaws:
    """Laws of a cable with these numbers."""
    return CableLaws(
        values["bending_stiffness"],
        values["bending_damping_time"],
        values["drag"],
        values["marker_mass"],
        values["twist_ratio"],
        relaxation_ratio=values["relaxation_ratio"],
        relaxation_time=values["relaxation_time"],
    )


def natural_curvature(geometry: CableGeometry, values: Mapping[str, float]) -> Floats:
    """Natural curvature at the nodes [1/m], (2, n + 1): along the cable, and the rest shape's."""
    nodes = np.linspace(0.0, 1.0, geometry.elements + 1)
    rows = []
    for direction in (1, 2):
        knots = [
            value for name, value in sorted(values.items())
            if name.startswith(f"curvature_{direction}_")
        ]  # fmt: skip
        rows.append(
            np.interp(nodes, np.linspace(0.0, 1.0, len(knots)), knots)
            if len(knots) > 1
            else np.full(len(nodes), knots[0] if knots else 0.0)
        )
    scale, roll = values.get("rest_scale", 0.0), values.get("rest_roll", 0.0)
    cosine, sine = scale * math.cos(roll), scale * math.sin(roll)
    first, second = geometry.rest
    return np.stack([
        rows[0] + cosine * first - sine * second, rows[1] + sine * first + cosine * second,
    ])  # fmt: skip


def arcs_of(takes: Sequence[Take]) -> Floats:
    """Distances along the cable between neighbouring markers: medians over frames of all takes."""
    found = []
    for take in takes:
        for frame in np.linspace(0, len(take.times) - 1, _ARC_FRAMES).astype(int).tolist():
            shape = take.positions[frame]
            if not np.isnan(shape).any():
                found.append(arcs_of_shape(shape))
    if not found:
        raise SetError("no frame has all markers: the distances between them are not known")
    return np.asarray(np.median(found, axis=0))


def arcs_of_shape(shape: Floats) -> Floats:
    """Distances along a spline through markers (markers, 3) [m]."""
    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1))])
    spline = CubicSpline(chords, shape)
    parts = np.linspace(0.0, 1.0, 9)
    lengths = [
        np.linalg.norm(np.diff(spline(start + (end - start) * parts), axis=0), axis=1).sum()
        for start, end in pairwise(chords)
    ]
    return np.array(lengths)


def exchanged_ends(arcs: Floats, take: Take) -> list[int]:
    """Ends (0 root, 1 tip) whose two held markers carry each other's name.

    The distance from the inner held marker to its free neighbour is then longer by the distance of
    the two.
    """
    found = []
    for end, (outer, inner, free) in enumerate(((0, 1, 2), (-1, -2, -3))):
        shape = take.positions[:2]
        here = float(np.linalg.norm(shape[:, inner] - shape[:, free], axis=-1).mean())
        there = float(np.linalg.norm(shape[:, outer] - shape[:, free], axis=-1).mean())
        length = float(arcs[1] if end == 0 else arcs[-2])
        if here - length > _OFF * length and abs(there - length) < 0.5 * abs(here - length):
            found.append(end)
    return found


def check_distances(path: Path, arcs: Floats, take: Take) -> None:
    """Refuse a take whose markers are not as far apart as the cable's.

    Raises:
        SetError: the first line of the file at which the markers differ.
    """
    inner = slice(HELD - 1, len(arcs) - HELD + 1)
    shape = take.positions[0]
    lengths = arcs_of_shape(shape)[inner]
    total, own = float(lengths.sum()), float(arcs[inner].sum())
    if abs(total - own) > _OFF * own:
        raise SetError(
            f"{path}:2: the cable is {total:.3f} m long between its ends, but the identified one "
            f"{own:.3f} m: another cable, or another unit"
        )


def with_numbers(cable: Cable, numbers: Sequence[Identified]) -> Cable:
    """The cable with other identified numbers; what was identified before is fixed."""
    names = {each.name for each in numbers}
    fixed = {name: value for name, value in cable.values.items() if name not in names}
    return replace(cable, fixed=fixed, numbers=tuple(numbers))
