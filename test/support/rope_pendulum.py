"""Rover as a point mass on a rope with torsion; small angles, in space."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate

HANGING = HangingParameters()
H = 0.02


@dataclass
class Pendulum:
    """Swing and spin; the tilt follows the rotors at once.

    Attributes:
        length: of the rope [m].
        u, v: its direction against the plumb line, and its rate, in space [rad], [rad/s].
        yaw, yaw_rate: of the rover [rad], [rad/s].
        trimmed: length paid out so far [m].
        has_torsion: whether the twist of the rope acts on the rover.
    """

    length: float
    u: complex
    v: complex
    yaw: float = 0.0
    yaw_rate: float = 0.0
    trimmed: float = 0.0
    has_torsion: bool = False
    momentum_in_space: complex = 0j

    def estimate(self) -> SwingEstimate:
        """Exact estimate."""
        turned = cmath.exp(-1j * self.yaw)
        u, v = self.u * turned, self.v * turned
        frequency = HANGING.swing_frequency(self.length)
        zero = (0.0, 0.0)
        return SwingEstimate(
            (u.real, u.imag), (v.real, v.imag), zero, zero, zero, self.yaw_rate, frequency, 0.0, 0.0
        )

    def step(self, rate: float = 0.0, rotors: complex = 0j) -> None:
        """Advance by H with a payout rate [m/s] and momenta of the rotors [N m s]."""
        reach = self.length + HANGING.lever
        lever = HANGING.pendulum_inertia(self.length)
        in_space = rotors * cmath.exp(1j * self.yaw)
        push = -(in_space - self.momentum_in_space) / H / lever
        self.momentum_in_space = in_space
        pull = HANGING.effective_gravity(self.length) / reach
        for _ in range(4):
            self.v += 0.25 * H * (-pull * self.u - 2.0 * rate / reach * self.v + push)
            self.u += 0.25 * H * self.v
        self.length += H * rate
        self.trimmed += H * rate
        # The momentum about the plumb line is conserved between swing and rover.
        torque = -lever * (self.u.conjugate() * push).imag
        if self.has_torsion:
            torque -= HANGING.torsional_stiffness(self.length) * self.yaw
        self.yaw_rate += H * torque / HANGING.inertia_about_z
        self.yaw += H * self.yaw_rate

    @property
    def amplitude(self) -> float:
        """Major amplitude [rad]."""
        return self.estimate().ellipse.major

    @property
    def momentum(self) -> float:
        """Momentum of the swing about the plumb line [N m s]."""
        return HANGING.pendulum_inertia(self.length) * (self.u.conjugate() * self.v).imag


def swinging(length: float, major: float, minor: float = 0.0) -> Pendulum:
    """A pendulum at the end of its major axis, amplitudes in deg."""
    frequency = HANGING.swing_frequency(length)
    return Pendulum(length, complex(math.radians(major)), 1j * math.radians(minor) * frequency)
