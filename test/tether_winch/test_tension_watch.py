"""The watch on the tether's tension, and the drum's hold, stepped without ROS."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msg_schemas import topics
from msg_schemas.parameters import ParameterError, from_mapping
from msg_schemas.samples import JointSample, JointValue, Level, WrenchSample
from msg_schemas.table import TOPICS, WINCH_DRUM
from tether_winch.tension_watch import TensionChange, TensionParameters, TensionState, TensionWatch
from tether_winch.winch_hold import WinchHold

NANO = 1_000_000_000
PARAMETERS = from_mapping(
    TensionParameters,
    {"weight_reference": 10.0, "hold_time": 0.2, "over_hold_time": 0.02, "hysteresis": 0.1},
)


class Cell:
    """Feeds a watch at 100 Hz and remembers the changes."""

    def __init__(self, parameters: TensionParameters = PARAMETERS) -> None:
        self.watch = TensionWatch(parameters)
        self.now_ns = 0
        self.changes: list[TensionChange] = []

    def read(self, tension: float, seconds: float = 0.01) -> TensionState:
        for _ in range(max(1, round(seconds * 100))):
            self.now_ns += NANO // 100
            sample = WrenchSample(self.now_ns, (0.6 * tension, 0.0, -0.8 * tension))
            change = self.watch.hear(sample, self.now_ns)
            if change is not None:
                self.changes.append(change)
        return self.watch.state


def test_before_the_first_sample_the_tension_is_not_known():
    watch = TensionWatch(PARAMETERS)
    assert watch.state is TensionState.UNKNOWN
    assert math.isnan(watch.tension)


@pytest.mark.parametrize(
    ("tension", "state"),
    [(10.0, TensionState.NORMAL), (1.0, TensionState.SLACK), (50.0, TensionState.OVER_TENSION)],
)
def test_the_first_sample_says_how_it_stands(tension: float, state: TensionState):
    cell = Cell()
    assert cell.read(tension) is state
    assert cell.watch.tension == pytest.approx(tension)


def test_slack_is_believed_after_the_hold_time_not_before():
    cell = Cell()
    cell.read(10.0, 1.0)
    assert cell.read(4.9, 0.2) is TensionState.NORMAL
    assert cell.read(4.9, 0.01) is TensionState.SLACK
    assert cell.changes[-1].reason == "tension 4.9 N"


def test_a_bounce_shorter_than_the_hold_time_is_no_slack():
    cell = Cell()
    cell.read(10.0, 1.0)
    for _ in range(20):
        assert cell.read(0.0, 0.15) is TensionState.NORMAL
        assert cell.read(12.0, 0.05) is TensionState.NORMAL


def test_slack_is_taken_back_only_beyond_the_hysteresis():
    cell = Cell()
    cell.read(1.0, 1.0)
    assert cell.read(5.9, 1.0) is TensionState.SLACK
    assert cell.read(6.1, 1.0) is TensionState.NORMAL
    assert cell.read(5.1, 1.0) is TensionState.NORMAL


def test_too_much_tension_is_told_soon_and_taken_back_beyond_the_hysteresis():
    cell = Cell()
    cell.read(10.0, 1.0)
    assert cell.read(41.0, 0.02) is TensionState.NORMAL
    assert cell.read(41.0, 0.01) is TensionState.OVER_TENSION
    assert cell.read(39.5, 1.0) is TensionState.OVER_TENSION
    assert cell.read(38.0, 1.0) is TensionState.NORMAL
    assert TensionState.OVER_TENSION.level is Level.ERROR


def test_silence_makes_it_unknown_and_a_sample_known_again():
    cell = Cell()
    cell.read(10.0, 1.0)
    assert cell.watch.check(0.5) is None
    change = cell.watch.check(0.51)
    assert change is not None
    assert change.state is TensionState.UNKNOWN
    assert "silent for more than 0.51 s" in change.reason
    assert math.isnan(cell.watch.tension)
    assert cell.watch.check(5.0) is None
    assert cell.read(10.0) is TensionState.NORMAL


def test_a_reading_beyond_the_range_is_not_valid():
    cell = Cell(replace(PARAMETERS, largest_force=100.0))
    cell.read(10.0, 1.0)
    assert cell.read(101.0) is TensionState.UNKNOWN
    assert "beyond its range of 100 N" in cell.changes[-1].reason


def test_the_direction_of_the_pull_does_not_matter():
    for force in ((8.0, 0.0, 0.0), (0.0, -8.0, 0.0), (0.0, 0.0, 8.0)):
        watch = TensionWatch(PARAMETERS)
        watch.hear(WrenchSample(0, force), 0)
        assert watch.tension == 8.0


def test_thresholds_that_leave_nothing_between_them_are_refused():
    with pytest.raises(ParameterError, match="further apart"):
        from_mapping(TensionParameters, {"slack_below": 0.9, "over_above": 1.0, "hysteresis": 0.1})


@given(st.lists(st.floats(0.0, 200.0), min_size=1, max_size=300))
def test_no_state_contradicts_what_was_read_throughout_the_hold_time(tensions: list[float]):
    cell = Cell()
    held = round(PARAMETERS.hold_time * 100) + 1
    for index, tension in enumerate(tensions):
        state = cell.read(tension)
        recent = tensions[max(0, index - held) : index + 1]
        if len(recent) > held:
            if max(recent) < 5.0:
                assert state is TensionState.SLACK
            if min(recent) > 6.0 and max(recent) < 38.0:
                assert state is TensionState.NORMAL
            if min(recent) > 40.0:
                assert state is TensionState.OVER_TENSION


def test_every_state_is_a_word_of_the_contract():
    assert {state.value for state in TensionState} == {*TOPICS[topics.TENSION_WATCH].words}


# ------------------------------------------------------------------------------------- drum's hold


def drum(length: float, stamp_ns: int = 0) -> JointSample:
    return JointSample(stamp_ns, {WINCH_DRUM: JointValue(length, 0.0, 1.0)})


def test_the_drum_is_not_commanded_before_it_has_spoken():
    assert WinchHold(100.0).command() is None


def test_the_first_length_is_held_whatever_comes_after():
    hold = WinchHold(100.0)
    for length in (5.0, 5.1, 4.0):
        hold.hear(drum(length))
        assert hold.command() == (5.0, 0.0, 100.0)
