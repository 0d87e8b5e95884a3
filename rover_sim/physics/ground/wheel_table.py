"""Table of the stress integral of a wheel on soil, for the steps of the plant."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.ground.wheel_soil import DEEPEST, WheelOnSoil, stress_integral
from rover_sim.physics.numerics.compiled import inner, kernel

Array = NDArray[np.float64]

_ENTRY_CELLS = 56
_SLIP_CELLS = 96


class WheelTable(NamedTuple):
    """Table of the stress integral of one wheel on one soil; see `wheel_table`."""

    system: WheelOnSoil
    # X, Z, M over (entry, slip), each with its derivatives by entry, by slip and by both, in units
    # of a cell, (entry nodes, slip nodes, 3, 4) in one piece.
    nodes: Array
    # Work of Z without slip from the surface to each entry node [J], (entry nodes,).
    sinking_works: Array


def wheel_table(system: WheelOnSoil) -> WheelTable:
    """Tabulate the stress integral for bicubic interpolation, continuous with its derivatives.

    The table covers all slips, and sinkages up to 0.98 of the radius.
    """
    nodes = np.empty((_ENTRY_CELLS + 1, _SLIP_CELLS + 1, 3, 4))
    _fill_table(system, nodes, np.empty((3, 3, 3)))
    values, works = nodes.ravel(), np.zeros(_ENTRY_CELLS + 1)
    _fill_works(values, system.radius, works)
    return WheelTable(system, values, works)


@kernel
def _fill_table(system: WheelOnSoil, nodes: Array, around: Array) -> None:
    cell_entry = DEEPEST / _ENTRY_CELLS
    cell_slip = 2.0 / _SLIP_CELLS
    for i in range(_ENTRY_CELLS + 1):
        for j in range(_SLIP_CELLS + 1):
            entry = i * cell_entry
            slip = j * cell_slip - 1.0
            # differences around the node, one-sided towards the inside at the table's edges
            step_entry = 1.0e-4 * cell_entry
            step_slip = 1.0e-4 * cell_slip
            e0, e1 = (0 if i == 0 else -1), (0 if i == _ENTRY_CELLS else 1)
            s0, s1 = (0 if j == 0 else -1), (0 if j == _SLIP_CELLS else 1)
            for a in range(3):
                for b in range(3):
                    around[a, b] = stress_integral(
                        system,
                        entry + min(max(a - 1, e0), e1) * step_entry,
                        slip + min(max(b - 1, s0), s1) * step_slip,
                    )
            over_entry = 1.0e4 / (e1 - e0)
            over_slip = 1.0e4 / (s1 - s0)
            for c in range(3):
                nodes[i, j, c, 0] = around[1, 1, c]
                nodes[i, j, c, 1] = (around[2, 1, c] - around[0, 1, c]) * over_entry
                nodes[i, j, c, 2] = (around[1, 2, c] - around[1, 0, c]) * over_slip
                twist = around[2, 2, c] - around[0, 2, c] - around[2, 0, c] + around[0, 0, c]
                nodes[i, j, c, 3] = twist * over_entry * over_slip


@kernel
def _fill_works(nodes: Array, radius: float, works: Array) -> None:
    for i in range(_ENTRY_CELLS):
        works[i + 1] = works[i] + _work_in_cell(nodes, radius, i, 1.0)


@inner
def _work_in_cell(nodes: Array, radius: float, cell: int, a: float) -> float:
    """Work of Z without slip from the near node of an entry cell to the fraction a of it [J].

    Z is the table's cubic in a, and the sinkage z = 2 r e^2 at the entry e.
    """
    near = 12 * (cell * (_SLIP_CELLS + 1) + _SLIP_CELLS // 2) + 4
    far = near + 12 * (_SLIP_CELLS + 1)
    z0, slope0, z1, slope1 = nodes[near], nodes[near + 1], nodes[far], nodes[far + 1]
    second = 3.0 * (z1 - z0) - 2.0 * slope0 - slope1
    third = 2.0 * (z0 - z1) + slope0 + slope1
    by_cell = a * (z0 + a * (slope0 / 2.0 + a * (second / 3.0 + a * third / 4.0)))
    by_rest = a * a * (z0 / 2.0 + a * (slope0 / 3.0 + a * (second / 4.0 + a * third / 5.0)))
    width = DEEPEST / _ENTRY_CELLS
    return 4.0 * radius * width * width * (cell * by_cell + by_rest)


@inner
def sinking_work(table: WheelTable, sinkage: float) -> float:
    """Work [J] of the table's load Z without slip from the surface to a sinkage [m], >= 0."""
    a = math.sqrt(0.5 * sinkage / table.system.radius) * (_ENTRY_CELLS / DEEPEST)
    cell = min(int(a), _ENTRY_CELLS - 1)
    works = table.sinking_works[cell]
    return works + _work_in_cell(table.nodes, table.system.radius, cell, a - cell)


@inner
def look_up(nodes: Array, entry: float, slip: float) -> tuple[float, ...]:
    """Interpolate a table.

    Beyond the table's edge the entry is extrapolated from the last cell, the slip is limited to
    [-1, 1].

    Args:
        nodes: of a `WheelTable`.
        entry: sin(theta_1 / 2) = sqrt(z / 2r), >= 0.
        slip: s.

    Returns:
        X, dX/dentry, dX/ds, Z, dZ/dentry, dZ/ds [N], M, dM/dentry, dM/ds [N m].
    """
    a = entry * (_ENTRY_CELLS / DEEPEST)
    b = (min(max(slip, -1.0), 1.0) + 1.0) * (0.5 * _SLIP_CELLS)
    i = min(int(a), _ENTRY_CELLS - 1)
    j = min(int(b), _SLIP_CELLS - 1)
    a -= i
    b -= j
    # Hermite's weights of value and slope at the near and the far node, and their derivatives
    a1, b1 = a - 1.0, b - 1.0
    u0, u1, u2, u3 = (1.0 + 2.0 * a) * a1 * a1, a * a1 * a1, a * a * (3.0 - 2.0 * a), a * a * a1
    v0, v1, v2, v3 = (1.0 + 2.0 * b) * b1 * b1, b * b1 * b1, b * b * (3.0 - 2.0 * b), b * b * b1
    p0, p1, p3 = 6.0 * a * a1, a1 * (3.0 * a - 1.0), a * (3.0 * a - 2.0)
    q0, q1, q3 = 6.0 * b * b1, b1 * (3.0 * b - 1.0), b * (3.0 * b - 2.0)
    near = 12 * (i * (_SLIP_CELLS + 1) + j)
    far = near + 12 * (_SLIP_CELLS + 1)
    per_entry = _ENTRY_CELLS / DEEPEST
    per_slip = 0.5 * _SLIP_CELLS

    x = _channel(nodes, near, far, v0, v1, v2, v3, q0, q1, q3)
    z = _channel(nodes, near + 4, far + 4, v0, v1, v2, v3, q0, q1, q3)
    m = _channel(nodes, near + 8, far + 8, v0, v1, v2, v3, q0, q1, q3)
    return (
        u0 * x[0] + u1 * x[1] + u2 * x[2] + u3 * x[3],
        (p0 * (x[0] - x[2]) + p1 * x[1] + p3 * x[3]) * per_entry,
        (u0 * x[4] + u1 * x[5] + u2 * x[6] + u3 * x[7]) * per_slip,
        u0 * z[0] + u1 * z[1] + u2 * z[2] + u3 * z[3],
        (p0 * (z[0] - z[2]) + p1 * z[1] + p3 * z[3]) * per_entry,
        (u0 * z[4] + u1 * z[5] + u2 * z[6] + u3 * z[7]) * per_slip,
        u0 * m[0] + u1 * m[1] + u2 * m[2] + u3 * m[3],
        (p0 * (m[0] - m[2]) + p1 * m[1] + p3 * m[3]) * per_entry,
        (u0 * m[4] + u1 * m[5] + u2 * m[6] + u3 * m[7]) * per_slip,
    )


@inner
def _channel(
    t: Array,
    near: int,
    far: int,
    v0: float,
    v1: float,
    v2: float,
    v3: float,
    q0: float,
    q1: float,
    q3: float,
) -> tuple[float, ...]:
    """Interpolate one quantity along slip: value and entry slope at both entries, then d/ds."""
    return (
        v0 * t[near] + v1 * t[near + 2] + v2 * t[near + 12] + v3 * t[near + 14],
        v0 * t[near + 1] + v1 * t[near + 3] + v2 * t[near + 13] + v3 * t[near + 15],
        v0 * t[far] + v1 * t[far + 2] + v2 * t[far + 12] + v3 * t[far + 14],
        v0 * t[far + 1] + v1 * t[far + 3] + v2 * t[far + 13] + v3 * t[far + 15],
        q0 * (t[near] - t[near + 12]) + q1 * t[near + 2] + q3 * t[near + 14],
        q0 * (t[near + 1] - t[near + 13]) + q1 * t[near + 3] + q3 * t[near + 15],
        q0 * (t[far] - t[far + 12]) + q1 * t[far + 2] + q3 * t[far + 14],
        q0 * (t[far + 1] - t[far + 13]) + q1 * t[far + 3] + q3 * t[far + 15],
    )
