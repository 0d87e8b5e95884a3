"""Environment of processes whose linear algebra uses one thread.

Several threads of a process wait for each other where other processes keep the cores busy: a system
of a hundred equations then takes hundreds of times as long.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

SINGLE_THREADED: Final[Mapping[str, str]] = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)
"""Variables that numpy reads when it is imported."""
