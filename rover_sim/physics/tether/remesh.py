"""Remeshing at the fairlead: the chain of elements grows and shrinks with the paid-out length.

The exit element (`variable_length`) extends from the fairlead to the chain's first node. When it is
too long, a new node splits one element of nominal length off it, for the chain: this preserves the
motion exactly, and the energy except in compression, where it depends on the elements' mean strains
(`buckling`). When it is too short, it is merged with the chain's first element: the node between
them is removed, and the new exit element extends to the next node, which keeps its position, slope
and rates. The free parameters of the merged element are the slope at the fairlead and its rate,
three components each:

- the slope minimises int |r - r_old|^2 ds, and is then corrected by the smallest change that
  preserves the mean of Green's strain: a merged bent tether would otherwise change its length, and
  the axial stiffness turns a small change of length into a large energy;
- the slope's rate is the projection of the old velocity field in the mass norm: it minimises
  int rhoA |v - v_old|^2 ds.

A single cubic cannot represent the field of two, so merging changes the energy slightly, by a high
power of the element's length. Both functions return the change. Splitting and then merging
reproduces the state.
"""

import math
from typing import NamedTuple

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.tether.ancf import GAUSS_POINTS, GAUSS_WEIGHTS, Array, curvature_functions
from rover_sim.physics.tether.buckling import released_energy
from rover_sim.physics.tether.tether import Tether
from rover_sim.physics.tether.variable_length import Coordinates, field_at

_POINTS = len(GAUSS_WEIGHTS)  # on each of the two elements that are merged
_CURVATURE = curvature_functions(GAUSS_POINTS, 1.0)


class _Span(NamedTuple):
    """One direction of an element: the arguments of `field_at`."""

    length: float  # undeformed [m]
    payout_rate: float  # of the material through its first node [m/s]
    e: Coordinates
    rate: Coordinates


@inner
def _exit_span(
    length: float, payout_rate: float, fairlead: Array, slope: float, rate: float, q: Array,
    v: Array, i: int, d: int,
) -> _Span:  # fmt: skip
    """Direction d of an exit element from the fairlead to the chain's node i."""
    return _Span(
        length,
        payout_rate,
        (fairlead[0, d], slope, q[d, i], q[3 + d, i]),
        (fairlead[1, d], rate, v[d, i], v[3 + d, i]),
    )


@inner
def _chain_span(length: float, q: Array, v: Array, d: int) -> _Span:
    """Direction d of the chain's first element."""
    return _Span(
        length,
        0.0,
        (q[d, 0], q[3 + d, 0], q[d, 1], q[3 + d, 1]),
        (v[d, 0], v[3 + d, 0], v[d, 1], v[3 + d, 1]),
    )


@inner
def _exit_spans(
    length: float, payout_rate: float, fairlead: Array, fairlead_slope: Array, q: Array, v: Array,
    i: int,
) -> tuple[_Span, _Span, _Span]:  # fmt: skip
    """Directions of an exit element from the fairlead to the chain's node i."""
    slope, rate = fairlead_slope[0], fairlead_slope[1]
    return (
        _exit_span(length, payout_rate, fairlead, slope[0], rate[0], q, v, i, 0),
        _exit_span(length, payout_rate, fairlead, slope[1], rate[1], q, v, i, 1),
        _exit_span(length, payout_rate, fairlead, slope[2], rate[2], q, v, i, 2),
    )


@inner
def _chain_spans(length: float, q: Array, v: Array) -> tuple[_Span, _Span, _Span]:
    """Directions of the chain's first element."""
    return _chain_span(length, q, v, 0), _chain_span(length, q, v, 1), _chain_span(length, q, v, 2)


@inner
def _field(span: _Span, s: float) -> tuple[float, float, float, float]:
    """Position, slope, velocity and its slope at the distance s [m] from the span's first node."""
    return field_at(span.length, s, span.payout_rate, span.e, span.rate)


@inner
def _energy(tether: Tether, spans: tuple[_Span, _Span, _Span]) -> float:
    """Energy of an element [J] by exact quadrature."""
    length = spans[0].length
    total, mean = 0.0, 0.0
    for g in range(_POINTS):
        s = length * GAUSS_POINTS[g]
        square, density = 0.0, 0.0
        for d in range(3):
            span = spans[d]
            position, slope, speed, _ = _field(span, s)
            square += slope * slope
            density += tether.line_density * (0.5 * speed * speed - tether.gravity[d] * position)
            bend = 0.0
            for i in range(4):
                bend += _CURVATURE[g, i] * span.e[i] * (length if i % 2 == 1 else 1.0)
            density += 0.5 * tether.bending_stiffness * (bend / length**2) ** 2
        strain = 0.5 * (square - 1.0)
        mean += GAUSS_WEIGHTS[g] * strain
        density += 0.5 * tether.axial_stiffness * strain**2
        total += length * GAUSS_WEIGHTS[g] * density
    released = released_energy(mean, tether.buckling_strain)
    return total + tether.axial_stiffness * length * released


@inner
def split_first(
    tether: Tether,
    length: float,
    payout_rate: float,
    fairlead: Array,
    fairlead_slope: Array,
    q: Array,
    v: Array,
    anchors: Array,
) -> float:
    """Split an element of nominal length off the exit element, as the chain's new first one.

    Args:
        tether: the chain before the split, of n elements; element_length is the nominal length.
        length: undeformed length of the exit element, above element_length [m].
        payout_rate: v_pay [m/s].
        fairlead: position [m] and velocity [m/s] of the fairlead, in the first rows, (3, 3).
        fairlead_slope: slope and slope rate there, (2, 3).
        q: rows (6, width) of the chain's n + 1 nodes; changed: a node comes before the others.
        v: their rates; changed.
        anchors: of the contact points (2 n + 2 or more, 3); changed.

    Returns:
        Change of the tether's energy [J], without contact.
    """
    n = tether.elements
    left = length - tether.element_length
    spans = _exit_spans(length, payout_rate, fairlead, fairlead_slope, q, v, 0)
    before = _energy(tether, spans)
    for d in range(3):
        position, slope, speed, slope_speed = _field(spans[d], left)
        for k in (d, 3 + d):
            for i in range(n + 1, 0, -1):
                q[k, i], v[k, i] = q[k, i - 1], v[k, i - 1]
        q[d, 0], q[3 + d, 0], v[d, 0], v[3 + d, 0] = position, slope, speed, slope_speed
        for p in range(2 * n + 1, 1, -1):
            anchors[p, d] = anchors[p - 2, d]
        anchors[0, d], anchors[1, d] = 0.0, 0.0
    after = _energy(tether, _exit_spans(left, payout_rate, fairlead, fairlead_slope, q, v, 0))
    return after + _energy(tether, _chain_spans(tether.element_length, q, v)) - before


@inner
def _quadrature_point(length: float, nominal: float, k: int) -> tuple[float, float]:
    """Distance from the fairlead and weight [m] of quadrature point k of both elements."""
    g = k % _POINTS
    if k < _POINTS:
        return length * GAUSS_POINTS[g], length * GAUSS_WEIGHTS[g]
    return length + nominal * GAUSS_POINTS[g], nominal * GAUSS_WEIGHTS[g]


@inner
def _old_field(first: _Span, second: _Span, s: float) -> tuple[float, float, float, float]:
    """Field of the two elements to be merged, at the distance s [m] from the fairlead."""
    if s < first.length:
        return _field(first, s)
    return _field(second, s - first.length)


@inner
def _slope_shape(length: float, s: float) -> tuple[float, float]:
    """Shape function of an element's first slope, and its derivative."""
    xi = s / length
    return length * xi * (1.0 - xi) ** 2, (1.0 - xi) * (1.0 - 3.0 * xi)


@inner
def _fitted_slope(first: _Span, second: _Span, base: _Span) -> float:
    """Exit slope of the merged element by least squares of the positions; `base` has slope 0."""
    numerator, denominator = 0.0, 0.0
    for k in range(2 * _POINTS):
        s, weight = _quadrature_point(first.length, second.length, k)
        shape, _ = _slope_shape(base.length, s)
        numerator += weight * shape * (_old_field(first, second, s)[0] - _field(base, s)[0])
        denominator += weight * shape * shape
    return numerator / denominator


@inner
def _fitted_rate(first: _Span, second: _Span, base: _Span) -> float:
    """Exit slope's rate by least squares of the velocities; `base` has rate 0."""
    numerator, denominator = 0.0, 0.0
    for k in range(2 * _POINTS):
        s, weight = _quadrature_point(first.length, second.length, k)
        shape, _ = _slope_shape(base.length, s)
        numerator += weight * shape * (_old_field(first, second, s)[2] - _field(base, s)[2])
        denominator += weight * shape * shape
    return numerator / denominator


@inner
def _stretch_terms(first: _Span, second: _Span, merged: _Span) -> tuple[float, float, float]:
    """One direction's part of int r'.r' ds: excess over the old value, gradient and curvature.

    Gradient and curvature are the derivatives of half the integral with respect to the exit slope.
    """
    excess, gradient, curvature = 0.0, 0.0, 0.0
    for k in range(2 * _POINTS):
        s, weight = _quadrature_point(first.length, second.length, k)
        _, shape = _slope_shape(merged.length, s)
        new = _field(merged, s)[1]
        excess += weight * (new * new - _old_field(first, second, s)[1] ** 2)
        gradient += weight * shape * new
        curvature += weight * shape * shape
    return excess, gradient, curvature


@inner
def _restore_mean_strain(
    excess: float, gradient: tuple[float, float, float], curvature: float
) -> tuple[float, float, float]:
    """Smallest change of the exit slope that removes the excess, or minimises it."""
    steep = math.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    if not steep > 0.0:
        return 0.0, 0.0, 0.0
    move = -excess / (steep + math.sqrt(max(steep * steep - curvature * excess, 0.0)))
    return move * gradient[0] / steep, move * gradient[1] / steep, move * gradient[2] / steep


@inner
def merge_first(
    tether: Tether,
    length: float,
    payout_rate: float,
    fairlead: Array,
    fairlead_slope: Array,
    q: Array,
    v: Array,
    anchors: Array,
) -> float:
    """Merge the exit element and the chain's first one.

    The new exit element is longer by the tether's element_length.

    Args:
        tether: the chain before the merger, of n elements, 2 or more.
        length: undeformed length of the exit element [m].
        payout_rate: v_pay [m/s].
        fairlead: position [m] and velocity [m/s] of the fairlead, in the first rows, (3, 3).
        fairlead_slope: slope and slope rate there, (2, 3); changed.
        q: rows (6, width) of the chain's n + 1 nodes; changed: the first node is removed.
        v: their rates; changed.
        anchors: of the contact points (2 n or more, 3); changed: the first two are removed.

    Returns:
        Change of the tether's energy [J], without contact.
    """
    n = tether.elements
    nominal = tether.element_length
    merged_length = length + nominal
    first = _exit_spans(length, payout_rate, fairlead, fairlead_slope, q, v, 0)
    second = _chain_spans(nominal, q, v)
    change = -_energy(tether, first)
    change -= _energy(tether, second)

    excess, curvature = 0.0, 0.0
    for d in range(3):
        base = _exit_span(merged_length, payout_rate, fairlead, 0.0, 0.0, q, v, 1, d)
        fairlead_slope[0, d] = _fitted_slope(first[d], second[d], base)
        merged = _exit_span(
            merged_length, payout_rate, fairlead, fairlead_slope[0, d], 0.0, q, v, 1, d
        )
        more, fairlead_slope[1, d], curvature = _stretch_terms(first[d], second[d], merged)
        excess += more
    moves = _restore_mean_strain(
        excess, (fairlead_slope[1, 0], fairlead_slope[1, 1], fairlead_slope[1, 2]), curvature
    )
    for d in range(3):
        fairlead_slope[0, d] += moves[d]
        base = _exit_span(
            merged_length, payout_rate, fairlead, fairlead_slope[0, d], 0.0, q, v, 1, d
        )
        fairlead_slope[1, d] = _fitted_rate(first[d], second[d], base)
    merged_spans = _exit_spans(merged_length, payout_rate, fairlead, fairlead_slope, q, v, 1)
    change += _energy(tether, merged_spans)

    for d in range(3):
        for k in (d, 3 + d):
            for i in range(n):
                q[k, i], v[k, i] = q[k, i + 1], v[k, i + 1]
        for p in range(2 * n - 2):
            anchors[p, d] = anchors[p + 2, d]
        anchors[2 * n - 2, d], anchors[2 * n - 1, d] = 0.0, 0.0
    return change
