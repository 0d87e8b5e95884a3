"""Momentum of a rotor by time. Pure."""

from __future__ import annotations

from collections import deque

_KEPT = 32  # samples


class RotorMomentum:
    """Momentum of a rotor at the times of its last samples [N m s]; zero before the first."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    @property
    def newest_ns(self) -> int:
        """Time of the newest sample [ns]; 0 = none."""
        return self._samples[-1][0] if self._samples else 0

    @property
    def newest(self) -> float:
        """Momentum of the newest sample [N m s]."""
        return self._samples[-1][1] if self._samples else 0.0

    def add(self, stamp_ns: int, momentum: float) -> None:
        """Add a sample [N m s]; one that is older than the newest is dropped."""
        if not self._samples or stamp_ns > self.newest_ns:
            self._samples.append((stamp_ns, momentum))

    def at(self, stamp_ns: int) -> float:
        """Return the momentum at a time [N m s], interpolated between the samples."""
        after_ns, after = self.newest_ns, self.newest
        for before_ns, before in reversed(self._samples):
            if before_ns <= stamp_ns:
                if stamp_ns >= after_ns:
                    return after
                share = (stamp_ns - before_ns) / (after_ns - before_ns)
                return before + share * (after - before)
            after_ns, after = before_ns, before
        return after
