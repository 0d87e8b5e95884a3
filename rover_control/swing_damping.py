"""Taking a swing away: by the winch's trim, and by the wheels' reaction. Pure.

Winch. A tether that is lengthened while the rover swings outward and shortened while it swings
inward works against the swing: with A^2 = |u|^2 + |u'|^2/w^2,

    dl = D 2 u.u'/(A^2 w),    which damps like the ratio 3/4 D/l.

It runs at twice the swing's frequency w, so D is bounded by the drum's rate, D <= v/2w, by its
acceleration, D <= 0.8 a/4w^2 (a trim that lags behind for want of it feeds the swing), and by
0.15 l. Around a circle u.u' = 0: the winch turns an ellipse into a circle and can do no more.

Wheels. A rotor whose momentum h changes tilts the rover, and so shifts its weight against the
tether: on the pendulum acts the force -h'/(l + d). Momentum in step with the displacement, h = H
x/A_x, is a force against the velocity, and takes from the amplitude along base_link x

    dA_x/dt = -H/(2 m (l + d)^2).

What no internal torque can take is the swing's angular momentum about the plumb line, m (l + d)^2 w
times the ellipse's two amplitudes: the tether's pull has no lever about that line, and a swivel
lets no torque through. Pumped away, it spins the rover instead, and that smears pictures as well.
So where pictures are meant, only that part of the pumping is used that leaves it alone: with the
momentum's share r = (x y' - y x')/(w A_y^2), h = H (x - r y'/w)/A, which is nothing on a circle.
Where none are meant, the rover may be spun up to a limit.

The same the other way round stops a rover that spins: h = -H y'/(w A_y) turns it by the mean torque
H w A_y/2 about the plumb line, which the swing takes up. On a long tether that changes the swing by
next to nothing, as its momentum has the lever (l + d)^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.machine import MAX_RATE_TRIM
from msg_schemas.parameters import parameter
from rover_control.hanging_rover import HangingParameters
from rover_control.swing_estimator import SwingEstimate


@dataclass(frozen=True)
class DampingParameters:
    """What winch and wheels may do against a swing."""

    trim_rate: float = parameter(0.28, "m/s", "largest rate of the trim", 0.01, MAX_RATE_TRIM)
    trim_acceleration: float = parameter(0.3, "m/s^2", "that the winch allows a trim", 0.01, 5.0)
    trim_share: float = parameter(0.15, "-", "largest trim as part of the length", 0.0, 0.5)
    trim_tracking: float = parameter(
        3.0, "-", "bandwidth of the trim's tracking over the swing's frequency", 0.5, 20.0
    )
    trim_fade: float = parameter(
        0.0005, "rad", "amplitude below which the trim fades out", 1e-6, 0.1
    )
    pump_momentum: float = parameter(
        0.022, "N m s", "largest momentum that the wheels pump with", 0.0, 1.0
    )
    pump_fade: float = parameter(
        0.001, "rad", "amplitude along x below which the pumping fades out", 1e-6, 0.1
    )
    yaw_band: float = parameter(
        0.002, "rad/s", "yaw rate that is worked against with all of the pumping", 1e-5, 1.0
    )
    spin_limit: float = parameter(
        0.8, "rad/s", "yaw rate up to which a cone may be turned into spin", 0.0, 10.0
    )


class TrimStroke(NamedTuple):
    """Amplitude D of the trim and what bounds it."""

    length: float  # [m]
    bound: str  # rate, acceleration or share


class WinchTrim:
    """Trim of the winch against a swing.

    Args:
        parameters: its bounds.
    """

    def __init__(self, parameters: DampingParameters) -> None:
        self.parameters = parameters

    def stroke(self, length: float, frequency: float) -> TrimStroke:
        """Amplitude D on so much tether [m] at a swing's frequency [rad/s]."""
        p = self.parameters
        return min(
            TrimStroke(p.trim_rate / (2.0 * frequency), "rate"),
            TrimStroke(0.8 * p.trim_acceleration / (4.0 * frequency**2), "acceleration"),
            TrimStroke(p.trim_share * length, "share"),
        )

    def decay(self, length: float, frequency: float) -> float:
        """Rate [1/s] at which the amplitude of a plane swing falls."""
        return 0.75 * self.stroke(length, frequency).length / length * frequency

    def rate(self, swing: SwingEstimate, length: float, offset: float) -> float:
        """Payout rate to add [m/s].

        Args:
            swing: as estimated.
            length: paid out without the trim [m].
            offset: length that the trim has added so far [m].
        """
        p, w = self.parameters, swing.frequency
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        along, square = x * vx + y * vy, x * x + y * y
        speed = (vx * vx + vy * vy) / (w * w)
        whole = square + speed
        if whole <= 0.0:
            return -p.trim_tracking * w * offset
        fade = min(1.0, math.sqrt(whole) / p.trim_fade - 1.0) if p.trim_fade > 0.0 else 1.0
        stroke = max(fade, 0.0) * self.stroke(length, w).length
        wanted = stroke * 2.0 * along / (whole * w)
        # u.u' changes at |u'|^2 - w^2 |u|^2.
        forward = stroke * 2.0 * w * (speed - square) / whole
        rate = forward + p.trim_tracking * w * (wanted - offset)
        return min(max(rate, -p.trim_rate), p.trim_rate)


class WheelPump:
    """Momentum of the wheels against the swing along base_link x.

    Args:
        parameters: its bounds.
        hanging: the rover.
    """

    def __init__(self, parameters: DampingParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging

    def momentum(self, swing: SwingEstimate, *, may_spin: bool) -> float:
        """Momentum along x, as `hanging_rover` counts it [N m s].

        Args:
            swing: as estimated.
            may_spin: whether a cone may be turned into spin about the tether.
        """
        p, w = self.parameters, swing.frequency
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        fade = p.pump_fade**2
        across = y * y + (vy / w) ** 2 + fade
        wanted, phased, yaw = x, vx / w, 0.0
        if not may_spin or abs(swing.yaw_rate) > p.spin_limit:
            share = (x * vy - y * vx) / (w * across)
            wanted, phased = x - share * vy / w, vx / w + share * y
            yaw = min(max(swing.yaw_rate / p.yaw_band, -1.0), 1.0)
        amplitude = max(math.hypot(wanted, phased), p.pump_fade)
        total = wanted / amplitude - yaw * vy / (w * math.sqrt(across))
        return p.pump_momentum * min(max(total, -1.0), 1.0)

    def decay(self, length: float) -> float:
        """Rate [rad/s] at which the amplitude along x falls on so much tether [m]."""
        reach = length + self.hanging.lever
        return self.parameters.pump_momentum / (2.0 * self.hanging.rover_mass * reach**2)

    def own_tilt_rate(self, momentum: float, frequency: float) -> float:
        """Tilt rate [rad/s] that the pumping itself causes, as p = -h'/(m g d): w^2 h/(m g d)."""
        return frequency**2 * momentum / self.hanging.stiffness
