"""Delay of messages where simulated time waits, in ticks."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cache


@dataclass(frozen=True)
class Delays:
    """Draws the delay of each message from the seed, its topic, its sender and its sequence number.

    Every host draws the same delays.

    Attributes:
        seed: of the draws.
        ticks: delays from which one is drawn, each at least 1.
    """

    seed: int = 1
    ticks: tuple[int, ...] = (1, 1, 1, 1, 1, 1, 1, 1, 1, 2)

    def __post_init__(self) -> None:
        """Refuse a delay below one tick: a message of a tick is received in a later one."""
        if not self.ticks or min(self.ticks) < 1:
            msg = f"ticks are {self.ticks}, each should be at least 1"
            raise ValueError(msg)

    def draw(self, topic: str, sender: str, sequence: int) -> int:
        """Return the delay of a message [ticks].

        Args:
            topic: or service.
            sender: name of the sending component.
            sequence: number of the message among those of the sender on the topic.
        """
        if len(self.ticks) == 1:
            return self.ticks[0]
        drawn = zlib.crc32(b"%d" % sequence, _checksum_of_stream(self.seed, topic, sender))
        return self.ticks[drawn % len(self.ticks)]


@cache
def _checksum_of_stream(seed: int, topic: str, sender: str) -> int:
    return zlib.crc32(f"{seed} {topic} {sender} ".encode())
