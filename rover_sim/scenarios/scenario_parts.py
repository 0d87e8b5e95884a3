"""Sections shared by planar and spatial scenarios: tether cross-section and integration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from msg_schemas.fields import is_finite_number
from rover_sim.physics.tether.tether_section import TetherSection

ScenarioError = ConfigurationError

MATERIALS = (
    ("youngs_modulus", "radius", "density"),
    ("youngs_modulus", "area", "second_moment", "density"),
    ("axial_stiffness", "bending_stiffness", "line_density"),
)
_MATERIAL_TEXT = "; or ".join(", ".join(names) for names in MATERIALS)

# Halvings of a step that every scenario may have, and the shortest step that more may lead to [s]:
# a plant computes a million of these, a tick of 10 ms, in half a minute.
_HALVINGS, _SHORTEST_STEP = 10, 1e-8


def read_table(
    value: object, path: str, columns: Sequence[str], fewest: int = 0
) -> tuple[tuple[float, ...], ...]:
    """Read the rows of a table whose first column increases: a time or a place.

    Args:
        value: as given.
        path: of the value.
        columns: names of the numbers in a row.
        fewest: smallest number of rows.

    Raises:
        ScenarioError: it is no such table, or its first column does not increase.
    """
    expected = f"should be a list of [{', '.join(columns)}] with increasing {columns[0]}"
    if fewest:
        expected += f", at least {fewest}"
    if isinstance(value, str | Mapping) or not isinstance(value, Sequence):
        raise ScenarioError(path, value, expected)
    rows: list[tuple[float, ...]] = []
    for number, row in enumerate(value):
        numbers = isinstance(row, Sequence) and all(map(is_finite_number, row))
        if not numbers or len(row) != len(columns):
            raise ScenarioError(
                f"{path}[{number}]", row, f"should be {len(columns)} finite numbers"
            )
        if rows and row[0] <= rows[-1][0]:
            raise ScenarioError(
                f"{path}[{number}]", row, f"its {columns[0]} should be above {rows[-1][0]:g}"
            )
        rows.append(tuple(float(each) for each in row))
    if len(rows) < fewest:
        raise ScenarioError(path, f"{len(rows)} rows", expected)
    return tuple(rows)


@dataclass(frozen=True, kw_only=True)
class CrossSection(Configuration):
    """A uniform cross-section, given by exactly one of three parameter sets (`MATERIALS`).

    `section` holds the derived stiffness and mass.
    """

    youngs_modulus: float | None = quantity("Pa", "E", None, above=0.0, optional=True)
    radius: float | None = quantity(
        "m", "radius of the solid round section", None, above=0.0, maximum=1.0, optional=True
    )
    area: float | None = quantity("m^2", "A", None, above=0.0, optional=True)
    second_moment: float | None = quantity(
        "m^4", "second moment of area I", None, above=0.0, optional=True
    )
    density: float | None = quantity("kg/m^3", "rho", None, above=0.0, optional=True)
    axial_stiffness: float | None = quantity("N", "EA", None, above=0.0, optional=True)
    bending_stiffness: float | None = quantity("N m^2", "EI", None, above=0.0, optional=True)
    line_density: float | None = quantity("kg/m", "rho A", None, above=0.0, optional=True)
    axial_damping_time: float = quantity(
        "s", "axial strain-rate damping divided by EA", 0.0, minimum=0.0, maximum=100.0
    )
    bending_damping_time: float = quantity(
        "s", "bending strain-rate damping divided by EI", 0.0, minimum=0.0, maximum=100.0
    )
    breaking_load: float = quantity(
        "N", "tension at which the tether breaks", math.inf, above=0.0, infinite=True
    )

    def check(self) -> None:
        """Refuse a cross-section with none or several of the parameter sets."""
        every = {name for names in MATERIALS for name in names}
        given = {name for name in every if getattr(self, name) is not None}
        if not any(given == set(names) for names in MATERIALS):
            shown = ", ".join(sorted(given)) or "none of them"
            raise ScenarioError(
                "(cross-section)", shown, f"should give exactly one of: {_MATERIAL_TEXT}"
            )

    @cached_property
    def section(self) -> TetherSection:
        """Stiffness, mass, damping and strength of the cross-section."""
        damping_and_strength: dict[str, Any] = {
            "axial_damping_time": self.axial_damping_time,
            "bending_damping_time": self.bending_damping_time,
            "breaking_load": self.breaking_load,
        }
        if self.radius is not None:
            return TetherSection.round(
                known(self.youngs_modulus),
                self.radius,
                known(self.density),
                **damping_and_strength,
            )
        if self.area is not None:
            return TetherSection(
                axial_stiffness=known(self.youngs_modulus) * self.area,
                bending_stiffness=known(self.youngs_modulus) * known(self.second_moment),
                line_density=known(self.density) * self.area,
                **damping_and_strength,
            )
        return TetherSection(
            axial_stiffness=known(self.axial_stiffness),
            bending_stiffness=known(self.bending_stiffness),
            line_density=known(self.line_density),
            **damping_and_strength,
        )


@dataclass(frozen=True)
class Integration(Configuration):
    """Settings of the energy-momentum integrator."""

    h: float = quantity("s", "time step", 1e-3, minimum=1e-6, maximum=0.1)
    tolerance: float = quantity(
        "m",
        "largest change of an unknown in the last Newton iteration",
        1e-8,
        above=0.0,
        maximum=1e-3,
    )
    numerical_damping: float = quantity(
        "-", "0 conserves the tether's energy, 1 damps most", 0.0, minimum=0.0, maximum=1.0
    )
    max_halvings: int = quantity(
        "-", "successive halvings of a step that fails", _HALVINGS, kind=int, minimum=0
    )

    def check(self) -> None:
        """Refuse halvings to steps so short that a tick would not end."""
        most = max(_HALVINGS, math.floor(math.log2(self.h / _SHORTEST_STEP)))
        if self.max_halvings > most:
            raise ScenarioError(
                "max_halvings",
                self.max_halvings,
                f"should be at most {most} for h of {self.h:g} s: steps below {_SHORTEST_STEP:g} s"
                " take too long to compute",
            )


def known(value: float | None) -> float:
    """Return a value that the checks at construction require."""
    if value is None:
        raise AssertionError("checked at construction")
    return value
