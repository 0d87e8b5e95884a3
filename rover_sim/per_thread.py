"""What each thread needs one of its own of."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class PerThread(threading.local, Generic[T]):
    """One thing for each thread, made when the thread first asks.

    Args:
        make: makes it.
    """

    def __init__(self, make: Callable[[], T]) -> None:  # called anew by each thread
        self._make = make
        self._own: T | None = None

    def own(self) -> T:
        """This thread's."""
        if self._own is None:
            self._own = self._make()
        return self._own
