"""Lockstep: the next SYNC waits until devices and command sources have finished the cycle."""

from __future__ import annotations

from rover_hil.canopen.devices import SYNC_PERIOD


class LockstepBarrier:
    """Decides when the next cycle of SYNC may start.

    Every participant that made progress once is awaited from then on: a device in each cycle, a
    command source in one of every few. A participant that makes none within the timeout is not
    awaited until it makes progress again. Without participants, cycles follow the wall clock.

    Args:
        timeout: longest wall time to wait for a participant [s].
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._latest: dict[str, tuple[int, int]] = {}

    def on_progress(self, name: str, cycle: int, within: int = 1) -> None:
        """Note the progress of a participant.

        Args:
            name: device or topic.
            cycle: number of the cycle.
            within: cycles within which its next progress is awaited.
        """
        self._latest[name] = (cycle, within)

    def may_go_on(self, cycle: int, waited: float) -> bool:
        """Whether the next cycle may start.

        Args:
            cycle: number of the present cycle.
            waited: wall time since it began [s].
        """
        late = [name for name, (at, within) in self._latest.items() if at <= cycle - within]
        if late and waited > self.timeout:
            for name in late:
                del self._latest[name]
            late = []
        return not late and (bool(self._latest) or waited >= SYNC_PERIOD)
