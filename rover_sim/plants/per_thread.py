"""Thread-local objects, created on first use."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class PerThread(threading.local, Generic[T]):
    """One object per thread, created when the thread first uses it.

    Args:
        make: factory of the object.
    """

    def __init__(self, make: Callable[[], T]) -> None:  # called once by each thread
        self._make = make
        self._own: T | None = None

    def own(self) -> T:
        """Return this thread's object."""
        if self._own is None:
            self._own = self._make()
        return self._own
