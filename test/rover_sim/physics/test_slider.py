import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_sim.physics.mechanisms.slider import (
    SliderParameters,
    make_slider,
    pad,
    slider_energy,
    slider_force,
)

SLIDER = make_slider(SliderParameters())
H = 1e-3


def force_at(s: float, rate: float) -> float:
    """Force in a short step."""
    return float(slider_force(SLIDER, s, rate * 1e-9, 1e-9).force)


def test_spring_and_damper_between_the_stops() -> None:
    assert force_at(0.15, 0.5) == pytest.approx(824.0 * 0.05 - 0.1 - 1.0, abs=1e-4)
    assert force_at(SLIDER.free_length, -2e-3) == pytest.approx(0.2 * 2e-3 + math.sqrt(0.5))


def test_stops_push_back_and_never_pull() -> None:
    above = SLIDER.free_length + 0.002
    below = SLIDER.free_length - SLIDER.lower_stop - 0.002
    assert force_at(above, 2.0) < -100.0 * 20.0
    assert force_at(below, -2.0) > 100.0 * 20.0
    # Leaving faster than 1/a, only the spring acts.
    assert force_at(above, -2.0) == pytest.approx(-824.0 * 0.002 + 0.4 + 1.0, abs=1e-4)


@settings(max_examples=200, deadline=None)
@given(depths=st.tuples(*[st.floats(-0.01, 0.01)] * 2), damping=st.floats(0.0, 10.0))
def test_a_pad_stores_what_it_does_not_dissipate(
    depths: tuple[float, float], damping: float
) -> None:
    stored = [0.5 * 5e4 * max(depth, 0.0) ** 2 for depth in depths]
    change = depths[1] - depths[0]
    elastic, _ = pad(5e4, 0.0, *depths, H)
    assert elastic * change == pytest.approx(stored[1] - stored[0], abs=1e-12)
    damped, _ = pad(5e4, damping, *depths, H)
    assert damped >= 0.0
    assert damped * change >= stored[1] - stored[0] - 1e-12


@settings(max_examples=200, deadline=None)
@given(s=st.floats(-0.05, 0.25), change=st.floats(-3e-3, 3e-3))
def test_tangents_are_derivatives_of_the_force(s: float, change: float) -> None:
    here = slider_force(SLIDER, s, change, H)
    e = 1e-9
    ahead = slider_force(SLIDER, s, change + e, H).force
    behind = slider_force(SLIDER, s, change - e, H).force
    slopes = ((ahead - here.force) / e, (here.force - behind) / e)
    # At a kink the tangent belongs to one of its sides.
    assert min(abs(here.by_change - slope) for slope in slopes) <= (
        1e-3 * abs(here.by_change) + 1e-3 * max(map(abs, slopes)) + 1.0
    )


@settings(max_examples=100, deadline=None)
@given(s=st.floats(-0.05, 0.25), change=st.floats(-3e-3, 3e-3))
def test_no_force_creates_energy(s: float, change: float) -> None:
    stored = slider_energy(SLIDER, False, 0.0, s + change) - slider_energy(SLIDER, False, 0.0, s)
    assert slider_force(SLIDER, s, change, H).force * change <= -stored + 1e-12


@pytest.mark.parametrize(
    ("field", "value"),
    [("spring_rate", 0.0), ("damping", -1.0), ("nut_stiffness", math.nan), ("lower_stop", 0.0)],
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(SliderParameters(), **change)
