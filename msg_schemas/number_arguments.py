"""Numbers on command lines, refused in one line when they lie outside their range."""

from __future__ import annotations

import argparse
from collections.abc import Callable

LARGEST_SEED = 2**31 - 1


def whole_number(minimum: int, maximum: int = 2**31 - 1) -> Callable[[str], int]:
    """Return a `type` for argparse that reads a whole number within limits, both included."""

    def read(text: str) -> int:
        expected = f"{text[:40]!r} should be a whole number from {minimum} to {maximum}"
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(expected) from None
        if not minimum <= value <= maximum:
            raise argparse.ArgumentTypeError(expected)
        return value

    return read


def finite_number(minimum: float, maximum: float) -> Callable[[str], float]:
    """Return a `type` for argparse that reads a number within limits, both included."""

    def read(text: str) -> float:
        expected = f"{text[:40]!r} should be a number from {minimum:g} to {maximum:g}"
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(expected) from None
        if not minimum <= value <= maximum:
            raise argparse.ArgumentTypeError(expected)
        return value

    return read


seed = whole_number(0, LARGEST_SEED)
"""The `type` of a seed of random numbers."""
positive = whole_number(1)
"""The `type` of a number of things."""
