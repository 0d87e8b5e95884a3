"""Splitting and merging at the fairlead: how the chain of elements grows and shrinks with payout.

The exit element (`variable_length`) runs from the fairlead to the chain's first node. When it has
become long, a new node cuts one element of nominal length off it, for the chain; this is exact.
When it has become short, it and the chain's first element are merged: the node between them goes,
and the new exit element runs from the fairlead to the next node, which keeps its place, slope and
rates. What is left to choose are three numbers each for place and motion, the slope at the
fairlead and its rate:

- the slope is the one whose shape comes closest to the old one, int |r - r_old|^2 ds least, then
  moved by as little as makes the mean of Green's strain the same. A bent piece of tether would
  otherwise be shortened or lengthened by the merger, and EA makes much of a small length;
- the slope's rate is the projection of the old velocity field in the norm of the mass,
  int rhoA |v - v_old|^2 ds least.

A single cubic cannot hold all that two held, so merging changes the energy by a little, which
falls with a high power of the element's length; the step is returned, to be booked. Merging what
has just been split gives back the same state.
"""

import math
from typing import NamedTuple

import numpy as np

from rover_sim.physics.ancf import GAUSS_POINTS, GAUSS_WEIGHTS, Array
from rover_sim.physics.compiled import allocating, kernel
from rover_sim.physics.tether import Tether
from rover_sim.physics.variable_length import exit_energies, field_at, split

_POINTS = len(GAUSS_WEIGHTS)  # on each of the two elements that are merged


class Remesh(NamedTuple):
    """Scratch arrays of splitting and merging in space."""

    e: Array  # coordinates of the exit element, (4, 3)
    rate: Array  # their rates, (4, 3)
    chain: Array  # coordinates of the chain's first element, (4, 3)
    chain_rate: Array  # their rates, (4, 3)
    merged: Array  # coordinates of the new exit element, (4, 3)
    merged_rate: Array  # their rates, (4, 3)
    node: Array  # (r, r') of a node, (6,)
    node_rate: Array  # its rates, (6,)


@allocating
def make_remesh() -> Remesh:
    """Allocate the arrays."""
    return Remesh(
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros(6),
        np.zeros(6),
    )


@kernel
def _gather(mouth: Array, q: Array, v: Array, node: int, e: Array, rate: Array) -> None:
    """Coordinates and rates of an element from the fairlead to a node."""
    for d in range(3):
        e[0, d], rate[0, d] = 0.0, 0.0
        e[1, d], rate[1, d] = mouth[0, d], mouth[1, d]
        e[2, d], rate[2, d] = q[d, node], v[d, node]
        e[3, d], rate[3, d] = q[3 + d, node], v[3 + d, node]


@kernel
def split_first(
    tether: Tether,
    length: float,
    payout_rate: float,
    mouth: Array,
    q: Array,
    v: Array,
    anchors: Array,
    n: int,
    work: Remesh,
) -> float:
    """Cut an element of nominal length off the exit element, as the chain's new first one.

    Args:
        tether: its element_length is what is cut off.
        length: undeformed length of the exit element, above element_length [m].
        payout_rate: v_pay [m/s].
        mouth: slope and slope rate at the fairlead, which is the origin, (2, 3).
        q: rows (6, width) of the chain's n + 1 nodes; changed: a node comes before the others.
        v: their rates; changed.
        anchors: of the contact points (2 n + 2 or more, 3); changed.
        n: elements of the chain before; q, v and anchors have room for one more.
        work: scratch.

    Returns:
        Length of the new exit element [m].
    """
    left = length - tether.element_length
    _gather(mouth, q, v, 0, work.e, work.rate)
    split(length, left, payout_rate, work.e, work.rate, work.node, work.node_rate)
    for k in range(6):
        for i in range(n + 1, 0, -1):
            q[k, i], v[k, i] = q[k, i - 1], v[k, i - 1]
        q[k, 0], v[k, 0] = work.node[k], work.node_rate[k]
    for d in range(3):
        for p in range(2 * n + 1, 1, -1):
            anchors[p, d] = anchors[p - 2, d]
        anchors[0, d], anchors[1, d] = 0.0, 0.0
    return left


@kernel
def _old_field(
    tether: Tether, length: float, payout_rate: float, k: int, d: int, work: Remesh
) -> tuple[float, float, float]:
    """Place, slope and velocity of the two elements to be merged, at point k of both together."""
    g = k % _POINTS
    if k < _POINTS:
        here, slope, speed, _ = field_at(
            length, length * GAUSS_POINTS[g], payout_rate, work.e, work.rate, d
        )
    else:
        nominal = tether.element_length
        here, slope, speed, _ = field_at(
            nominal, nominal * GAUSS_POINTS[g], 0.0, work.chain, work.chain_rate, d
        )
    return here, slope, speed


@kernel
def _point(tether: Tether, length: float, k: int) -> tuple[float, float]:
    """Distance from the fairlead and weight [m] of point k."""
    g = k % _POINTS
    if k < _POINTS:
        return length * GAUSS_POINTS[g], length * GAUSS_WEIGHTS[g]
    nominal = tether.element_length
    return length + nominal * GAUSS_POINTS[g], nominal * GAUSS_WEIGHTS[g]


@kernel
def _slope_shape(length: float, place: float) -> tuple[float, float]:
    """Shape function of an element's first slope, and its derivative."""
    xi = place / length
    return length * xi * (1.0 - xi) ** 2, (1.0 - xi) * (1.0 - 3.0 * xi)


@kernel
def _fit_shape(tether: Tether, length: float, payout_rate: float, work: Remesh) -> None:
    """Exit slope of the merged element: closest shape, then the same mean strain."""
    whole = length + tether.element_length
    for d in range(3):
        work.merged[1, d] = 0.0
        wanted, size = 0.0, 0.0
        for k in range(2 * _POINTS):
            s, weight = _point(tether, length, k)
            shape, _ = _slope_shape(whole, s)
            old, _, _ = _old_field(tether, length, payout_rate, k, d, work)
            held, _, _, _ = field_at(whole, s, 0.0, work.merged, work.merged_rate, d)
            wanted += weight * shape * (old - held)
            size += weight * shape * shape
        work.merged[1, d] = wanted / size

    # |r'|^2 integrated changes by 2 way.move + size move^2 with the slope
    way = (0.0, 0.0, 0.0)
    size, excess = 0.0, 0.0
    for k in range(2 * _POINTS):
        s, weight = _point(tether, length, k)
        _, shape = _slope_shape(whole, s)
        size += weight * shape * shape
        for d in range(3):
            _, old, _ = _old_field(tether, length, payout_rate, k, d, work)
            _, slope, _, _ = field_at(whole, s, 0.0, work.merged, work.merged_rate, d)
            excess += weight * (slope * slope - old * old)
            work.node[d] = slope
        way = (
            way[0] + weight * shape * work.node[0],
            way[1] + weight * shape * work.node[1],
            way[2] + weight * shape * work.node[2],
        )
    steep = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    if steep > 0.0:
        move = -excess / (steep + math.sqrt(max(steep * steep - size * excess, 0.0)))
        for d in range(3):
            work.merged[1, d] += move * way[d] / steep


@kernel
def _fit_motion(tether: Tether, length: float, payout_rate: float, work: Remesh) -> None:
    """Exit slope's rate of the merged element: closest velocities."""
    whole = length + tether.element_length
    for d in range(3):
        work.merged_rate[1, d] = 0.0
        wanted, size = 0.0, 0.0
        for k in range(2 * _POINTS):
            s, weight = _point(tether, length, k)
            shape, _ = _slope_shape(whole, s)
            _, _, old = _old_field(tether, length, payout_rate, k, d, work)
            _, _, held, _ = field_at(whole, s, payout_rate, work.merged, work.merged_rate, d)
            wanted += weight * shape * (old - held)
            size += weight * shape * shape
        work.merged_rate[1, d] = wanted / size


@kernel
def _energy(tether: Tether, length: float, payout_rate: float, e: Array, rate: Array) -> float:
    """Energy of an element [J]."""
    parts = exit_energies(tether, length, payout_rate, e, rate)
    return parts[0] + parts[1] + parts[2] + parts[3]


@kernel
def merge_first(
    tether: Tether,
    length: float,
    payout_rate: float,
    mouth: Array,
    q: Array,
    v: Array,
    anchors: Array,
    n: int,
    work: Remesh,
) -> tuple[float, float]:
    """Merge the exit element and the chain's first one.

    Args:
        tether: the chain.
        length: undeformed length of the exit element [m].
        payout_rate: v_pay [m/s].
        mouth: slope and slope rate at the fairlead, which is the origin, (2, 3); changed.
        q: rows (6, width) of the chain's n + 1 nodes; changed: the first of them goes.
        v: their rates; changed.
        anchors: of the contact points (2 n or more, 3); changed: the first two of them go.
        n: elements of the chain before, 2 or more.
        work: scratch.

    Returns:
        Length of the new exit element [m], and by what the tether's energy has changed [J].
    """
    whole = length + tether.element_length
    _gather(mouth, q, v, 0, work.e, work.rate)
    _gather(mouth, q, v, 1, work.chain, work.chain_rate)
    _gather(mouth, q, v, 1, work.merged, work.merged_rate)
    for d in range(3):
        for a in range(2):
            work.chain[a, d] = q[3 * a + d, 0]
            work.chain_rate[a, d] = v[3 * a + d, 0]
    _fit_shape(tether, length, payout_rate, work)
    _fit_motion(tether, length, payout_rate, work)
    change = _energy(tether, whole, payout_rate, work.merged, work.merged_rate)
    change -= _energy(tether, length, payout_rate, work.e, work.rate)
    change -= _energy(tether, tether.element_length, 0.0, work.chain, work.chain_rate)

    for d in range(3):
        mouth[0, d], mouth[1, d] = work.merged[1, d], work.merged_rate[1, d]
    for k in range(6):
        for i in range(n):
            q[k, i], v[k, i] = q[k, i + 1], v[k, i + 1]
    for d in range(3):
        for p in range(2 * n - 2):
            anchors[p, d] = anchors[p + 2, d]
        anchors[2 * n - 2, d], anchors[2 * n - 1, d] = 0.0, 0.0
    return whole, change
