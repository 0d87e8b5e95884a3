"""Verdict on one trial of the identification."""

import math

from rover_bags.identification.identify import Estimate
from rover_verify.checks.bags_identify import SOUGHT, IdentificationTrial


def estimate(name: str, *, identifiable: bool) -> Estimate:
    high = 1.2 if identifiable else math.inf
    low = 0.9 if identifiable else 0.0
    return Estimate(
        name,
        "N",
        1.0,
        1.05,
        low,
        high,
        (low, high),
        0.1 if identifiable else math.inf,
        identifiable,
        "reason",
    )


def test_a_trial_misses_what_is_hidden_and_what_lies_outside():
    found = {name: estimate(name, identifiable=name != "EI") for name in SOUGHT}
    truth = {name: 1.1 if name != "inertia_z" else 2.0 for name in SOUGHT}
    trial = IdentificationTrial(found, truth, True, 150)
    assert trial.misses == ["EI is not identifiable", "inertia_z"]
    assert trial.holds_individually("EA")
    assert not trial.holds_individually("EI")
