"""Holds the drum where it stands. Pure."""

from __future__ import annotations

from typing import NamedTuple

from msg_schemas.samples import JointSample
from msg_schemas.table import WINCH_DRUM


class DrumCommand(NamedTuple):
    """What the drum is to do."""

    length: float  # [m]
    rate: float  # [m/s]
    tension: float  # largest that the drive may use [N]


class WinchHold:
    """Takes the length at which the drum stands when it begins, and holds that.

    Args:
        tension_limit: largest tension that the drive may use [N].
    """

    def __init__(self, tension_limit: float) -> None:
        self.tension_limit = tension_limit
        self._length: float | None = None

    @property
    def length(self) -> float | None:
        """Length that is held [m]; None = the drum has not spoken yet."""
        return self._length

    def hear(self, sample: JointSample) -> None:
        """Take a sample of the drum's state; the first says what is held."""
        if self._length is None:
            self._length = sample.joints[WINCH_DRUM].position

    def command(self) -> DrumCommand | None:
        """What to tell the drum; None before it has spoken."""
        return None if self._length is None else DrumCommand(self._length, 0.0, self.tension_limit)
