"""Jumps with the winch's help: as without a tether, and with the slack that they need."""

from __future__ import annotations

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent
from msg_schemas.samples import PoseEstimateSample
from rover_verify.checks.winch_jump import AssistedJump, Trip, free_jump, helped_jump

pytestmark = pytest.mark.usefixtures("compiled_in_space")


def test_the_winch_gives_slack_keeps_still_and_takes_up_softly():
    jump = AssistedJump(depth=5.0, away=2.3, slope=12.0, stroke=0.17)
    free, helped = free_jump(jump, 1), helped_jump(jump, 1)
    assert free.range > 0.1
    assert helped.range == pytest.approx(free.range, rel=0.1)
    assert helped.time == pytest.approx(free.time, rel=0.03)
    assert helped.peak_tension < 30.0
    assert helped.reeled_in == 0.0
    assert helped.slack_left < 0.1


def test_a_jump_by_clearance_begins_when_the_winch_has_given_the_slack_that_it_needs():
    jump = AssistedJump(depth=5.0, away=3.5, slope=13.0, stroke=0.19)
    trip = Trip(jump, 1)
    trip.take_up()
    flight = trip.flight
    tail_downhill = (0.0, 0.0, 1.0, 0.0)
    start = PoseEstimateSample(0, (float(flight.state.G1[0]), 0.0, 0.0), tail_downhill)
    flight.host.request(topics.DRIVE_START, start)
    flight.run(0.5)
    taut = flight.state.length
    flight.request(topics.JUMP_REQUEST, machine.JUMP_CLEARANCE, 0.33)
    assert flight.run(20.0, lambda: bool(flight.events_named(JumpEvent.COMPRESSING)))
    (requested,) = flight.events_named(JumpEvent.GIVING_SLACK)
    (begun,) = flight.events_named(JumpEvent.COMPRESSING)
    assert begun.time - requested.time < 6.0
    assert flight.state.length > taut + 0.5
