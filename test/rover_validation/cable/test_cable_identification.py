"""Identification of few and of all numbers, on takes of a simulated cable."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rover_validation.cable.comparison import error_of
from rover_validation.cable.example import LAWS, example_take
from rover_validation.cable.identification import FEW, MANY, identify

ASKEW = {
    **LAWS,
    "root_tilt_1": 0.35, "root_tilt_2": -0.3, "tip_tilt_1": 0.0, "tip_tilt_2": 0.35,
    "tip_roll": 0.0, "relaxation_ratio": 0.6,
}  # fmt: skip


def test_all_numbers_of_a_cable_that_is_askew_in_its_holders_are_identified():
    generator = np.random.default_rng(3)
    takes = [
        replace(example_take(generator, 1.0, 2e-4, ASKEW), name=f"take {number}")
        for number in range(4)
    ]
    identified = identify(takes[:3], None, MANY)
    cable = identified.cable
    assert len(cable.numbers) == MANY
    assert set(identified.errors) == {"take 0", "take 1", "take 2"}
    assert error_of(takes[3], cable.predict(takes[3])) < 0.003
    # within a second hardly anything relaxes: both parts of the stiffness act
    found, own = (
        values["bending_stiffness"] * (1.0 + values["relaxation_ratio"])
        for values in (cable.values, ASKEW)
    )
    assert found == pytest.approx(own, rel=0.1)
    # the axes across a holder begin near an axis of the world that the identification chooses
    for end in ("root", "tip"):
        found, own = (
            math.hypot(values[f"{end}_tilt_1"], values[f"{end}_tilt_2"])
            for values in (cable.values, ASKEW)
        )
        assert found == pytest.approx(own, abs=0.05)


def test_two_tilts_of_the_holders_are_found_with_few_numbers():
    own = {
        **LAWS,
        "curvature_1_0": 0.0, "curvature_2_0": 0.0, "root_tilt_2": 0.35, "tip_tilt_1": -0.3,
    }  # fmt: skip
    generator = np.random.default_rng(4)
    takes = [
        replace(example_take(generator, 1.0, 2e-4, own), name=f"take {number}")
        for number in range(4)
    ]
    cable = identify(takes[:3], None, FEW).cable
    assert len(cable.numbers) == FEW
    assert error_of(takes[3], cable.predict(takes[3])) < 0.003
    assert cable.values["bending_stiffness"] == pytest.approx(own["bending_stiffness"], rel=0.1)
    for end, tilt in (("root", 0.35), ("tip", 0.3)):
        found = math.hypot(cable.values[f"{end}_tilt_1"], cable.values[f"{end}_tilt_2"])
        assert found == pytest.approx(tilt, abs=0.05)
