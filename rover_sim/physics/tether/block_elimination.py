"""Solve the block-tridiagonal equations of a chain of nodes, one block of m = 2 dim a node.

The equations of node i are

    L_i x_(i-1) + D_i x_i + U_i x_(i+1) = R_i,

and are stored as contributions of the elements, each with one side per node: side 0 holds the rows
of its first node (D, R, and U towards its second), side 1 those of its second node (D, R, and L
towards its first). The array `blocks` (n + 2 or more, 2, 2 m + 1, lanes) holds element e at e + 1;
the contributions of the chain's ends are its first and its last entry, as elements with one node.
The columns of a side are D (m), R (1), then the coupling (m), each a packet over the rows; surplus
lanes are zero.

Elimination runs from both ends towards the middle: two independent chains of operations, which the
processor overlaps, because each is bound by latency and not by throughput. Blocks are not pivoted:
inertia dominates D, and a step for which it does not fails and is repeated with half the length.
"""

from typing import Any

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.simd import fill, lane, load, stack, store, with_lane
from rover_sim.physics.tether.ancf import Array


def make_factor(nodes: int, columns: int, lanes: int) -> Array:
    """Allocate the scratch array (nodes + 2, m + 1, lanes) of `solve_blocks`; see `_eliminate`."""
    return np.zeros((nodes + 2, columns, lanes))


@inner
def _eliminate(
    tag: tuple[float, ...],
    blocks: Array,
    before: int,
    before_side: int,
    after: int,
    after_side: int,
    previous: int,
    node: int,
    factor: Array,
) -> None:
    """Express x of a node by x of the next node, in the direction of elimination.

    With the factors G, y of the previous node (x_before = y - G x) the node's equations are

        (D - C G) x + C' x_after = R - C y,

    where D and R are sums over the sides of the elements before and after, C and C' their
    couplings. Gauss-Jordan elimination of (D - C G | R - C y | C'), rows scaled last, gives y and
    G, stored as the columns (G, y) at factor[node].
    """
    m = 2 * len(tag)
    columns = stack(tag, 13)
    coupling = stack(tag, 6)
    for k in range(m):
        coupling[k] = load(tag, blocks, (before, before_side, m + 1 + k, 0))
        columns[m + 1 + k] = load(tag, blocks, (after, after_side, m + 1 + k, 0))
    for c in range(m + 1):
        column = load(tag, blocks, (before, before_side, c, 0))
        column += load(tag, blocks, (after, after_side, c, 0))
        for k in range(m):
            column -= coupling[k] * factor[previous, c, k]
        columns[c] = column
    inverses = fill(tag, 1.0)
    for k in range(m):
        inverse = 1.0 / lane(columns[k], k)
        inverses = with_lane(inverses, k, inverse)
        others = with_lane(columns[k] * inverse, k, 0.0)
        for c in range(k + 1, 2 * m + 1):
            columns[c] = columns[c] - others * lane(columns[c], k)
    store(factor, (node, m, 0), columns[m] * inverses)
    for k in range(m):
        store(factor, (node, k, 0), columns[m + 1 + k] * inverses)


@inner
def _fold(
    tag: tuple[float, ...], blocks: Array, element: int, side: int, previous: int, factor: Array
) -> None:
    """Subtract an eliminated neighbour's C G and C y from D and R of an element's side."""
    m = 2 * len(tag)
    for c in range(m + 1):
        column = load(tag, blocks, (element, side, c, 0))
        for k in range(m):
            column -= load(tag, blocks, (element, side, m + 1 + k, 0)) * factor[previous, c, k]
        store(blocks, (element, side, c, 0), column)


@inner
def _substitute(
    tag: tuple[float, ...], node: int, known: int, factor: Array, solution: Array
) -> None:
    """Compute the unknowns of a node from its solved neighbour: x = y - G x_known."""
    m = 2 * len(tag)
    result = load(tag, factor, (node, m, 0))
    for k in range(m):
        result -= load(tag, factor, (node, k, 0)) * solution[known, k]
    store(solution, (node, 0), result)


@inner
def solve_blocks(tag: Any, n: int, blocks: Array, factor: Array, solution: Array) -> None:
    """Solve for all nodes.

    Args:
        tag: a tuple whose length is dim, see `simd`.
        n: number of elements.
        blocks: the equations; one side of the middle element is changed.
        factor: (n + 3, m + 1, lanes); its first and last entries must be zero. Node i is at i + 1.
        solution: x, (n + 3, lanes); node i at i + 1.
    """
    middle = n // 2
    for i in range(n - middle):
        if i < middle:
            _eliminate(tag, blocks, i, 1, i + 1, 0, i, i + 1, factor)
        j = n - i
        behind = j + 1 if j < n else blocks.shape[0] - 1
        _eliminate(tag, blocks, behind, 0, j, 1, j + 2, j + 1, factor)
    _fold(tag, blocks, middle + 1, 0, middle + 2, factor)
    _eliminate(tag, blocks, middle, 1, middle + 1, 0, middle, middle + 1, factor)
    store(solution, (middle + 1, 0), load(tag, factor, (middle + 1, 2 * len(tag), 0)))
    for i in range(n - middle):
        if i < middle:
            _substitute(tag, middle - i, middle + 1 - i, factor, solution)
        j = middle + 1 + i
        _substitute(tag, j + 1, j, factor, solution)
