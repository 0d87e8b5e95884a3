import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_sim.physics.mechanisms.slider import (
    NutAction,
    SliderParameters,
    make_slider,
    nut_force,
    slider_energy,
    slider_force,
)

SLIDER = make_slider(SliderParameters())
AWAY = NutAction(False, 0.1, 0.0, 0.0, 0.0)


def test_spring_and_damper_between_the_stops() -> None:
    force = slider_force(SLIDER, AWAY, 0.15, 0.5)
    assert force == pytest.approx((824.0 * 0.05 - 0.1 - 1.0, -824.0, -0.2, 0.0), abs=1e-4)
    slow = slider_force(SLIDER, AWAY, SLIDER.free_length, -2e-3)
    assert slow.force == pytest.approx(0.2 * 2e-3 + math.sqrt(0.5))
    assert slow.by_rate == pytest.approx(-0.2 - 500.0 / math.sqrt(8.0))


def test_stops_push_back_and_never_pull() -> None:
    above = SLIDER.free_length + 0.002
    below = SLIDER.free_length - SLIDER.lower_stop - 0.002
    assert slider_force(SLIDER, AWAY, above, 2.0).force < -100.0 * 20.0
    assert slider_force(SLIDER, AWAY, below, -2.0).force > 100.0 * 20.0
    # Leaving faster than 1/a, only the spring acts.
    leaving = slider_force(SLIDER, AWAY, above, -2.0)
    assert leaving.force == pytest.approx(-824.0 * 0.002 + 0.4 + 1.0, abs=1e-4)


def test_a_nut_presses_on_the_latch_from_above_only() -> None:
    nut = NutAction(True, 0.1, 0.0, 0.0, 0.0)
    pressed = slider_force(SLIDER, nut, SLIDER.free_length - 0.0999, 0.0)
    assert pressed.nut_force == pytest.approx(2e6 * 1e-4)
    assert pressed.force == pytest.approx(824.0 * 0.0999 - 200.0)
    assert slider_force(SLIDER, nut, SLIDER.free_length - 0.1001, 0.0).nut_force == 0.0
    assert slider_force(SLIDER, AWAY, SLIDER.free_length - 0.05, 0.0).nut_force == 0.0


NUTS = st.builds(
    NutAction,
    st.booleans(),
    st.floats(-0.06, 0.21),
    st.floats(-0.05, 0.05),
    st.floats(0.0, 200.0),
    st.floats(0.0, 5.0),
)


@settings(max_examples=200, deadline=None)
@given(nut=NUTS, s=st.floats(-0.05, 0.25), rate=st.floats(-3.0, 3.0))
def test_tangents_are_derivatives_of_the_force(nut: NutAction, s: float, rate: float) -> None:
    force = slider_force(SLIDER, nut, s, rate)
    assert force.nut_force == pytest.approx(nut_force(SLIDER, nut, s, rate), rel=1e-12)
    e = 1e-7

    def slope(ds: float, dv: float) -> tuple[float, float]:
        ahead = slider_force(SLIDER, nut, s + ds, rate + dv).force
        behind = slider_force(SLIDER, nut, s - ds, rate - dv).force
        return (ahead - force.force) / (ds + dv), (force.force - behind) / (ds + dv)

    for tangent, pair in ((force.by_position, slope(e, 0.0)), (force.by_rate, slope(0.0, e))):
        # At a kink the tangent belongs to one of its sides.
        assert min(abs(tangent - side) for side in pair) <= 1e-3 * max(1.0, abs(tangent)) + 1.0


@settings(max_examples=100, deadline=None)
@given(s=st.floats(-0.05, 0.25), position=st.floats(-0.06, 0.21), pressing=st.booleans())
def test_the_force_at_rest_is_the_gradient_of_the_energy(
    s: float, position: float, pressing: bool
) -> None:
    nut = NutAction(pressing, position, 0.0, 0.0, 0.0)
    e = 1e-6
    ahead = slider_energy(SLIDER, pressing, position, s + e)
    behind = slider_energy(SLIDER, pressing, position, s - e)
    force = slider_force(SLIDER, nut, s, 0.0).force
    assert force == pytest.approx(-(ahead - behind) / (2.0 * e), abs=2e6 * e + 1e-3 * abs(force))


@pytest.mark.parametrize(
    ("field", "value"),
    [("spring_rate", 0.0), ("damping", -1.0), ("nut_stiffness", math.nan), ("lower_stop", 0.0)],
)
def test_bad_values_are_refused_by_name(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(SliderParameters(), **change)
