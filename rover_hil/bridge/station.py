"""State of one device in the bridge: answers to SYNC, clock offset, frame counters."""

from __future__ import annotations

from rover_hil.bridge.clock_offset import ClockOffset
from rover_hil.canopen.devices import HEARTBEAT_TIMEOUT
from rover_hil.canopen.objects import Device, Pdo

_WRAP_US = 1 << 32


class Station:
    """State of one device.

    Attributes:
        counts, values: of its last answers, by the entries' keys; values in their units.
        complete: whether it has answered the present cycle with all TPDOs.
        has_answered: whether it has answered since its last restart.
        received_ns: last reception, by the bridge's clock; None: never.
        connected: whether it has been received since its last timeout.
        nmt_state: from its last heartbeat; None: it has sent none.
        sampled_ns: its last sample time, by its own clock, unwrapped; None: unknown.
        clock: offset of its clock from the bridge's.
        mismatch: first difference from its object dictionary; empty: none; None: not checked.
        lost: frames missing in their cycle.
        stale: frames of another cycle, or repeated ones.
        invalid: frames that are not the device's.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.counts: dict[str, int] = {}
        self.values: dict[str, float] = {}
        self.complete = self.has_answered = False
        self.received_ns: int | None = None
        self.connected = False
        self.nmt_state: int | None = None
        self.sampled_ns: int | None = None
        self._accepted_ns = 0  # when the answer with this time was received
        self.clock = ClockOffset()
        self.mismatch: str | None = None
        self.lost = self.stale = self.invalid = 0
        self._entries = device.by_key
        self._missing = {pdo.number for pdo in device.tpdos}

    def restarted(self) -> None:
        """Forget clock and answers of a device that restarted."""
        self.sampled_ns = None
        self.clock.reset()
        self.has_answered = self.complete = False
        self._missing = {pdo.number for pdo in self.device.tpdos}

    def mark_alive(self, now_ns: int) -> None:
        """Note the reception of a message."""
        self.received_ns = now_ns
        self.connected = True

    def is_alive(self, now_ns: int) -> bool:
        """Whether a message was received within the heartbeat timeout."""
        return self.received_within(HEARTBEAT_TIMEOUT, now_ns)

    def received_within(self, limit: float, now_ns: int) -> bool:
        """Whether a message was received within a limit [s]."""
        return self.received_ns is not None and now_ns - self.received_ns < limit * 1e9

    def on_tpdo(
        self, pdo: Pdo, counts: dict[str, int], counter: int, cycle_ns: int, now_ns: int
    ) -> bool:
        """Process a TPDO; returns whether it belongs to the cycle and is its first.

        Args:
            pdo: its definition.
            counts: its content.
            counter: of the cycle's SYNC.
            cycle_ns: when the SYNC was sent.
            now_ns: bridge's clock.
        """
        late = counts.get("sync_counter", counter) != counter or pdo.number not in self._missing
        sampled_ns = None
        if not late and "sample_time" in counts:
            sampled_ns = self._unwrapped(counts["sample_time"], now_ns)
            late = self.sampled_ns is not None and sampled_ns <= self.sampled_ns
        if late:
            self.stale += 1
            return False
        if sampled_ns is not None:
            self.sampled_ns = sampled_ns
            self._accepted_ns = now_ns
            answered_ns = sampled_ns + round(
                self._entries["reply_delay"].value(counts["reply_delay"]) * 1e9
            )
            self.clock.add(cycle_ns, sampled_ns, answered_ns, now_ns)
            # An answer without a new sample time does not count: its sender may hang.
            self.mark_alive(now_ns)
        self._missing.discard(pdo.number)
        self.counts |= counts
        for key, count in counts.items():
            self.values[key] = self._entries[key].value(count)
        self.has_answered = True
        self.complete = not self._missing
        return True

    def end_cycle(self, now_ns: int) -> int:
        """Count the frames missing in the ending cycle; returns their number."""
        lost = len(self._missing) if self.has_answered and self.is_alive(now_ns) else 0
        self.lost += lost
        self._missing = {pdo.number for pdo in self.device.tpdos}
        self.complete = False
        return lost

    def _unwrapped(self, sampled_us: int, now_ns: int) -> int:
        """Sample time [ns], the nearest to the one expected after the time since the last."""
        if self.sampled_ns is None:
            return sampled_us * 1000
        expected_us = (self.sampled_ns + now_ns - self._accepted_ns) // 1000
        ahead = (sampled_us - expected_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2
        return (expected_us + ahead) * 1000
