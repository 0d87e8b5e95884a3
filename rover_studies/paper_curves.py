"""Results of the paper's study as curves over the slack value, and what numbers tell of them.

A *curve* belongs to a case (tether and bodies), a geometry, the tether's shape at the start and a
mesh. Scatter is told from a curve by its *response*: how far the attitude at the landing moves
when the slack value changes in its sixth decimal. Where that response exceeds a degree, the point
is no property of the slack value.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_studies.paper_plan import (
    HEIGHT,
    NUDGE,
    RELAXED,
    THRESHOLD,
    TURN,
    UNRELAXED,
    case_of,
)

Floats = NDArray[np.float64]

SCATTER: Final = math.radians(1.0)
"""Response [rad] beyond which a point is scatter."""


class Key(NamedTuple):
    """Which curve."""

    case: str
    geometry: str
    shape: str
    elements: int


@dataclass(frozen=True)
class Curve:
    """Jumps over the slack value; NaN where the rover did not land.

    Attributes:
        slack: dh/df, ascending, shape (N,).
        height: rise of Body 1 [m], shape (N,).
        turn: attitude variation from take-off to landing [rad], shape (N,).
        stored: stretch energy of the starting shape [J], shape (N,).
        released: energy of the take-off [J].
        drift: what the energy balance misses at the landing [J], shape (N,).
        response: change of `turn` under the nudge [rad], shape (N,); NaN where not run.
        halved_height, halved_turn: the same jumps with half the time step; NaN where not run.
    """

    slack: Floats
    height: Floats
    turn: Floats
    stored: Floats
    released: float
    drift: Floats
    response: Floats
    halved_height: Floats
    halved_turn: Floats

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Where the slack value exceeds the paper's threshold."""
        return self.slack > THRESHOLD + 1e-9

    @property
    def scattered(self) -> NDArray[np.bool_]:
        """Where the response exceeds the limit."""
        return np.nan_to_num(self.response) > SCATTER

    @property
    def onset(self) -> float | None:
        """Slack value from which at least half of all further points are scatter, if any."""
        scattered = self.scattered
        for index in np.flatnonzero(scattered):
            if scattered[index:].mean() >= 0.5:
                return float(self.slack[index])
        return None


Curves = Mapping[Key, Curve]


def curves_of(
    jumps: Iterable[Mapping[str, Any]],
    nudged: Iterable[Mapping[str, Any]] = (),
    halved: Iterable[Mapping[str, Any]] = (),
) -> dict[Key, Curve]:
    """Gather rows of the study's sweeps into curves, in the order of the rows."""
    moved = _by_point(nudged, NUDGE)
    finer = _by_point(halved)
    found: dict[Key, list[Mapping[str, Any]]] = {}
    for row in jumps:
        found.setdefault(_key(row), []).append(row)
    return {key: _curve(key, rows, moved, finer) for key, rows in found.items()}


_Points = Mapping[tuple[Key, float], Mapping[str, Any]]


def _key(row: Mapping[str, Any]) -> Key:
    return Key(
        case_of(row), row["start.geometry"], row["start.initial_shape"], row["tether.elements"]
    )


def _by_point(rows: Iterable[Mapping[str, Any]], shift: float = 0.0) -> _Points:
    return {(_key(row), round(row["start.slack"] - shift, 9)): row for row in rows}


def _curve(key: Key, rows: list[Mapping[str, Any]], moved: _Points, finer: _Points) -> Curve:
    rows = sorted(rows, key=lambda row: float(row["start.slack"]))
    slack = _column(rows, "start.slack")
    places = [(key, round(float(value), 9)) for value in slack]
    turn = _column(rows, TURN)
    halves = [finer.get(place, {}) for place in places]
    nudges = [moved.get(place, {}) for place in places]
    released = _column(rows, "take_off_energy_J")
    return Curve(
        slack=slack,
        height=_column(rows, HEIGHT),
        turn=turn,
        stored=_column(rows, "initial_axial_energy_J"),
        released=float(np.nanmax(released)) if np.isfinite(released).any() else math.nan,
        drift=_column(rows, "energy_drift_J"),
        response=np.abs(_column(nudges, TURN) - turn),
        halved_height=_column(halves, HEIGHT),
        halved_turn=_column(halves, TURN),
    )


def _column(rows: Iterable[Mapping[str, Any]], name: str) -> Floats:
    values = [row.get(name) for row in rows]
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


# --- how far one can trust the numbers ------------------------------------------------------------


@dataclass(frozen=True)
class Convergence:
    """How far a mesh is from the finest one, over all slack values of a curve.

    Attributes:
        key: which curve.
        height: median and largest difference of the heights [m].
        turn: median and largest difference of the attitude variations [rad].
        step_height, step_turn: median difference that half the time step makes.
        drift: largest share of the energy that the balance misses, of take-off and stretch.
        stored: largest stretch energy of the start, over the jump's [-].
    """

    key: Key
    height: tuple[float, float]
    turn: tuple[float, float]
    step_height: float
    step_turn: float
    drift: float
    stored: float


def convergence(curves: Curves) -> list[Convergence]:
    """Of every curve, against the finest mesh of its case, geometry and shape."""
    finest: dict[tuple[str, str, str], Key] = {}
    for key in curves:
        group = (key.case, key.geometry, key.shape)
        if group not in finest or key.elements > finest[group].elements:
            finest[group] = key
    found = []
    for key, curve in curves.items():
        best = curves[finest[key.case, key.geometry, key.shape]]
        height, turn = np.abs(curve.height - best.height), np.abs(curve.turn - best.turn)
        in_play = curve.released + curve.stored
        found.append(
            Convergence(
                key,
                (_median(height), _largest(height)),
                (_median(turn), _largest(turn)),
                _median(np.abs(curve.halved_height - curve.height)),
                _median(np.abs(curve.halved_turn - curve.turn)),
                _largest(np.abs(curve.drift) / in_play),
                _largest(curve.stored / curve.released),
            )
        )
    return found


def _median(values: Floats) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan


def _largest(values: Floats) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else math.nan


# --- what the scatter goes with -------------------------------------------------------------------


@dataclass(frozen=True)
class Share:
    """Scatter of one shape on one mesh, all cases and geometries together.

    Attributes:
        shape, elements: which.
        points: slack values beyond the paper's threshold.
        scattered: how many of them are scatter.
        below: how many are, of the points up to the threshold.
        points_below: how many there are.
        onsets: slack value from which scatter prevails, by case and geometry.
    """

    shape: str
    elements: int
    points: int
    scattered: int
    below: int
    points_below: int
    onsets: Mapping[str, float]


@dataclass(frozen=True)
class Attribution:
    """What the scatter beyond the threshold goes with, by numbers.

    Attributes:
        shares: scatter by shape and mesh.
        separation: probability that a scattered point's starting shape stores more spurious
            stretch than a point without scatter does (area under the ROC curve).
        least_stored: smallest share of the jump's energy that a scattered point's start stores.
        findings: conditions that "the unrelaxed coarse mesh makes it" needs, each with its
            numbers and whether it holds.
    """

    shares: tuple[Share, ...]
    separation: float
    least_stored: float
    findings: tuple[tuple[str, bool], ...]

    @property
    def mesh_is_the_cause(self) -> bool:
        """Whether every condition holds."""
        return all(holds for _, holds in self.findings)


def attribution(curves: Curves) -> Attribution:
    """Find out what the scatter goes with.

    Points are those that were nudged. Nothing of the expected answer enters: the conditions are
    evaluated for whatever shapes and meshes the curves hold.
    """
    known = {key: curve for key, curve in curves.items() if np.isfinite(curve.response).any()}
    shares = tuple(
        _share(known, shape, elements)
        for shape in (RELAXED, UNRELAXED)
        for elements in sorted({key.elements for key in known})
    )
    scattered = np.concatenate([curve.scattered for curve in known.values()] or [np.zeros(0, bool)])
    stored = np.concatenate(
        [curve.stored / curve.released for curve in known.values()] or [np.zeros(0)]
    )
    separation = _separation(stored[scattered], stored[~scattered])
    least = float(stored[scattered].min()) if scattered.any() else math.nan
    findings = [*_findings(shares, separation), *_of_the_integrator(known)]
    return Attribution(shares, separation, least, tuple(findings))


def _share(curves: Curves, shape: str, elements: int) -> Share:
    chosen = {
        key: curve
        for key, curve in curves.items()
        if key.shape == shape and key.elements == elements
    }
    onsets = {f"{key.case} {key.geometry}": curve.onset for key, curve in chosen.items()}
    return Share(
        shape,
        elements,
        points=sum(int(curve.beyond.sum()) for curve in chosen.values()),
        scattered=sum(int((curve.scattered & curve.beyond).sum()) for curve in chosen.values()),
        below=sum(int((curve.scattered & ~curve.beyond).sum()) for curve in chosen.values()),
        points_below=sum(int((~curve.beyond).sum()) for curve in chosen.values()),
        onsets={name: onset for name, onset in onsets.items() if onset is not None},
    )


def _separation(above: Floats, below: Floats) -> float:
    """Probability that a value of the one set exceeds a value of the other, ties half."""
    if not len(above) or not len(below):
        return math.nan
    ordered = np.sort(below)
    less = np.searchsorted(ordered, above, "left")
    same = np.searchsorted(ordered, above, "right") - less
    return float((less + 0.5 * same).mean() / len(below))


def _findings(shares: tuple[Share, ...], separation: float) -> Iterable[tuple[str, bool]]:
    relaxed = [share for share in shares if share.shape == RELAXED]
    unrelaxed = [share for share in shares if share.shape == UNRELAXED]
    if not relaxed or not unrelaxed:
        return
    coarse, fine = unrelaxed[0], unrelaxed[-1]
    rates = [share.scattered / max(share.points, 1) for share in unrelaxed]
    shown = ", ".join(
        f"{rate:.0%} at n = {share.elements}" for rate, share in zip(rates, unrelaxed, strict=True)
    )
    touched = len(coarse.onsets)
    yield (
        (
            f"There is scatter beyond {THRESHOLD:g}: the unrelaxed tether of {coarse.elements}"
            f" elements scatters at {coarse.scattered} of {coarse.points} points, from a slack"
            f" value of"
            f" {_span(coarse.onsets)} on"
        ),
        coarse.scattered > 0.1 * coarse.points and touched > 0,
    )
    count = sum(share.scattered for share in relaxed)
    yield (
        (
            f"The same meshes in static equilibrium do not scatter: {count} of"
            f" {sum(share.points for share in relaxed)} points do"
        ),
        count == 0,
    )
    yield (
        f"The same unrelaxed shape stops scattering as the mesh is refined: {shown}",
        all(one >= other for one, other in itertools.pairwise(rates)) and fine.scattered == 0,
    )
    firsts = [min(share.onsets.values()) for share in unrelaxed if share.onsets]
    words = ", ".join(
        f"{min(share.onsets.values()):.3g} at n = {share.elements}"
        for share in unrelaxed
        if share.onsets
    )
    yield (
        (
            f"The slack value at which it begins moves with the mesh, so it is none of the"
            f" tether's:"
            f" {words or 'nowhere'}"
        ),
        len(firsts) > 1 and all(one < other for one, other in itertools.pairwise(firsts)),
    )
    yield (
        (
            "The stretch that the starting shape stores tells scatter from curve: a scattered"
            " point's"
            f" exceeds an orderly one's with probability {separation:.3f}"
        ),
        separation > 0.95,
    )


def _of_the_integrator(curves: Curves) -> Iterable[tuple[str, bool]]:
    """Whether half the time step removes the scatter, and whether the energy balance closes."""
    spreads = []
    worst = 0.0
    for curve in curves.values():
        both = curve.scattered & np.isfinite(curve.halved_turn)
        if both.sum() > 1:
            spreads.append((curve.turn[both].std(), curve.halved_turn[both].std()))
        worst = max(worst, _largest(np.abs(curve.drift) / (curve.released + curve.stored)))
    if not spreads:
        return
    whole, half = np.sqrt(np.mean(np.square(spreads), axis=0))
    yield (
        (
            f"It is not the integrator: with half the time step the scattered points still"
            f" spread by"
            f" {half:.2f} rad (deviation; {whole:.2f} rad with the whole step), and the energy"
            f" balance"
            f" of every jump closes to {worst:.0e} of the energy in play"
        ),
        bool(half > whole / 3.0 and worst < 1e-5),
    )


def _span(onsets: Mapping[str, float]) -> str:
    if not onsets:
        return "nowhere"
    low, high = min(onsets.values()), max(onsets.values())
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
