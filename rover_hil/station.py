"""What the bridge knows of one device: its answers to SYNC, its clock, what was lost."""

from __future__ import annotations

from rover_hil.clock_offset import ClockOffset
from rover_hil.devices import HEARTBEAT_LIMIT
from rover_hil.objects import Device, Pdo

_WRAP_US = 1 << 32
_FORWARD_US = _WRAP_US // 2


class Station:
    """One device.

    Attributes:
        counts, values: of its last answers, by the entries' keys; values in their units.
        complete: whether it has answered the present cycle fully.
        heard_ns: when it was heard last, by the bridge's clock; None: never.
        was_heard: whether its silence is still to be told.
        nmt_state: told by its last heartbeat; None before.
        sampled_ns: its last sample time, by its own clock, without wraps; None before.
        clock: its clock's offset from the bridge's.
        mismatch: what it is otherwise than its dictionary; empty: nothing; None: not asked yet.
        lost: frames that did not come in their cycle.
        stale: frames of another cycle, or repeated ones.
        strange: frames that are none of the device's.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.counts: dict[str, int] = {}
        self.values: dict[str, float] = {}
        self.complete = False
        self.heard_ns: int | None = None
        self.was_heard = False
        self.nmt_state: int | None = None
        self.sampled_ns: int | None = None
        self.clock = ClockOffset()
        self.mismatch: str | None = None
        self.lost = self.stale = self.strange = 0
        self._entries = device.by_key
        self._missing = {pdo.number for pdo in device.tells}
        self._answers = False

    def restarted(self) -> None:
        """Its clock and counters begin anew."""
        self.sampled_ns = None
        self.clock.reset()
        self._answers = self.complete = False
        self._missing = {pdo.number for pdo in self.device.tells}

    def hear(self, now_ns: int) -> None:
        """Something was heard of it."""
        self.heard_ns = now_ns
        self.was_heard = True

    def is_heard(self, now_ns: int) -> bool:
        """Whether it was heard within the limit."""
        return self.was_heard_within(HEARTBEAT_LIMIT, now_ns)

    def was_heard_within(self, limit: float, now_ns: int) -> bool:
        """Whether it was heard less than so long ago [s]."""
        return self.heard_ns is not None and now_ns - self.heard_ns < limit * 1e9

    def take(
        self, pdo: Pdo, counts: dict[str, int], counter: int, cycle_ns: int, now_ns: int
    ) -> bool:
        """Take a TPDO; returns whether it belongs to the cycle and is the first of its kind.

        Args:
            pdo: which one.
            counts: its content.
            counter: of the cycle's SYNC.
            cycle_ns: when that was sent.
            now_ns: bridge's clock.
        """
        late = counts.get("cycle", counter) != counter or pdo.number not in self._missing
        sampled_ns = None
        if not late and "sampled" in counts:
            sampled_ns = self._unwrapped(counts["sampled"])
            late = self.sampled_ns is not None and sampled_ns <= self.sampled_ns
        if late:
            self.stale += 1
            return False
        if sampled_ns is not None:
            self.sampled_ns = sampled_ns
            answered_ns = sampled_ns + round(
                self._entries["replied"].value(counts["replied"]) * 1e9
            )
            self.clock.add(cycle_ns, sampled_ns, answered_ns, now_ns)
            # Answers without a new sample time are no news: whoever sends them may hang.
            self.hear(now_ns)
        self._missing.discard(pdo.number)
        self.counts |= counts
        for key, count in counts.items():
            self.values[key] = self._entries[key].value(count)
        self._answers = True
        self.complete = not self._missing
        return True

    def end_cycle(self, now_ns: int) -> int:
        """Count what did not come in the cycle that ends; returns it."""
        lost = len(self._missing) if self._answers and self.is_heard(now_ns) else 0
        self.lost += lost
        self._missing = {pdo.number for pdo in self.device.tells}
        self.complete = False
        return lost

    def _unwrapped(self, sampled_us: int) -> int:
        if self.sampled_ns is None:
            return sampled_us * 1000
        before_us = self.sampled_ns // 1000
        step = (sampled_us - before_us) % _WRAP_US
        # Backwards is a repeated or a late frame.
        step -= _WRAP_US if step >= _FORWARD_US else 0
        return (before_us + step) * 1000
