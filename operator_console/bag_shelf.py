"""The replayable bags of one folder; the page can request no other file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from operator_console.replay import Replay, read_replay
from rover_bags.files.folder import is_bag_file
from rover_bags.files.store import BagError


class ShelfError(ValueError):
    """The bag does not exist or cannot be read."""


class BagShelf:
    """The bags in a folder; None: no bags."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._last: tuple[Path, int, float] | None = None
        self._last_text = ""

    def listed(self) -> list[dict[str, Any]]:
        """Name, size [B] and modification time [s since 1970] of each bag, the newest first."""
        found = [
            {"name": name, "size": size, "changed": changed}
            for name, (_, size, changed) in self._bags().items()
        ]
        return sorted(found, key=lambda bag: -float(bag["changed"]))

    def replay(self, name: str) -> str:
        """A bag as JSON; the last result is cached.

        Raises:
            ShelfError: no such bag, or it cannot be read.
        """
        bags = self._bags()
        if name not in bags:
            raise ShelfError(f"there is no bag {name!r} in the folder")
        if bags[name] == self._last:
            return self._last_text
        path = bags[name][0]
        try:
            made: Replay = read_replay(path)
        except (BagError, ValueError, OSError) as error:
            raise ShelfError(f"{name}: {error}") from error
        self._last_text = json.dumps(vars(made), separators=(",", ":"), allow_nan=False)
        self._last = bags[name]
        return self._last_text

    def _bags(self) -> dict[str, tuple[Path, int, float]]:
        if self.folder is None:
            return {}
        found: dict[str, tuple[Path, int, float]] = {}
        with suppress(OSError):
            for path in self.folder.iterdir():
                states = tuple(_states(path))
                if states:
                    size = sum(state.st_size for state in states)
                    found[path.name] = path, size, max(state.st_mtime for state in states)
        return found


def _states(path: Path) -> Iterator[os.stat_result]:
    """States of the regular files of a bag; of none if there is no bag that can be read."""
    with suppress(OSError):  # a link without a target, a file that has just been deleted
        files = tuple(path.iterdir()) if path.is_dir() else (path,)
        readable = [file for file in files if file.is_file()]
        if any(is_bag_file(file) for file in readable):
            yield from (file.stat() for file in readable)
