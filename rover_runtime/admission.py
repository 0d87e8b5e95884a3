"""Admission of messages: well-formed samples, commands in order, one command source per motor.

A command source names itself in ``header.frame_id``, which has no other meaning in a command, since
`rclpy` does not report the publisher of a message. The first accepted command source owns the
motor, on all topics that command it, until it has sent nothing for the timeout of its last command.
All unnamed command sources count as one. The order of commands is that of each command source:
messages of others may be delayed, or their clocks ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from msg_schemas.cdr import header, unpack
from msg_schemas.checks import check_age
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.specifications import Topic
from msg_schemas.text_limits import printable
from rover_runtime.port import Message

UNNAMED = "an unnamed command source"
_SOURCES = 1000  # command sources on a topic whose last stamp is known


def read_message(topic: Topic, data: bytes) -> Message:
    """Return a serialized message as received, with its sample or why it holds none."""
    sender, stamp_ns = "", 0
    try:
        if topic.is_command:
            stamp_ns, sender = header(topic.name, data)
            sender = printable(sender)
        return Message(sender, stamp_ns, unpack(topic.name, data))
    except Refusal as refusal:
        return Message(sender, stamp_ns, refusal)


class _Owner(NamedTuple):
    name: str
    until_ns: int


class Admission:
    """Checks the order, the age and the source of messages."""

    def __init__(self) -> None:
        self._last_stamps: dict[str, dict[str, int]] = {}  # by topic and command source
        self._owners: dict[str, _Owner] = {}

    def admit(self, row: Topic, message: Message, now_ns: int) -> Any:
        """Return the sample of a message.

        Args:
            row: specification of the topic.
            message: received on the topic.
            now_ns: receiver's clock [ns].

        Raises:
            Refusal: the message violates the contract, is out of order, or comes from a command
                source that does not own the motor.
        """
        if isinstance(message.content, Refusal):
            raise message.content
        sample: Any = check_age(row, message.content, now_ns)
        if not row.is_command:
            return sample
        if row.owned:
            self._check_owner(row, message.sender or UNNAMED, now_ns)
        self._check_order(row.name, message.sender, sample.stamp_ns)
        return sample

    def accepted(self, row: Topic, message: Message, now_ns: int) -> None:
        """Record that an admitted command was executed.

        None of its command source with an earlier stamp may follow; it owns the motor.
        """
        stamps = self._last_stamps.setdefault(row.name, {})
        stamps.pop(message.sender, None)
        stamps[message.sender] = message.stamp_ns or now_ns
        if len(stamps) > _SOURCES:
            del stamps[next(iter(stamps))]
        if row.owned:
            until_ns = now_ns + round(row.stale.timeout * 1e9)
            self._owners[row.owned] = _Owner(message.sender or UNNAMED, until_ns)

    def owners(self, now_ns: int) -> Mapping[str, str]:
        """Return the command source of each owned motor."""
        owners = self._owners.copy().items()
        return {name: owner.name for name, owner in owners if now_ns < owner.until_ns}

    def forget(self) -> None:
        """Forget owners and stamps, because the clock has gone back."""
        self._last_stamps.clear()
        self._owners.clear()

    def _check_owner(self, row: Topic, who: str, now_ns: int) -> None:
        owner = self._owners.get(row.owned)
        if owner is None or owner.name == who or now_ns >= owner.until_ns:
            return
        left = (owner.until_ns - now_ns) * 1e-9
        raise Refusal(
            row.name,
            RefusalCode.OWNED,
            f"commanded by {who}, but {owner.name} owns {row.owned} until its commands time out "
            f"({left:.3f} s from now at the earliest)",
        )

    def _check_order(self, name: str, sender: str, stamp_ns: int) -> None:
        last = self._last_stamps.get(name, {}).get(sender, 0)
        if stamp_ns < last:
            late = (last - stamp_ns) * 1e-9
            reason = f"stamped {late:.3f} s before the last accepted one, stamps must not go back"
            raise Refusal(name, RefusalCode.OUT_OF_ORDER, reason)
