"""How an emulated machine keeps pace: by SYNC, by the wall clock, and never without saying so."""

from __future__ import annotations

import pytest

from rover_hil.emulator.tick_scheduler import TickScheduler

PERIOD = 0.005


class World:
    """A wall clock, and a computer that needs some time for a tick."""

    def __init__(self, cost: float) -> None:
        self.scheduler = TickScheduler(PERIOD)
        self.wall = 100.0
        self.ticks: list[float] = []
        self._cost = cost

    def run(self, seconds: float, first_sync: float | None = 0.0) -> None:
        """Run; SYNC comes every period from a time after the beginning on, or never."""
        end = self.wall + seconds
        sync = None if first_sync is None else self.wall + first_sync
        while self.wall < end:
            tick_at = self.wall + self.scheduler.wait(self.wall)
            if sync is not None and sync <= tick_at:
                self.wall = max(self.wall, sync)
                self.scheduler.synchronise(self.wall)
                sync += PERIOD
            else:
                self.wall = max(self.wall, tick_at)
            due = self.scheduler.due(self.wall)
            self.wall += 1e-6  # every step takes some time
            if due:
                self.ticks.append(self.wall)
                self.wall += self._cost


@pytest.mark.parametrize("first_sync", [0.0, 0.001, 0.004, None])
def test_simulated_time_follows_the_wall_clock_with_and_without_sync(first_sync: float | None):
    world = World(cost=0.001)
    world.run(5.0, first_sync)
    assert len(world.ticks) == pytest.approx(1000, abs=2)
    assert world.scheduler.dropped == 0.0
    assert world.scheduler.measured == pytest.approx(1.0, abs=0.01)
    assert world.scheduler.is_real_time(world.wall)


def test_a_tick_follows_the_answers_and_commands():
    world = World(cost=0.001)
    world.run(2.0, first_sync=0.002)
    begun = 100.002
    phases = [(tick - begun) / PERIOD % 1.0 for tick in world.ticks[200:]]
    assert min(phases) > 0.5
    assert max(phases) < 0.7


def test_a_slow_computer_is_reported_and_its_dropped_time_is_counted():
    world = World(cost=0.008)
    world.run(10.0)
    assert not world.scheduler.is_real_time(world.wall)
    assert world.scheduler.measured == pytest.approx(PERIOD / 0.008, rel=0.05)
    missing = 10.0 - len(world.ticks) * PERIOD
    assert world.scheduler.dropped == pytest.approx(missing, abs=0.25)


def test_real_time_is_not_reported_before_it_is_measured():
    scheduler = TickScheduler(PERIOD)
    scheduler.synchronise(0.0)
    assert scheduler.due(0.004)
    assert not scheduler.is_real_time(0.004)


def test_a_short_stall_is_caught_up_and_a_long_one_is_dropped():
    world = World(cost=0.001)
    world.run(1.0)
    world.wall += 0.1
    world.run(1.0, first_sync=None)
    assert world.scheduler.dropped == 0.0
    assert len(world.ticks) == pytest.approx(420, abs=3)
    world.wall += 1.0
    world.run(0.5, first_sync=None)
    assert world.scheduler.dropped == pytest.approx(1.0, abs=0.02)
    assert not world.scheduler.is_real_time(world.wall)
