"""Flights of a batch: each kept, in their order, flown once."""

from __future__ import annotations

from pathlib import Path

from rover_verify.checks.flights import fly_kept
from rover_verify.checks.hanging import HangingDescent


def test_a_flight_that_is_kept_is_not_flown_again(tmp_path: Path):
    flown: list[tuple[int, int, str]] = []

    def descend(seed: int, index: int, mode: str) -> HangingDescent:
        flown.append((seed, index, mode))
        return HangingDescent(100.0 + index, 6, ("a cone",), 0, (), 0, 0)

    kept = tmp_path / "kept"
    first = [fly_kept(kept, descend, 3, index, "winch only") for index in range(2)]
    again = [fly_kept(kept, descend, 3, index, "winch only") for index in range(3)]
    assert again[:2] == first
    assert again[2].duration == 102.0
    fly_kept(kept, descend, 4, 0, "winch only")
    fly_kept(kept, descend, 3, 0, "everything")
    assert flown == [
        (3, 0, "winch only"),
        (3, 1, "winch only"),
        (3, 2, "winch only"),
        (4, 0, "winch only"),
        (3, 0, "everything"),
    ]
    # Of one that was stopped while it was kept, nothing is there.
    assert not list(kept.glob("*.partial"))


def test_without_a_folder_every_flight_is_flown():
    flown = []
    for _ in range(2):
        fly_kept(None, lambda seed, index: flown.append((seed, index)), 1, 2)
    assert flown == [(1, 2), (1, 2)]
