"""Stops of a descent. Pure."""

from __future__ import annotations

from typing import NamedTuple


class DescentStop(NamedTuple):
    """A stop of the descent."""

    depth: float  # length at the drum [m]
    observes: bool  # pictures are taken there
    rate: float  # largest payout rate to it [m/s]


class PresentStop(NamedTuple):
    """A stop that the rover travels to or is at."""

    stop: DescentStop
    is_at: bool  # the winch is at its depth or travels to it
    is_settling: bool  # damping has ended
