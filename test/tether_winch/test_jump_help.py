"""A jump with the winch's help on the spatial plant equals the jump without a tether."""

from __future__ import annotations

import pytest

from rover_verify.checks.winch_jump import Jump, free_jump, helped_jump

pytestmark = pytest.mark.usefixtures("compiled_in_space")


def test_the_winch_gives_slack_keeps_still_and_takes_up_softly():
    jump = Jump(depth=5.0, away=2.3, slope=12.0, stroke=0.17)
    free, helped = free_jump(jump, 1), helped_jump(jump, 1)
    assert free.range > 0.1
    assert helped.range == pytest.approx(free.range, rel=0.1)
    assert helped.time == pytest.approx(free.time, rel=0.03)
    assert helped.peak_tension < 30.0
    assert helped.reeled_in == 0.0
    assert helped.slack_left < 0.1
