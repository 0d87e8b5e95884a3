"""Linear model of a rover on a tether in space, independent of the controllers' model."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field

import numpy as np

from msg_schemas.samples import Vector
from rover_control.hanging.hanging_rover import HangingParameters

STEPS, H = 4, 2.5e-3  # substeps per 10 ms, substep [s]


@dataclass
class HangingModel:
    """Swing u and attitude phi as x + i y in the map; the rover yaws at a given rate."""

    hanging: HangingParameters
    length: float
    u: complex
    v: complex
    phi: complex = 0.0
    phi_rate: complex = 0.0
    payout_rate: float = 0.0
    yaw: float = 0.0
    yaw_rate: float = 0.0
    bias: Vector = (0.0, 0.0, 0.0)
    noise: float = 0.0  # of the gyro, a sample of 100 Hz [rad/s]
    accelerometer_noise: float = 0.0
    vibration: float = 0.0  # of the tether's end about its mean direction, along x of the map [rad]
    vibration_rate: float = 25.0  # of a few metres of tether under 16 N [rad/s]
    time: float = 0.0
    generator: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def step(self, momentum_rate: tuple[float, float]) -> tuple[Vector, Vector]:
        """Advance by 10 ms under rotor torques about base_link x and y; returns gyro and force."""
        p = self.hanging
        turned, felt, swept = 0.0j, 0.0j, 0.0
        for _ in range(STEPS):
            heading = cmath.exp(1j * self.yaw)
            shaken = self.vibration * math.sin(self.vibration_rate * self.time)
            tilt = (self.phi - self.u + shaken) / heading
            self.time += H
            # The tether restores the tilt; a torque about +y displaces toward -x.
            right = -p.rover_mass * p.rover_gravity * p.lever * tilt
            along_x = (right.real + momentum_rate[1]) / p.inertia_about_y
            along_y = (right.imag - momentum_rate[0]) / p.inertia_about_x
            turning = complex(along_x, along_y) * heading
            pull = p.effective_gravity(self.length) * self.u + 2.0 * self.payout_rate * self.v
            self.v += H * -(pull + p.lever * turning) / self.length
            self.u += H * self.v
            # An ellipse precesses.
            precessed = cmath.exp(0.375j * H * (self.u.conjugate() * self.v).imag)
            self.u, self.v = self.u * precessed, self.v * precessed
            self.phi_rate += H * turning
            self.phi += H * self.phi_rate
            self.length += H * self.payout_rate
            self.yaw += H * self.yaw_rate
            turned += self.phi_rate / heading / STEPS
            swept += (self.phi.conjugate() * self.phi_rate).imag / STEPS
            felt += (p.rover_gravity * tilt + p.com_above_imu * turning / heading) / STEPS
        noise = self.generator.standard_normal(5).tolist()
        # The body rate is the heading rate less the rate of the swept solid angle.
        rates = (turned.imag, -turned.real, self.yaw_rate - 0.5 * swept)
        x, y, z = (
            rate + bias + self.noise * each
            for rate, bias, each in zip(rates, self.bias, noise[:3], strict=True)
        )
        fx, fy = (
            felt.real + self.accelerometer_noise * noise[3],
            felt.imag + self.accelerometer_noise * noise[4],
        )
        return (x, y, z), (fx, fy, p.rover_gravity)

    def in_base(self, vector: complex) -> complex:
        """Vector of the map plane in base_link x and y."""
        return vector * cmath.exp(-1j * self.yaw)
