"""Seeds of tests that draw at random: the same each time, or others by the variable TEST_SEED."""

from __future__ import annotations

import os

TEST_SEED = int(os.environ.get("TEST_SEED", "0"))


def seeds(count: int) -> list[int]:
    """Return as many seeds."""
    return [1000 * TEST_SEED + number for number in range(count)]
