"""Whom the next SYNC waits for in lockstep: time goes on when all who keep up have done so."""

from __future__ import annotations

from rover_hil.devices import SYNC_PERIOD


class Lockstep:
    """Who keeps up with the cycles of SYNC.

    Whoever was heard once is awaited from then on: a device in each cycle, a commander in one of
    every few. Who is not heard for the patience is awaited no more until heard again, so that
    one that has gone costs its patience once. While nobody is awaited, cycles go by the wall clock.

    Args:
        patience: wall time for which one waits [s].
    """

    def __init__(self, patience: float) -> None:
        self.patience = patience
        self._latest: dict[str, tuple[int, int]] = {}

    def heard(self, name: str, cycle: int, within: int = 1) -> None:
        """Somebody has kept up.

        Args:
            name: who.
            cycle: in which.
            within: cycles in one of which it will be awaited again.
        """
        self._latest[name] = (cycle, within)

    def may_go_on(self, cycle: int, waited: float) -> bool:
        """Whether the cycle may end.

        Args:
            cycle: number of the present one.
            waited: wall time since it began [s].
        """
        late = [name for name, (at, within) in self._latest.items() if at <= cycle - within]
        if late and waited > self.patience:
            for name in late:
                del self._latest[name]
            late = []
        return not late and (bool(self._latest) or waited >= SYNC_PERIOD)
