"""Periodic calls by a clock that is set from outside."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rover_runtime.periodic_calls import PeriodicCalls


class Clock:
    """A clock, what is called by it, and when."""

    def __init__(self, **periods_ns: int) -> None:
        self.now_ns = 0
        self.calls = PeriodicCalls()
        self.called: list[tuple[str, int]] = []
        for name, period_ns in periods_ns.items():
            self.add(name, period_ns)

    def add(self, name: str, period_ns: int) -> None:
        self.calls.add(period_ns, lambda: self.called.append((name, self.now_ns)), self.now_ns)

    def advance(self, *times_ns: int) -> list[tuple[str, int]]:
        for now_ns in times_ns:
            self.now_ns = now_ns
            self.calls.advance(now_ns)
        return self.called


def test_each_period_is_called_once_however_often_the_time_is_updated():
    clock = Clock(a=10, b=20)
    assert clock.advance(5, 10, 10, 15, 19, 20, 20, 30) == [
        ("a", 10), ("a", 20), ("b", 20), ("a", 30),
    ]  # fmt: skip


@pytest.mark.parametrize("first", [10, 11, 19, 37, 1_000_000_007])
def test_what_was_missed_is_called_once_and_the_phase_is_kept(first: int):
    clock = Clock(a=10)
    last = first // 10 * 10
    assert clock.advance(first, last + 9, last + 10) == [("a", first), ("a", last + 10)]


def test_periods_begin_with_the_adding():
    clock = Clock(a=10)
    clock.advance(13)
    clock.add("b", 10)
    assert clock.advance(20, 22, 23)[1:] == [("a", 20), ("b", 23)]


def test_a_clock_that_was_put_back_begins_anew():
    clock = Clock(a=10)
    clock.advance(100)
    clock.now_ns = 3
    clock.calls.restart(3)
    assert clock.advance(12, 13)[1:] == [("a", 13)]


def test_a_call_that_removes_another_one_that_is_due_as_well():
    calls = PeriodicCalls()
    called = []
    removals: list[Callable[[], None]] = []

    def remove() -> None:
        removals[0]()

    calls.add(10, remove, 0)
    removals.append(calls.add(10, lambda: called.append(1), 0))
    calls.advance(10)
    assert not called


def test_what_is_added_by_a_call_waits_for_its_own_period():
    calls = PeriodicCalls()
    called: list[int] = []

    def add() -> None:
        calls.add(5, lambda: called.append(1), 10)

    calls.add(10, add, 0)
    calls.advance(10)
    assert not called
    calls.advance(15)
    assert called == [1]
