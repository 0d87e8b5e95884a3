"""Trials of the identification: finished ones are kept, others are made."""

import math
from pathlib import Path

import pytest

from rover_bags.identification.identify import Estimate
from rover_verify.checks import bags_identify
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


def test_a_kept_trial_is_not_repeated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    made: list[tuple[int, int]] = []
    found = {name: estimate(name, identifiable=name != "EI") for name in SOUGHT}
    truth = {name: 1.1 if name != "inertia_z" else 2.0 for name in SOUGHT}

    def fly(folder: Path, seed: int, index: int) -> IdentificationTrial:
        made.append((seed, index))
        (folder / f"trial_{index}").mkdir(parents=True)
        return IdentificationTrial(found, truth, True, 150)

    monkeypatch.setattr(bags_identify, "trial", fly)
    kept = tmp_path / "kept"
    first = bags_identify._kept_trial(tmp_path, kept, 3, 1)
    again = bags_identify._kept_trial(tmp_path, kept, 3, 1)
    assert made == [(3, 1)]
    assert again.misses == first.misses == ["EI is not identifiable", "inertia_z"]
    assert again.found["EA"].covers(1.15)
    assert again.holds_individually("EA")
    assert not again.holds_individually("EI")
    bags_identify._kept_trial(tmp_path, kept, 4, 1)
    assert made == [(3, 1), (4, 1)]
    # The bags are gone; nothing half-written is left.
    assert sorted(path.name for path in tmp_path.rglob("*")) == [
        "identify_3_1.json", "identify_4_1.json", "kept",
    ]  # fmt: skip
