"""When a recorder can be relied on: it writes, and not only what was latched."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.samples import Status
from rover_verify.stage.observer import Observer

# By then every topic of 100 Hz has found its way: discovery is over.
_MESSAGES = 400


def is_recording(status: Status) -> bool:
    """Whether a status of the diagnostics is that of a recorder in full flow."""
    messages = status.values.get("messages", "0")
    return status.name == "bag_record: bag" and messages.isdigit() and int(messages) >= _MESSAGES


def wait_until_recording(observer: Observer, since: int = 0) -> None:
    """Wait until the recorder says that it has written enough."""
    observer.wait_for_status(topics.DIAGNOSTICS, is_recording, since)
