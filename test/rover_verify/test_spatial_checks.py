"""Quick runs of the spatial plant's checks whose signs are easily wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from rover_verify.checks import Check, CheckBatch, spatial_ground, spatial_machine


@pytest.mark.parametrize(
    ("check", "limit"),
    [
        (spatial_ground.block, 0.01),
        (spatial_ground.bounce, 0.02),
        (spatial_machine.flywheel, 0.01),
    ],
)
def test_a_run_stays_within_its_limit(check: Check, limit: float, tmp_path: Path):
    measured = check(CheckBatch(1, 3, tmp_path))
    assert measured.value < limit
    assert len(measured.details) > 0
