"""How an emulated machine keeps pace: by SYNC, by the wall clock, and never without saying so."""

from __future__ import annotations

import pytest

from msg_schemas import topics
from msg_schemas.parameters import ParameterError
from rover_hil.bridge_node import awaited_topics
from rover_hil.emulator.tick_scheduler import TickScheduler

PERIOD = 0.005


class World:
    """A wall clock, and a machine that computes a tick in some time."""

    def __init__(self, cost: float) -> None:
        self.pace = TickScheduler(PERIOD)
        self.wall = 100.0
        self.ticks: list[float] = []
        self._cost = cost

    def run(self, seconds: float, first_sync: float | None = 0.0) -> None:
        """Run; SYNC comes every period from a time after the beginning on, or never."""
        end = self.wall + seconds
        sync = None if first_sync is None else self.wall + first_sync
        while self.wall < end:
            tick_at = self.wall + self.pace.wait(self.wall)
            if sync is not None and sync <= tick_at:
                self.wall = max(self.wall, sync)
                self.pace.synchronise(self.wall)
                sync += PERIOD
            else:
                self.wall = max(self.wall, tick_at)
            due = self.pace.due(self.wall)
            self.wall += 1e-6  # nothing takes no time at all
            if due:
                self.ticks.append(self.wall)
                self.wall += self._cost


@pytest.mark.parametrize("first_sync", [0.0, 0.001, 0.004, None])
def test_time_goes_as_fast_as_the_wall_clock_s_with_sync_or_without(first_sync: float | None):
    world = World(cost=0.001)
    world.run(5.0, first_sync)
    assert len(world.ticks) == pytest.approx(1000, abs=2)
    assert world.pace.given_up == 0.0
    assert world.pace.measured == pytest.approx(1.0, abs=0.01)
    assert world.pace.is_real_time(world.wall)


def test_ticks_come_when_answers_and_commands_have_passed():
    world = World(cost=0.001)
    world.run(2.0, first_sync=0.002)
    begun = 100.002
    phases = [(tick - begun) / PERIOD % 1.0 for tick in world.ticks[200:]]
    assert min(phases) > 0.5
    assert max(phases) < 0.7


def test_a_machine_that_is_too_slow_says_so_and_counts_what_it_gave_up():
    world = World(cost=0.008)
    world.run(10.0)
    assert not world.pace.is_real_time(world.wall)
    assert world.pace.measured == pytest.approx(PERIOD / 0.008, rel=0.05)
    missing = 10.0 - len(world.ticks) * PERIOD
    assert world.pace.given_up == pytest.approx(missing, abs=0.25)


def test_nothing_is_claimed_before_it_is_known():
    pace = TickScheduler(PERIOD)
    pace.synchronise(0.0)
    assert pace.due(0.004)
    assert not pace.is_real_time(0.004)


def test_a_short_stall_is_caught_up_and_a_long_one_is_given_up():
    world = World(cost=0.001)
    world.run(1.0)
    world.wall += 0.1
    world.run(1.0, first_sync=None)
    assert world.pace.given_up == 0.0
    assert len(world.ticks) == pytest.approx(420, abs=3)
    world.wall += 1.0
    world.run(0.5, first_sync=None)
    assert world.pace.given_up == pytest.approx(1.0, abs=0.02)
    assert not world.pace.is_real_time(world.wall)


def test_topics_that_lockstep_waits_for_must_be_commands():
    assert awaited_topics("") == ()
    wanted = (topics.WINCH_COMMAND, topics.FLYWHEEL_COMMAND)
    assert awaited_topics(", ".join(wanted)) == wanted
    with pytest.raises(ParameterError, match=topics.WINCH_REQUEST):
        awaited_topics(topics.WINCH_REQUEST)
