"""Profile of the sum of squares along one parameter.

Least squares may end in a local minimum, whose curvature does not show others. Example: the
readings of a tether that buckled while slack change non-monotonically with its damping, and two
damping values fit nearly alike. A poorly known parameter is therefore moved through its range while
the others are re-estimated. Values whose rise of the sum of squares is within chance belong to the
interval (the likelihood-ratio confidence set: Seber and Wild 2003, Nonlinear Regression, ch. 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rover_bags.identification.noise import Floats


@dataclass(frozen=True)
class Profile:
    """Rise of the sum of squares along one parameter.

    Attributes:
        offsets: offsets of its logarithm from the best fit, ascending, including 0, (n,).
        rises: rises of the sum of squares with the other unknowns re-estimated, (n,).
    """

    offsets: Floats
    rises: Floats

    @property
    def best(self) -> tuple[float, float]:
        """The lowest point: its offset, and its depth below the fit."""
        place = int(np.argmin(self.rises))
        return float(self.offsets[place]), -float(self.rises[place])

    def reach(self, limit: float) -> tuple[float, float]:
        """Return the outermost offsets that fit.

        Args:
            limit: number of standard errors; a point fits if its rise is at most their square.

        Returns:
            Lower and upper offset; infinite if the end of the range still fits.
        """
        depths = np.sqrt(np.maximum(self.rises, 0.0))
        fits = np.flatnonzero(depths <= limit)
        first, last = int(fits[0]), int(fits[-1])
        return self._crossing(first, first - 1, depths, limit), self._crossing(
            last, last + 1, depths, limit
        )

    def others(self, limit: float) -> Floats:
        """Return the offsets of the minima of all fitting regions that do not contain the fit."""
        fits = self.rises <= limit**2
        regions = np.cumsum(np.diff(fits, prepend=False))
        own = regions[np.flatnonzero(self.offsets == 0.0)[0]]
        found = []
        for region in np.unique(regions[fits]):
            if region != own:
                places = np.flatnonzero(fits & (regions == region))
                found.append(self.offsets[places[np.argmin(self.rises[places])]])
        return np.array(found)

    def _crossing(self, inside: int, outside: int, depths: Floats, limit: float) -> float:
        """Offset at which the limit is crossed between two neighbours."""
        if not 0 <= outside < len(self.offsets):
            return math.copysign(math.inf, outside - inside)
        share = (limit - depths[inside]) / (depths[outside] - depths[inside])
        apart = self.offsets[outside] - self.offsets[inside]
        return float(self.offsets[inside] + share * apart)
