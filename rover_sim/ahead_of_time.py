"""Compile the plant ahead of time in a child process, so that every process runs the same code.

A process that compiles numba functions links them differently from one that loads them from the
cache on disk: the last bits of its results differ from those of all later processes. The first
process on a machine therefore lets two child processes compile, one of them the functions that the
other reaches last, and then loads the code as all others do.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

import llvmlite.binding
import numba

from rover_sim.physics import planar
from rover_sim.physics.compiled import cache_only, source_stamp
from rover_sim.plant_factory import build_plant
from rover_sim.scenario import AnyScenario, scenario_from_mapping
from rover_sim.spatial_plant import SpatialPlant

_TIMEOUT: Final = 900.0  # [s]
_POLL_PERIOD: Final = 0.02  # [s]
_PARTS: Final = "--parts"
_IN_CHILD: Final = "MOTHER_ROVER_COMPILES"
_STACK: Final = 1 << 17  # [words]; the deepest calls of the compiler need a twentieth of it


def compile_ahead(scenario: AnyScenario, cancelled: Callable[[], bool] = lambda: False) -> bool:
    """Compile the functions of a scenario's plant in child processes, unless they are cached.

    Args:
        scenario: whose plant is compiled.
        cancelled: polled meanwhile; True cancels the compilation.

    Returns:
        Whether the code is in the cache. If not (the cache is not writable, or the child failed),
        numba compiles in this process on the first call.
    """
    marker = _marker(scenario.model)
    if marker.exists():
        return True
    if _IN_CHILD in os.environ:
        return False
    root = str(Path(__file__).resolve().parents[1])
    inherited = os.environ.get("PYTHONPATH")
    environment = {
        **os.environ,
        _IN_CHILD: "1",
        "PYTHONPATH": root if not inherited else os.pathsep.join((root, inherited)),
    }
    values = json.dumps(scenario.to_mapping())
    command = [sys.executable, "-P", "-m", __name__]  # -P: not from where it is started, but ours
    try:
        # The parts compile on a second core; a failure there only costs time.
        with (
            _running([*command, _PARTS], values, environment),
            _running(command, values, environment) as process,
        ):
            if not _has_succeeded(process, cancelled):
                return False
        marker.touch()
    except OSError:
        return False
    return True


def _has_succeeded(process: subprocess.Popen[bytes], cancelled: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + _TIMEOUT
    while process.poll() is None and not cancelled() and time.monotonic() < deadline:
        with suppress(subprocess.TimeoutExpired):
            process.wait(_POLL_PERIOD)
    return process.returncode == 0


@contextmanager
def _running(
    command: list[str], values: str, environment: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process within the block, with the values on its standard input."""
    with TemporaryFile("w+") as source:
        source.write(values)
        source.seek(0)
        process = subprocess.Popen(
            command,
            stdin=source,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def _marker(model: str) -> Path:
    """Return the path of a file in numba's cache that marks these exact sources as compiled."""
    physics = Path(planar.__file__).parent
    parts: Iterable[str] = (
        numba.__version__,
        sys.version,
        llvmlite.binding.get_host_cpu_name(),
        *(source_stamp(path) for path in sorted(physics.glob("*.py"))),
    )
    digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]
    return Path(planar.advance._cache.cache_path) / f"compiled_{model}_{digest}"


def main() -> int:
    """Compile the plant, or its parts, of the scenario on standard input, as the child process.

    Python keeps frames in blocks of 16 kB. A call across the end of a block maps a new one, and its
    return unmaps it: 300,000 times in a compilation, an eighth of its time. All calls therefore
    start from a frame with one large block.
    """
    _compile_given.__code__ = _compile_given.__code__.replace(co_stacksize=_STACK)
    return _compile_given()


def _compile_given() -> int:
    gc.disable()  # garbage collection would take a sixth of the compilation time
    plant = build_plant(scenario_from_mapping(json.load(sys.stdin)))
    if isinstance(plant, SpatialPlant):
        cache_only(function for function, _ in plant.parts())
    if _PARTS in sys.argv:
        if isinstance(plant, SpatialPlant):
            plant.compile_parts()
        return 0
    plant.warm_up()
    if isinstance(plant, SpatialPlant):
        plant.unsettled_state()  # settling calls no further functions
    else:
        plant.initial_state()
    return 0


if __name__ == "__main__":
    sys.exit(main())
