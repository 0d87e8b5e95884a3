"""Turn of the rover about the tether, and the twist that it leaves in the tether. Pure."""

from __future__ import annotations

import math

from rover_control.hanging.hanging_rover import HangingParameters


class TetherTurn:
    """Turn of the rover against the fairlead.

    The swivel lets through what its friction does not hold: the twist is at most the friction over
    the torsional stiffness, which falls with the length.

    Args:
        hanging: rover and tether.

    Attributes:
        angle: of the rover about the plumb line since the start: its unwrapped heading [rad].
        twist: of the tether [rad].
    """

    def __init__(self, hanging: HangingParameters) -> None:
        self.hanging = hanging
        self.angle = self.twist = 0.0

    def add(self, turned: float, length: float) -> None:
        """Turn the rover by an angle [rad] on a tether of this length [m]; NaN = unknown."""
        self.angle += turned
        self.twist += turned
        torsion = self.hanging.torsional_stiffness(length)
        most = self.hanging.swivel_friction / torsion if torsion > 0.0 else math.inf
        self.twist = min(max(self.twist, -most), most)

    def correct(self, change: float) -> None:
        """Correct the twist alone by an angle [rad]."""
        self.twist += change
