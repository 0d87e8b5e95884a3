"""Commands as a controller would send them: streamed at 20 Hz of simulated time."""

from __future__ import annotations

from collections.abc import Callable

from msg_schemas import topics
from msg_schemas.table import JUMP_SCREW
from rover_verify.stage import Observer

PERIOD_NS = 50_000_000


def drive_nut(
    observer: Observer,
    compression: float,
    speed: float,
    until: Callable[[], bool],
    limit: float = 60.0,
) -> None:
    """Drive the nut until a condition holds, looked at before each command.

    Args:
        observer: who commands.
        compression: setpoint [m].
        speed: nut speed [m/s].
        until: the condition.
        limit: AssertionError after this much simulated time [s].
    """
    begin = now = observer.wait_for_time(1)
    while not until():
        assert now - begin < limit * 1e9, f"not reached within {limit:g} s of simulated time"
        observer.send_joint(topics.JUMP_MOTOR_COMMAND, JUMP_SCREW, compression, speed, 400.0)
        now = observer.wait_for_time(observer.time_ns() + PERIOD_NS)


def has_event(observer: Observer, name: str, since: int = 0) -> Callable[[], bool]:
    """Whether an event has come, as a condition for ``drive_nut``."""
    feed = observer.listen(topics.EVENTS)
    return lambda: any(s.name == name for e in feed.samples[since:] for s in e.statuses)
