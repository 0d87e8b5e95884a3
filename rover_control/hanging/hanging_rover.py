"""Model of the rover as a double pendulum on a taut tether. Pure.

Per horizontal axis of base_link two small angles describe it, both positive in the direction of the
displacement: u of the tether and phi of the rover against the plumb line; p = phi - u is the tilt
against the tether. With the tether length l, the lever d from the tether's attachment down to the
centre of mass, the mass m, the inertia I about the centre of mass and the rotor momentum h

    l u'' + d phi'' = -g u - 2 l' u',        I phi'' = -m g d p - h'.

In the slow mode phi follows u: the pendulum (l + d) u'' = -g u - 2 l' u'. In the fast mode the
rover tilts about its centre of mass at sqrt(m g d/I), as the tether's tip yields sideways.

Axes. A displacement along +x is a negative rotation about +y, one along +y a positive rotation
about +x. So the x axis has the rate -omega_y and the rotor momentum -h_y of the wheels, the y axis
the rate omega_x and the momentum h_x of the flywheel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas.parameters import parameter


@dataclass(frozen=True)
class HangingParameters:
    """Mass properties of the rover, rotors included, and its suspension."""

    rover_mass: float = parameter(10.0, "kg", "mass of both bodies", 0.1, 1e3)
    lever: float = parameter(
        0.203, "m", "distance from the tether's attachment down to the centre of mass", 0.01, 2.0
    )
    inertia_about_x: float = parameter(
        0.189, "kg m^2", "inertia about the centre of mass, flywheel included", 1e-3, 1e2
    )
    inertia_about_y: float = parameter(
        0.177, "kg m^2", "inertia about the centre of mass, wheels included", 1e-3, 1e2
    )
    inertia_about_z: float = parameter(
        0.153, "kg m^2", "inertia about the centre of mass, rotors included", 1e-3, 1e2
    )
    rover_gravity: float = parameter(1.62, "m/s^2", "gravity at the rover", 0.01, 30.0)
    com_above_imu: float = parameter(
        0.077, "m", "height of the centre of mass above the IMU", -1.0, 1.0
    )
    tether_density: float = parameter(5.0e-3, "kg/m", "mass per length of the tether", 0.0, 10.0)
    twist_stiffness: float = parameter(
        1.0e-4, "N m^2", "torsional stiffness GJ of the tether", 0.0, 1.0
    )
    swivel_friction: float = parameter(
        1.0e-3, "N m", "largest torque that the swivel transmits", 0.0, 10.0
    )
    wheel_inertia: float = parameter(
        6.0e-3, "kg m^2", "inertia of one wheel about the axle", 1e-5, 1.0
    )
    flywheel_inertia: float = parameter(1.0e-3, "kg m^2", "inertia of the flywheel", 1e-6, 1.0)

    @property
    def inertias(self) -> tuple[float, float]:
        """Inertias of the tilts along x and y [kg m^2]."""
        return self.inertia_about_y, self.inertia_about_x

    @property
    def stiffness(self) -> float:
        """Restoring stiffness of a tilt against the tether, m g d [N m/rad]."""
        return self.rover_mass * self.rover_gravity * self.lever

    def effective_gravity(self, length: float) -> float:
        """Effective gravity [m/s^2] of the swing on a tether of this length [m].

        A tether of mass M adds inertia and tension: g (1 + M/6m).
        """
        heavier = self.tether_density * length / (6.0 * self.rover_mass)
        return self.rover_gravity * (1.0 + heavier)

    def torsional_stiffness(self, length: float) -> float:
        """Torsional stiffness GJ/l [N m/rad] of a tether of this length [m]."""
        return self.twist_stiffness / length

    def torsional_frequency(self, length: float) -> float:
        """Angular frequency [rad/s] of the rover's turning to and fro about the tether."""
        return math.sqrt(self.torsional_stiffness(length) / self.inertia_about_z)

    def pendulum_inertia(self, length: float) -> float:
        """Inertia of the swing about the fairlead, m (l + d)^2 [kg m^2]."""
        return self.rover_mass * (length + self.lever) ** 2

    def swing_frequency(self, length: float) -> float:
        """Angular frequency [rad/s] of the swing on a tether of this length [m]."""
        return math.sqrt(self.effective_gravity(length) / (length + self.lever))

    def swing_amplitude_at(self, amplitude: float, length: float, to_length: float) -> float:
        """Swing amplitude [rad] after a slow change of the length [m].

        Energy over frequency is an adiabatic invariant: the angle scales with length^(-3/4).
        """
        ratio = (length + self.lever) / (to_length + self.lever)
        return amplitude * math.pow(ratio, 0.75)
