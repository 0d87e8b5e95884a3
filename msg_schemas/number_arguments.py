"""Numbers on command lines, refused in one line when they lie outside their range."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TypeVar

LARGEST_SEED = 2**31 - 1

N = TypeVar("N", int, float)


def whole_number(minimum: int, maximum: int = 2**31 - 1) -> Callable[[str], int]:
    """Return a `type` for argparse that reads a whole number within limits, both included."""
    return _within(int, minimum, maximum, f"a whole number from {minimum} to {maximum}")


def finite_number(minimum: float, maximum: float) -> Callable[[str], float]:
    """Return a `type` for argparse that reads a number within limits, both included."""
    return _within(float, minimum, maximum, f"a number from {minimum:g} to {maximum:g}")


def _within(kind: Callable[[str], N], minimum: N, maximum: N, about: str) -> Callable[[str], N]:
    def read(text: str) -> N:
        expected = f"{text[:40]!r} should be {about}"
        try:
            value = kind(text)
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
