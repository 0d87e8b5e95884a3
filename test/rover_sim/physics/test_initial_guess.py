"""Initial guess of a step: exact for what it assumes, of low order where motion is rough."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rover_sim.physics.integrators.initial_guess import (
    ORDER,
    RECURRENCE,
    History,
    clear_history,
    extrapolate,
    make_history,
    record_step,
)

Array = NDArray[np.float64]
H, LENGTH, NODES = 1.0e-3, 0.5, 8
SHAPE = (12, NODES)
RNG = np.random.default_rng(3)
MODES = RNG.normal(size=(5, *SHAPE))
EXTRA = np.linspace(1.0, 2.0, 7)


def vibrating(t: float) -> Array:
    """Rates of a parabola in time, a damped vibration and a decay."""
    damped = np.exp(-40.0 * t)
    parts = (1.0, t, damped * np.cos(900.0 * t), damped * np.sin(900.0 * t), np.exp(-300.0 * t))
    return np.asarray(np.tensordot(np.array(parts), MODES, axes=1))


def rough(t: float) -> Array:
    return np.asarray(np.random.default_rng(round(1e6 * t)).normal(size=SHAPE))


def parabolic(t: float) -> Array:
    return np.asarray(MODES[0] + 50.0 * t * MODES[1] + 3000.0 * t * t * MODES[2])


def follow(rates: Callable[[float], Array], lengths: list[float]) -> tuple[History, list[int]]:
    """History after steps of some lengths from t = 0, and the orders after each."""
    history = make_history(*SHAPE, 7)
    orders, t = [], 0.0
    for h in lengths:
        record_step(history, h, LENGTH, h * rates(t + 0.5 * h), h * EXTRA)
        orders.append(int(history.counts[ORDER]))
        t += h
    return history, orders


def guess(history: History, h: float, order: int) -> Array:
    increment, extra = np.zeros(SHAPE), np.zeros(7)
    history.counts[ORDER] = order
    extrapolate(history, h, increment, extra)
    assert extra == pytest.approx(h * EXTRA, rel=1e-12)
    return increment


def test_a_damped_vibration_and_a_decay_are_predicted_to_the_regularisation():
    steps = 12
    history, orders = follow(vibrating, [H] * steps)
    assert orders[-4:] == [RECURRENCE] * 4
    exact = H * vibrating((steps + 0.5) * H)
    errors = [float(np.max(np.abs(guess(history, H, k) - exact))) for k in (3, RECURRENCE)]
    assert errors[1] < 1e-3 * errors[0]


def test_a_parabola_needs_no_prediction():
    history, orders = follow(parabolic, [H] * 12)
    assert orders[:3] == [1, 1, 2]
    exact = H * parabolic(12.5 * H)
    assert guess(history, H, orders[-1]) == pytest.approx(exact, rel=1e-9, abs=1e-12)


def test_rough_motion_has_a_low_order():
    _, orders = follow(rough, [H] * 40)
    assert set(orders) == {1}


def test_the_prediction_begins_anew_after_a_step_of_another_length():
    _, orders = follow(vibrating, [H] * 12 + [0.5 * H] + [H] * 9)
    assert orders[11] == RECURRENCE
    # four equal steps give one difference, the next ones the weights
    assert RECURRENCE not in orders[12:17]
    assert orders[-1] == RECURRENCE


def test_differences_of_an_earlier_run_have_no_effect():
    history, _ = follow(rough, [H] * 12)
    clear_history(history)
    fresh = make_history(*SHAPE, 7)
    for step in range(12):
        increment = H * vibrating((step + 0.5) * H)
        for each in (history, fresh):
            record_step(each, H, LENGTH, increment, H * EXTRA)
        order = int(fresh.counts[ORDER])
        assert history.counts[ORDER] == order
        if step >= 3:
            assert np.array_equal(guess(history, H, order), guess(fresh, H, order))
