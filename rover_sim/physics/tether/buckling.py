"""What an element carries in compression: the load at which the tether buckles, and little beyond.

A tether that is pushed together buckles between the nodes of a coarse mesh, and an exactly straight
mesh does not buckle at all, however fine. As in tension field theory, the strain energy of such a
member is replaced by that of its buckled state (Pipkin 1986, IMA J. Applied Mathematics 36). The
element's mean strain m = int eps dxi, Green's, has the energy per length EA w(m) in place of
EA m^2/2, and the differences eps - m inside the element keep theirs:

    w(m) = m^2/2                                  in tension,
    w(m) = m^2/2 - (1 - k) c^2 (f - 1)^2/2        in compression,    f = sqrt(1 + m^2/c^2),

so the mean force EA w'(m) = EA ((1 - k) m/f + k m) has the stiffness EA at small strain and tends
to the buckling load P = EA c, then grows by P/2 per strain, k = c/2, as the post-buckling load of
the hinged column does (Timoshenko and Gere 1961, Theory of Elastic Stability, section 2.7). P is
the sum of Euler's loads of two hinged columns,

    P = pi^2 EI (1/l^2 + 1/b^2),    b = (EI/(rho A g))^(1/3).

The mesh resolves longer waves than the element's length l and buckles by itself at lower loads. The
length b is that at which weight and bending stiffness balance (Greenhill 1881, Proceedings of the
Cambridge Philosophical Society 4: a column stands up to 1.99 b); a coarse element carries no less.

Functions are per EA. `limit` is c; with `NO_BUCKLING` the law is linear, k = 1. A step has the mean
strain m0 at its start and the increment dm.
"""

import math
from typing import Any

import numpy as np

from rover_sim.physics.numerics.compiled import inner, kernel
from rover_sim.physics.numerics.simd import fill, larger, magnitude, root
from rover_sim.physics.tether.tether_section import TetherSection

NO_BUCKLING = 2.0  # c of a tether that carries any compression [-]
SMALLEST_LIMIT = 1.0e-9  # c of a tether without bending stiffness [-]
_TINY = 1.0e-200  # keeps quotients of a vanishing increment finite
_SMALL_INCREMENT = 1.0e-3  # increment over c below which the derivative is a mean of both ends


def buckling_strain(section: TetherSection, element_length: float, gravity: float) -> float:
    """Return the strain c = P/EA [-] at the buckling load.

    Args:
        section: of the tether.
        element_length: l [m].
        gravity: g [m/s^2].
    """
    if not section.buckles:
        return NO_BUCKLING
    weight = section.line_density * gravity
    waves = 1.0 / element_length**2
    if section.bending_stiffness > 0.0:
        waves += (weight / section.bending_stiffness) ** (2.0 / 3.0)
    load = math.pi**2 * section.bending_stiffness * waves
    return min(max(load / section.axial_stiffness, SMALLEST_LIMIT), NO_BUCKLING)


@inner
def _share(limit: float) -> float:
    """1 - k [-]."""
    return 1.0 - min(0.5 * limit, 1.0)


@inner
def _bend(strain: float, limit: float) -> tuple[float, float]:
    """m/c in compression, else 0; and f."""
    x = min(strain, 0.0) / limit
    return x, np.sqrt(1.0 + x * x)


@kernel
def released_energy(strain: float, limit: float) -> float:
    """w(m) - m^2/2 [-], at most 0."""
    _, f = _bend(strain, limit)
    return -0.5 * _share(limit) * (limit * (f - 1.0)) ** 2


@kernel
def relief(strain: float, limit: float) -> float:
    """w'(m) - m [-], at least 0: by what the buckled element pushes less."""
    x, f = _bend(strain, limit)
    return -_share(limit) * limit * (f - 1.0) * x / f


@kernel
def relief_slope(strain: float, limit: float) -> float:
    """w''(m) - 1 [-], from -1 to 0."""
    _, f = _bend(strain, limit)
    return _share(limit) * (1.0 / (f * f * f) - 1.0)


@inner
def _negative(tag: Any, packet: Any) -> Any:
    """min(x, 0) of a packet."""
    return fill(tag, 0.0) - larger(fill(tag, 0.0) - packet, fill(tag, 0.0))


@inner
def mean_relief(
    tag: Any, strain: Any, increment: Any, delay: float, limit: float
) -> tuple[Any, Any]:
    """Relief averaged over a step, and its derivative with respect to the increment [-].

    The average is the discrete gradient of w (Gonzalez 1996, J. Nonlinear Science 6) from the
    strain m0 + d dm to m0 + (1 + d) dm. With the delay d = 0 the work of the mean force is the
    change of the energy exactly. A delay is damping: in tension it adds the force EA d dm, in
    compression the total never exceeds what the buckled element carries; as w' grows with m, it
    always dissipates.

    Args:
        tag: see `simd`.
        strain: m0 of elements, a packet [-].
        increment: dm, a packet [-].
        delay: d = x/2 + tau_a/h [-].
        limit: c [-].
    """
    first = strain + delay * increment
    last = first + increment
    one, tiny = fill(tag, 1.0), fill(tag, _TINY)
    size = magnitude(increment)
    # the part of the increment in compression
    positive = magnitude(larger(last, fill(tag, 0.0)) - larger(first, fill(tag, 0.0)))
    part = one - positive / larger(size, tiny)
    inverse = 1.0 / limit
    x0, x1 = inverse * _negative(tag, first), inverse * _negative(tag, last)
    f0, f1 = root(one + x0 * x0), root(one + x1 * x1)
    scale = limit * (1.0 - min(0.5 * limit, 1.0))
    both = f0 + f1
    value = (-0.5 * scale) * part * (x0 + x1) * (both - 2.0) / both
    inverse0, inverse1 = one / f0, one / f1
    # The difference of the ends' forces is exact, but for a small increment mostly rounding.
    change = delay * (f0 - 1.0) * x0 * inverse0 - (1.0 + delay) * (f1 - 1.0) * x1 * inverse1
    exact = (scale * change - value) * increment / larger(increment * increment, tiny)
    cubes = inverse0 * inverse0 * inverse0 + inverse1 * inverse1 * inverse1
    rough = ((0.5 + delay) * scale * inverse) * (0.5 * cubes - one)
    trust = size / larger(size, fill(tag, _SMALL_INCREMENT * limit))
    return value, rough + trust * (exact - rough)


@inner
def released_in_step(tag: Any, strain: Any, increment: Any, limit: float) -> Any:
    """Change of `released_energy` in a step, by elements in a packet."""
    inverse = 1.0 / limit
    x0, x1 = inverse * _negative(tag, strain), inverse * _negative(tag, strain + increment)
    before, after = root(1.0 + x0 * x0) - 1.0, root(1.0 + x1 * x1) - 1.0
    unit = 0.5 * limit * limit * (1.0 - min(0.5 * limit, 1.0))
    return unit * (before * before - after * after)
