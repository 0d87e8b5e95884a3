"""Cross-section properties of the tether: stiffness, line density, damping, breaking load."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class TetherSection:
    """Stiffness, mass, damping and strength of a uniform thin tether.

    Damping is of Kelvin-Voigt type (strain-rate proportional): the axial force is
    EA (eps + tau_a deps/dt), the bending moment EI (kappa + tau_b dkappa/dt).

    Raises:
        ValueError: a value is not finite (except breaking_load) or out of its range.
    """

    axial_stiffness: float  # EA [N], > 0
    bending_stiffness: float  # EI [N m^2], >= 0
    line_density: float  # rho A [kg/m], > 0
    axial_damping_time: float = 0.0  # tau_a [s], >= 0
    bending_damping_time: float = 0.0  # tau_b [s], >= 0
    breaking_load: float = math.inf  # [N], > 0
    buckles: bool = False  # whether elements in compression buckle (`buckling`)

    def __post_init__(self) -> None:
        for name in ("axial_stiffness", "line_density"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value}: must be finite and above 0")
        for name in ("bending_stiffness", "axial_damping_time", "bending_damping_time"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} = {value}: must be finite and not below 0")
        if not self.breaking_load > 0.0:
            raise ValueError(f"breaking_load = {self.breaking_load}: must be above 0 (inf: none)")

    @classmethod
    def round(
        cls,
        youngs_modulus: float,
        radius: float,
        density: float,
        axial_damping_time: float = 0.0,
        bending_damping_time: float = 0.0,
        breaking_load: float = math.inf,
    ) -> TetherSection:
        """Solid round tether: A = pi r^2, I = pi r^4 / 4.

        Args:
            youngs_modulus: E [Pa].
            radius: r [m].
            density: rho [kg/m^3].
            axial_damping_time: tau_a [s].
            bending_damping_time: tau_b [s].
            breaking_load: [N].
        """
        area = math.pi * radius**2
        return cls(
            axial_stiffness=youngs_modulus * area,
            bending_stiffness=youngs_modulus * math.pi * radius**4 / 4.0,
            line_density=density * area,
            axial_damping_time=axial_damping_time,
            bending_damping_time=bending_damping_time,
            breaking_load=breaking_load,
        )

    def stiffened(self, ratio: float) -> TetherSection:
        """The section with more bending stiffness, EI (1 + ratio), and the same damping EI tau_b.

        Args:
            ratio: stiffness that relaxes over that which stays [-]; see `natural_curvature`.
        """
        return replace(
            self,
            bending_stiffness=self.bending_stiffness * (1.0 + ratio),
            bending_damping_time=self.bending_damping_time / (1.0 + ratio),
        )
