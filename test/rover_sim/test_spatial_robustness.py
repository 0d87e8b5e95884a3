"""Random scenarios and commands: no NaN, no created energy, no unreported failure."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_verify.checks.spatial_robust import faults, random_trial


class Drawn:
    """Random values by hypothesis, which minimises a failing trial."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data

    def uniform(self, low: float, high: float) -> float:
        return self._data.draw(st.floats(low, high))

    def choice(self, options: Sequence[str]) -> str:
        return self._data.draw(st.sampled_from(options))

    def integers(self, high: int) -> int:
        return self._data.draw(st.integers(0, high - 1))


@pytest.mark.slow
@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.data())
def test_no_random_scenario_fails_or_creates_energy(data: st.DataObject):
    wrong, _ = faults(random_trial(Drawn(data)), duration=2.0)
    assert not wrong
