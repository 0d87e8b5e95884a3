"""Curves of the paper's study over the slack value: convergence, scatter and its cause.

A *curve* has a case (tether and bodies), a geometry, an initial shape of the tether and a mesh.
The *response* of a point is the change of the landing attitude when the slack value changes in its
sixth decimal. A point with a response above one degree is scatter: it is not a function of the
slack value.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_studies.paper.paper_plan import (
    HEIGHT,
    RELAXED,
    SLACK_PERTURBATION,
    THRESHOLD,
    TURN,
    UNRELAXED,
    case_of,
)

Floats = NDArray[np.float64]

SCATTER: Final = math.radians(1.0)
"""Response [rad] beyond which a point is scatter."""


class Key(NamedTuple):
    """Identifies a curve."""

    case: str
    geometry: str
    shape: str
    elements: int


@dataclass(frozen=True)
class Curve:
    """Jumps over the slack value; NaN for jumps without a landing.

    Attributes:
        slack: dh/df, ascending, shape (N,).
        height: rise of Body 1 [m], shape (N,).
        turn: attitude variation from take-off to landing [rad], shape (N,).
        stored: stretch energy of the initial shape [J], shape (N,).
        released: energy at take-off [J].
        drift: residual of the energy balance at the landing [J], shape (N,).
        response: change of `turn` by the perturbation [rad], shape (N,); NaN where not run.
        halved_height, halved_turn: with half the time step; NaN where not run.
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
        """Slack value from which at least half of the following points are scatter, or None."""
        scattered = self.scattered
        for index in np.flatnonzero(scattered):
            if scattered[index:].mean() >= 0.5:
                return float(self.slack[index])
        return None


Curves = Mapping[Key, Curve]


def curves_of(
    jumps: Iterable[Mapping[str, Any]],
    perturbed: Iterable[Mapping[str, Any]] = (),
    halved: Iterable[Mapping[str, Any]] = (),
) -> dict[Key, Curve]:
    """Group rows of the study's sweeps into curves, in the order of the rows."""
    moved = _by_point(perturbed, SLACK_PERTURBATION)
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
    perturbations = [moved.get(place, {}) for place in places]
    released = _column(rows, "take_off_energy_J")
    return Curve(
        slack=slack,
        height=_column(rows, HEIGHT),
        turn=turn,
        stored=_column(rows, "initial_axial_energy_J"),
        released=float(np.nanmax(released)) if np.isfinite(released).any() else math.nan,
        drift=_column(rows, "energy_drift_J"),
        response=np.abs(_column(perturbations, TURN) - turn),
        halved_height=_column(halves, HEIGHT),
        halved_turn=_column(halves, TURN),
    )


def _column(rows: Iterable[Mapping[str, Any]], name: str) -> Floats:
    values = [row.get(name) for row in rows]
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


# --- convergence ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Convergence:
    """Differences of a mesh from the finest one, over all slack values of a curve.

    Attributes:
        key: of the curve.
        height: median and largest difference of the heights [m].
        turn: median and largest difference of the attitude variations [rad].
        step_height, step_turn: median difference with half the time step.
        drift: largest energy residual, over the energy of take-off and stretch [-].
        stored: largest initial stretch energy, over the energy of the jump [-].
    """

    key: Key
    height: tuple[float, float]
    turn: tuple[float, float]
    step_height: float
    step_turn: float
    drift: float
    stored: float


def convergence(curves: Curves) -> list[Convergence]:
    """Compare every curve with the finest mesh of its case, geometry and shape."""
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


# --- cause of the scatter ------------------------------------------------------------------------


@dataclass(frozen=True)
class ScatterShare:
    """Scatter of one shape on one mesh, over all cases and geometries.

    Attributes:
        shape, elements: shape and mesh.
        points: number of points beyond the paper's threshold.
        scattered: number of scattered points among them.
        below: number of scattered points up to the threshold.
        points_below: number of points up to the threshold.
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
    """Cause of the scatter beyond the threshold.

    Attributes:
        shares: scatter by shape and mesh.
        separation: probability that a scattered point's initial shape stores more stretch energy
            than that of a point without scatter (area under the ROC curve).
        conditions: conditions of "the unrelaxed coarse mesh is the cause": statement with values,
            and whether it holds.
    """

    shares: tuple[ScatterShare, ...]
    separation: float
    conditions: tuple[tuple[str, bool], ...]

    @property
    def mesh_is_the_cause(self) -> bool:
        """Whether every condition holds."""
        return all(holds for _, holds in self.conditions)


def attribution(curves: Curves) -> Attribution:
    """Determine the cause of the scatter.

    Only perturbed points count. The conditions are evaluated for all shapes and meshes of the
    curves, independent of the expected result.
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
    conditions = [*_conditions(shares, separation), *_of_the_integrator(known)]
    return Attribution(shares, separation, tuple(conditions))


def _share(curves: Curves, shape: str, elements: int) -> ScatterShare:
    chosen = {
        key: curve
        for key, curve in curves.items()
        if key.shape == shape and key.elements == elements
    }
    onsets = {f"{key.case} {key.geometry}": curve.onset for key, curve in chosen.items()}
    return ScatterShare(
        shape,
        elements,
        points=sum(int(curve.beyond.sum()) for curve in chosen.values()),
        scattered=sum(int((curve.scattered & curve.beyond).sum()) for curve in chosen.values()),
        below=sum(int((curve.scattered & ~curve.beyond).sum()) for curve in chosen.values()),
        points_below=sum(int((~curve.beyond).sum()) for curve in chosen.values()),
        onsets={name: onset for name, onset in onsets.items() if onset is not None},
    )


def _separation(above: Floats, below: Floats) -> float:
    """Return the probability that a value of one set exceeds one of the other; ties count half."""
    if not len(above) or not len(below):
        return math.nan
    ordered = np.sort(below)
    less = np.searchsorted(ordered, above, "left")
    same = np.searchsorted(ordered, above, "right") - less
    return float((less + 0.5 * same).mean() / len(below))


def _conditions(shares: tuple[ScatterShare, ...], separation: float) -> Iterable[tuple[str, bool]]:
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
            "Its onset moves with the mesh, so it is not a property of the tether:"
            f" {words or 'nowhere'}"
        ),
        len(firsts) > 1 and all(one < other for one, other in itertools.pairwise(firsts)),
    )
    yield (
        (
            "The stretch energy of the initial shape separates scatter from curve: a scattered"
            f" point's exceeds another's with probability {separation:.3f}"
        ),
        separation > 0.95,
    )


def _of_the_integrator(curves: Curves) -> Iterable[tuple[str, bool]]:
    """Test whether half the time step removes the scatter and the energy balance closes."""
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
            "The integrator is not the cause: with half the time step the standard deviation of"
            f" the scattered points is {half:.2f} rad ({whole:.2f} rad with the whole step), and"
            f" the energy balance of every jump closes to {worst:.0e} of the energy involved"
        ),
        bool(half > whole / 3.0 and worst < 1e-5),
    )


def _span(onsets: Mapping[str, float]) -> str:
    if not onsets:
        return "nowhere"
    low, high = min(onsets.values()), max(onsets.values())
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
