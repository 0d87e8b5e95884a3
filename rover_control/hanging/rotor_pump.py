"""Rotor pumping: damping of the swing, and torque about the plumb line. Pure.

A rotor whose momentum h changes tilts the rover and so displaces its weight against the tether: the
force -h'/(l + d) acts on the pendulum. A momentum in phase with the displacement, h = H x/A_x, acts
against the velocity and reduces the amplitude along base_link x by

    dA_x/dt = -H/(2 m (l + d)^2).

No internal torque changes the total angular momentum about the plumb line, of the swing,
m (l + d)^2 (x y' - y x'), and of the rover's spin: the tether's pull has no lever arm about that
line. Rotors can exchange it between the two. Momenta at right angles to the swing rate,

    h_x = g y',   h_y = -g x',

turn the rover about the plumb line with the torque g |u'|^2 and the swing with its opposite. On a
long tether this hardly changes the swing, as its inertia is m (l + d)^2.

The pump has two tasks: a torque about the plumb line, with priority, and with the remaining rotor
momentum damping of the plane part of the swing, which carries no momentum: with
r = (x y' - y x')/(w A_y^2), h_x = H (x - r y'/w)/A, which is zero on a circle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_damping import DampingParameters
from rover_control.hanging.swing_estimator import SwingEstimate

_TINY = 1e-12


class RotorMomenta(NamedTuple):
    """Momenta of both rotors in the axes of `hanging_rover`, and an integral."""

    x: float  # of the wheels [N m s]
    y: float  # of the flywheel [N m s]
    y_integral: float  # integral of the flywheel's momentum, about zero mean [N m s^2]


NO_MOMENTA = RotorMomenta(0.0, 0.0, 0.0)


class RotorPump:
    """Momenta of both rotors for swing and spin.

    Args:
        parameters: bounds.
        hanging: rover and tether.
    """

    def __init__(self, parameters: DampingParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging

    def bounds(self, swing: SwingEstimate, length: float) -> tuple[float, float]:
        """Largest momenta along x and y [N m s] for a swing on a tether of this length [m].

        The flywheel's is also bounded by the screw's travel, h/(I w) each way, and both by the rule
        that the swing changes little within a period.
        """
        p, w = self.parameters, swing.frequency
        travelled = p.pump_travel * w * self.hanging.flywheel_inertia
        change = (
            p.pump_momentum_fraction
            * self.hanging.pendulum_inertia(length)
            * w
            * swing.ellipse.major
        )
        return min(p.pump_momentum, change), min(p.flywheel_momentum, travelled, change)

    def largest_torque(self, swing: SwingEstimate, length: float) -> float:
        """Largest mean torque about the plumb line [N m] that this swing allows."""
        across = _amplitudes(swing)
        largest = self.bounds(swing, length)
        return 0.5 * swing.frequency * (largest[0] * across[1] + largest[1] * across[0])

    def momenta(
        self, swing: SwingEstimate, length: float, torque: float, *, damps: bool
    ) -> RotorMomenta:
        """Momentum setpoints of the rotors.

        Args:
            swing: estimate.
            length: payout [m].
            torque: on the rover about the plumb line, taken from the swing [N m].
            damps: also damp the plane part of the swing.
        """
        p, w = self.parameters, swing.frequency
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        fade = p.pump_fade_amplitude
        along = _amplitudes(swing)
        ax, ay = math.hypot(along[0], fade), math.hypot(along[1], fade)
        hx, hy = self.bounds(swing, length)
        # Gain at which a rotor saturates; the other one takes the rest.
        most_x, most_y = hx / (w * ay), hy / (w * ax)
        share_x, share_y = 0.5 * (w * along[1]) ** 2, 0.5 * (w * along[0]) ** 2
        gain_x, gain_y = _split(abs(torque), share_x, share_y, most_x, most_y)
        sign = math.copysign(1.0, torque)
        first, second = sign * gain_x * vy, -sign * gain_y * vx
        # As x'' = -w^2 x, the integral of x' is x, that of x is -x'/w^2.
        integral = -sign * gain_y * x
        if damps:
            spin = (x * vy - y * vx) / w
            plane_x, phase_x = x - spin / ay**2 * vy / w, vx / w + spin / ay**2 * y
            plane_y, phase_y = y + spin / ax**2 * vx / w, vy / w - spin / ax**2 * x
            left_x, left_y = hx - gain_x * w * ay, hy - gain_y * w * ax
            first += max(left_x, 0.0) * plane_x / max(math.hypot(plane_x, phase_x), fade)
            rest = max(left_y, 0.0) / max(math.hypot(plane_y, phase_y), fade)
            second += rest * plane_y
            integral -= rest * phase_y / w
        return RotorMomenta(min(max(first, -hx), hx), min(max(second, -hy), hy), integral)

    def induced_tilt_rate(self, momentum: float, frequency: float) -> float:
        """Tilt rate [rad/s] that pumping induces: p = -h'/(m g d), so w^2 h/(m g d)."""
        return frequency**2 * momentum / self.hanging.stiffness


def _amplitudes(swing: SwingEstimate) -> tuple[float, float]:
    """Swing amplitudes along x and y [rad]."""
    w = swing.frequency
    (x, y), (vx, vy) = swing.direction, swing.direction_rate
    return math.hypot(x, vx / w), math.hypot(y, vy / w)


def _split(
    torque: float, share_x: float, share_y: float, most_x: float, most_y: float
) -> tuple[float, float]:
    """Gains of both rotors that give a torque, or as much of it as they can."""
    gain = torque / max(share_x + share_y, _TINY)
    if gain > most_x:
        return most_x, min((torque - most_x * share_x) / max(share_y, _TINY), most_y)
    if gain > most_y:
        return min((torque - most_y * share_y) / max(share_x, _TINY), most_x), most_y
    return gain, gain
