"""Estimate of the suspended mass from the load cell at the fairlead. Pure.

The mean tension is (m + rho l) g. Swing, bounce and winch acceleration add only oscillations of
seconds, which an average removes.
"""

from __future__ import annotations

from rover_control.hanging.hanging_rover import HangingParameters

_TIME = 15.0  # averaging time of the tension [s]
_LEAST_BORNE = 0.5  # part of the nominal mass that a tether bears, at least, if the rover hangs
MAX_MASS_RATIO = 1.5  # largest plausible ratio to the nominal mass, and its inverse


class SuspendedMassEstimator:
    """Estimates the mass of the hanging rover.

    Args:
        hanging: nominal mass properties.
    """

    def __init__(self, hanging: HangingParameters) -> None:
        self.hanging = hanging
        self.restart()

    def restart(self) -> None:
        """Restart the average."""
        self._averaging_time = 0.0  # [s]
        self._mass = self.hanging.rover_mass

    def update(self, tension: float, length: float, h: float) -> None:
        """Update with a reading of the load cell.

        Args:
            tension: at the fairlead [N].
            length: of the tether [m].
            h: since the last reading [s], above 0.
        """
        self._averaging_time += h
        # Arithmetic mean at first, then a low-pass.
        fraction = min(h / min(self._averaging_time, _TIME), 1.0)
        self._mass += fraction * (self._mass_on(tension, length) - self._mass)

    def hangs(self, tension: float, length: float) -> bool:
        """Whether a tether of a length [m] with a tension [N] bears the rover."""
        return self._mass_on(tension, length) > _LEAST_BORNE * self.hanging.rover_mass

    def _mass_on(self, tension: float, length: float) -> float:
        return tension / self.hanging.rover_gravity - self.hanging.tether_density * length

    @property
    def ratio(self) -> float:
        """Estimated over nominal mass; 1 before the average is long enough.

        An implausible ratio, as of a standing rover, also gives 1.
        """
        ratio = self._mass / self.hanging.rover_mass
        is_plausible = (
            self._averaging_time >= _TIME and 1.0 / MAX_MASS_RATIO <= ratio <= MAX_MASS_RATIO
        )
        return ratio if is_plausible else 1.0
