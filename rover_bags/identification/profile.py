"""How the sum of squares rises away from its minimum along one parameter.

Least squares end in a minimum, not necessarily in the least one, and the curvature there says
nothing of others: readings of a tether that buckled in a slack spell, for one, turn over as its
damping changes, and come out nearly as well with two values of it. A parameter that is known only
roughly is therefore moved through its whole range, the others following. What does not raise the
sum of squares by more than chance would belongs to the interval (the likelihood ratio's confidence
set: Seber and Wild 2003, Nonlinear Regression, ch. 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rover_bags.identification.noise import Floats


@dataclass(frozen=True)
class Profile:
    """Rises of the sum of squares along one parameter.

    Attributes:
        offsets: of its logarithm from the best fit, ascending and 0 among them, (n,).
        rises: of the sum of squares, the other unknowns having followed, (n,).
    """

    offsets: Floats
    rises: Floats

    @property
    def best(self) -> tuple[float, float]:
        """The lowest point: its offset, and by how much it lies below the fit."""
        place = int(np.argmin(self.rises))
        return float(self.offsets[place]), -float(self.rises[place])

    def reach(self, limit: float) -> tuple[float, float]:
        """Outermost offsets that fit.

        Args:
            limit: standard errors; what rises by more than their square does not fit.

        Returns:
            The lower and the upper one; infinite where the end of the range still fits.
        """
        depths = np.sqrt(np.maximum(self.rises, 0.0))
        fits = np.flatnonzero(depths <= limit)
        first, last = int(fits[0]), int(fits[-1])
        return self._crossing(first, first - 1, depths, limit), self._crossing(
            last, last + 1, depths, limit
        )

    def others(self, limit: float) -> Floats:
        """Offsets of the lowest points of all spells that fit but are not joined with the fit."""
        fits = self.rises <= limit**2
        spells = np.cumsum(np.diff(fits, prepend=False))
        own = spells[np.flatnonzero(self.offsets == 0.0)[0]]
        found = []
        for spell in np.unique(spells[fits]):
            if spell != own:
                places = np.flatnonzero(fits & (spells == spell))
                found.append(self.offsets[places[np.argmin(self.rises[places])]])
        return np.array(found)

    def _crossing(self, inside: int, outside: int, depths: Floats, limit: float) -> float:
        """Where the limit is passed between two neighbours."""
        if not 0 <= outside < len(self.offsets):
            return math.copysign(math.inf, outside - inside)
        share = (limit - depths[inside]) / (depths[outside] - depths[inside])
        apart = self.offsets[outside] - self.offsets[inside]
        return float(self.offsets[inside] + share * apart)
