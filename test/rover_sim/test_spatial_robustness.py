"""Random scenarios and commands: no NaN, no created energy, no unreported failure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_verify.checks.spatial_robust import faults, random_trial


@pytest.mark.slow
@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 2**32))
def test_no_random_scenario_fails_or_creates_energy(seed: int):
    wrong, _ = faults(random_trial(np.random.default_rng(seed)), duration=2.0)
    assert not wrong
