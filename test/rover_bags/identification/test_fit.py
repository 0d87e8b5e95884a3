"""Least squares on a closed-form plant: intervals and identifiability."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rover_bags.identification.fit import Fit, Fitted, Predictor
from rover_bags.identification.noise import Errors, Floats
from rover_bags.identification.profile import Profile
from rover_bags.identification.runs import IdentificationRun, Signal, Task
from rover_sim import load_spatial

HANG = load_spatial("identify_hang")
STANDING = load_spatial("identify_bow")


def decay(experiments: Sequence[IdentificationRun]) -> Predictor:
    """EA is an amplitude, EI its decay rate; twist_stiffness has no effect."""

    def predict(tasks: Sequence[Task]) -> list[Floats]:
        found = []
        for number, values, start in tasks:
            times = experiments[number].times
            curve = values["EA"] * np.exp(-values["EI"] * times)
            if "axial_damping" in values:
                curve = curve * values["axial_damping"]
            found.append((curve + sum(start) * np.sin(times))[:, None])
        return found

    return predict


def made_up(generator: np.random.Generator, amplitude: float, rate: float) -> IdentificationRun:
    """Readings of an exponential decay, with a bias and noise of 0.01."""
    stamps = tuple(20_000_000 * k for k in range(1, 301))
    times = np.array(stamps) / 1e9
    curve = amplitude * np.exp(-rate * times) + 0.02 * np.sin(times)
    read = curve + generator.normal(0.0, 0.01, 300) + generator.normal(0.0, 0.5)
    return IdentificationRun(
        Path("made_up"), HANG, 0.02, 0, (), stamps,
        (Signal("sensor", "value", "gyro"),), read[:, None], (Errors(1e-4, 0.0, 0.25),),
    )  # fmt: skip


def test_intervals_have_their_nominal_coverage():
    inside = np.zeros(2)
    for seed in range(100):
        experiment = made_up(np.random.default_rng(seed), 2.0, 0.5)
        fitted = Fit([experiment], {"EA": 1.7, "EI": 0.6}, decay([experiment])).solve()
        assert fitted.converged
        assert fitted.identifiable.all()
        off = fitted.logs - np.log([2.0 / 1.7, 0.5 / 0.6])
        inside += np.abs(off) <= 1.96 * np.sqrt(np.diag(fitted.covariance))
    # Binomial, 100 trials of 0.95: beyond 4.5 standard deviations below.
    assert np.all(inside >= 85), inside


def test_insensitive_and_collinear_parameters_are_not_identifiable():
    experiment = made_up(np.random.default_rng(1), 2.0, 0.5)
    guesses = {"EA": 1.7, "EI": 0.6, "axial_damping": 1.0, "twist_stiffness": 1e-4}
    fitted = Fit([experiment], guesses, decay([experiment])).solve()
    assert fitted.identifiable.tolist() == [False, True, False, False]
    assert fitted.strength[3] == 0.0
    assert fitted.strength[0] > 100.0
    assert fitted.logs[[0, 2, 3]].tolist() == [0.0, 0.0, 0.0]
    # Two collinear parameters: one singular value less than the number of effective parameters.
    assert np.count_nonzero(fitted.singular_values > 1.0) == 2


def test_excess_noise_widens_the_intervals():
    quiet = made_up(np.random.default_rng(2), 2.0, 0.5)
    loud = replace(
        quiet,
        readings=quiet.readings + np.random.default_rng(5).normal(0.0, 0.05, quiet.readings.shape),
    )
    guesses = {"EA": 1.9, "EI": 0.55}
    narrow, wide = (Fit([one], guesses, decay([one])).solve() for one in (quiet, loud))
    assert wide.scales[0][0] == pytest.approx(5.1, rel=0.15)
    ratio = np.sqrt(np.diag(wide.covariance) / np.diag(narrow.covariance))
    assert np.all((ratio > 3.5) & (ratio < 7.0))


def test_model_errors_are_reported_and_widen_the_intervals():
    experiment = made_up(np.random.default_rng(2), 2.0, 0.5)
    wave = 0.03 * np.sin(9.0 * experiment.times)[:, None]
    off = replace(experiment, readings=experiment.readings + wave)
    guesses = {"EA": 1.9, "EI": 0.55}
    assert Fit([experiment], guesses, decay([experiment])).solve().coloured == ()
    assert Fit([off], guesses, decay([off])).solve().coloured == ((0, 0),)


def turning_over(experiments: Sequence[IdentificationRun], tilt: float) -> Predictor:
    """Readings with equal minima at damping times of 2 and 2 exp(-0.3), but for a tilt."""

    def predict(tasks: Sequence[Task]) -> list[Floats]:
        found = []
        for number, values, _ in tasks:
            times = experiments[number].times
            log = math.log(values["bending_damping"] / 2.0)
            bend = 0.1 * log * (log + 0.3) * np.sin(3.0 * times) + tilt * log * np.cos(5.0 * times)
            found.append((values["EA"] * np.exp(-0.5 * times) + bend)[:, None])
        return found

    return predict


def fitted_beside(tilt: float) -> Fitted:
    """Fit from a guess beyond the second minimum."""
    experiment = made_up(np.random.default_rng(4), 2.0, 0.5)
    exact = turning_over([experiment], tilt)([(0, {"EA": 2.0, "bending_damping": 2.0}, ())])[0]
    noise = np.random.default_rng(4).normal(0.0, 0.01, exact.shape)
    one = replace(experiment, readings=exact + noise, scenario=STANDING)
    guesses = {"EA": 1.9, "bending_damping": 2.0 * math.exp(-0.26)}
    return Fit([one], guesses, turning_over([one], tilt)).solve()


def test_the_interval_holds_both_of_two_equal_minima():
    fitted = fitted_beside(tilt=0.0)
    low, high = fitted.interval(1, 1.96)
    assert fitted.identifiable.all()
    assert abs(fitted.logs[1] + 0.04) < 0.1
    assert low < -0.04 < 0.26 < high
    assert fitted.profiles[1].others(1.96) == pytest.approx([0.3], abs=0.06)
    # A well-known parameter has no profile.
    assert set(fitted.profiles) == {1}


def test_the_search_moves_to_a_lower_minimum():
    fitted = fitted_beside(tilt=0.015)
    low, high = fitted.interval(1, 1.96)
    assert fitted.converged
    assert low < 0.26 < high
    assert low > -0.04
    assert high - low < 0.2


def test_the_reach_of_a_profile_ends_where_its_root_crosses_the_limit():
    offsets = np.arange(-3.0, 4.0)
    profile = Profile(offsets, offsets**2)
    assert profile.reach(1.5) == pytest.approx((-1.5, 1.5))
    assert profile.reach(3.5) == (-math.inf, math.inf)
    assert profile.best == (0.0, 0.0)
    assert profile.others(1.5).size == 0


def test_a_second_minimum_belongs_to_the_reach():
    offsets = np.arange(-3.0, 4.0)
    profile = Profile(offsets, np.array([25.0, 16.0, 9.0, 0.0, 9.0, -1.0, 16.0]))
    assert profile.reach(2.0) == pytest.approx((-2.0 / 3.0, 2.5))
    assert profile.best == (2.0, 1.0)
    assert profile.others(2.0).tolist() == [2.0]
