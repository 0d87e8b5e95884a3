"""Simulated time by SYNC: waits for the devices' end, and follows it."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import pytest

from rover_hil.bridge import sync_source
from rover_hil.bridge.bridge_node import BridgeNode
from rover_hil.bridge.sync_source import SYNC_PERIOD_NS, SyncSource, cycle_over
from rover_hil.canopen.devices import SYNC_PERIOD

LIMIT = 0.1  # [s]


class DevicesEnd:
    """Answers each SYNC at once, unless it is silent."""

    def __init__(self) -> None:
        self.stamp_ns = 7 * SYNC_PERIOD_NS
        self.is_silent = False
        self.counter = 0
        self.stamps: list[int] = []
        self.went_back = 0
        self.waits: list[float] = []
        self._frames: deque[bytes] = deque()
        self.source = SyncSource(self._begin_cycle, self._dispatch, self._go_back)
        self.source.on_cycle_over(cycle_over(0, self.stamp_ns))

    def _begin_cycle(self, stamp_ns: int) -> int:
        self.counter += 1
        self.stamps.append(stamp_ns)
        if not self.is_silent:
            self.stamp_ns += SYNC_PERIOD_NS
            self._frames += [b"an answer", cycle_over(self.counter, self.stamp_ns)]
        return self.counter

    def _dispatch(self, wait: float) -> bool:
        if not self._frames:
            self.waits.append(wait)
            return False
        self.source.on_cycle_over(self._frames.popleft())
        return True

    def _go_back(self) -> None:
        self.went_back += 1


def test_time_is_that_of_the_devices_end_from_the_start():
    end = DevicesEnd()
    assert end.source.is_known
    for _ in range(3):
        assert end.source.next_ns == end.stamp_ns + SYNC_PERIOD_NS
        end.source.advance()
    assert end.stamps == [each * SYNC_PERIOD_NS for each in (8, 9, 10)]
    assert end.source.stamp_ns == end.stamp_ns == 10 * SYNC_PERIOD_NS
    assert set(end.waits) == {0.0}


def test_time_goes_back_with_the_devices_end():
    end = DevicesEnd()
    end.source.advance()
    end.stamp_ns = 0
    end.source.advance()
    assert (end.source.stamp_ns, end.went_back) == (SYNC_PERIOD_NS, 1)


def test_a_silent_end_is_awaited_once_and_then_cycles_follow_the_wall_clock(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(sync_source, "ANSWER_LIMIT", LIMIT)
    end = DevicesEnd()
    end.source.advance()
    end.is_silent = True
    longest = []
    for _ in range(2):
        end.waits.clear()
        end.source.advance()
        longest.append(max(end.waits))
    assert longest[0] > 0.9 * LIMIT
    assert longest[1] <= SYNC_PERIOD
    assert end.source.stamp_ns == 10 * SYNC_PERIOD_NS
    end.is_silent = False
    end.source.advance()
    assert end.source.stamp_ns == end.stamp_ns == 9 * SYNC_PERIOD_NS
    assert end.went_back == 1


def test_a_time_of_day_that_is_set_back_makes_no_later_command_old():
    clock = [round(100e9)]
    forgotten: list[int] = []
    node = SimpleNamespace(
        now_ns=lambda: clock[0],
        reception=SimpleNamespace(forget_stamps=lambda: forgotten.append(clock[0])),
        _stamp_ns=0,
    )
    stamps = []
    for now_ns in (100_000_000_000, 100_004_000_000, 100_003_000_000, 40_000_000_000):
        clock[0] = now_ns
        stamps.append(BridgeNode._next_stamp(node))  # type: ignore[arg-type]
    assert stamps == [100_000_000_000, 100_004_000_000, 100_009_000_000, 40_000_000_000]
    assert forgotten == [40_000_000_000]
