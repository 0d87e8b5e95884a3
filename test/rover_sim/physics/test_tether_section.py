import math
from typing import Any

import pytest

from rover_sim.physics.tether.tether_section import TetherSection


def test_round_section_of_the_papers_table_1() -> None:
    section = TetherSection.round(0.5e9, 3.45e-4, 1e4)
    assert section.axial_stiffness == pytest.approx(186.964, rel=1e-5)
    assert section.bending_stiffness == pytest.approx(5.56333e-6, rel=1e-5)
    assert section.line_density == pytest.approx(3.73928e-3, rel=1e-5)
    assert section.breaking_load == math.inf


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("axial_stiffness", 0.0),
        ("axial_stiffness", math.nan),
        ("bending_stiffness", -1.0),
        ("bending_stiffness", math.inf),
        ("line_density", -1e-3),
        ("axial_damping_time", math.nan),
        ("bending_damping_time", -1e-3),
        ("breaking_load", 0.0),
        ("breaking_load", math.nan),
    ],
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    good: dict[str, Any] = {
        "axial_stiffness": 1.0, "bending_stiffness": 1.0, "line_density": 1.0,
    }  # fmt: skip
    with pytest.raises(ValueError, match=field):
        TetherSection(**{**good, field: value})
