"""What hangs on the tether, weighed by the load cell at the fairlead. Pure.

The cell feels the rover's weight and the tether's, (m + rho l) g, with the swing's own rhythm,
what the tether bounces, and what the winch's acceleration adds. All these come and go within
seconds; the mass stays.
"""

from __future__ import annotations

from rover_control.hanging_rover import HangingParameters

_TIME = 15.0  # over which the tension is averaged [s]
MAX_MASS_RATIO = 1.5  # part of the mass that is known, that is believed, and its inverse


class SuspendedMassEstimator:
    """Weighs the rover.

    Args:
        hanging: what is known of it.
    """

    def __init__(self, hanging: HangingParameters) -> None:
        self.hanging = hanging
        self.restart()

    def restart(self) -> None:
        """Forget what was weighed."""
        self._averaging_time = 0.0  # [s]
        self._mass = self.hanging.rover_mass

    def update(self, tension: float, length: float, h: float) -> None:
        """Take a reading.

        Args:
            tension: at the fairlead [N].
            length: of the tether [m].
            h: since the last reading [s], above 0.
        """
        mass = tension / self.hanging.rover_gravity - self.hanging.tether_density * length
        self._averaging_time += h
        # A mean at first, then one that forgets.
        self._mass += min(h / min(self._averaging_time, _TIME), 1.0) * (mass - self._mass)

    @property
    def ratio(self) -> float:
        """The rover's mass over what is known of it; 1 where nothing was weighed for long enough.

        What no rover that hangs weighs, as one that stands, is not believed.
        """
        ratio = self._mass / self.hanging.rover_mass
        believed = self._averaging_time >= _TIME and 1.0 / MAX_MASS_RATIO <= ratio <= MAX_MASS_RATIO
        return ratio if believed else 1.0
