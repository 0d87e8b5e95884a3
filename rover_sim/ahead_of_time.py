"""Compiles the plant in a process of its own, so that all that step it run the same code.

A process that compiles numba functions itself links them otherwise than one that loads them from
the cache on disk: the last bits of its results differ from those of all later processes. So the
first process on a machine lets a child compile, a second one beside it what the first comes to
last, and then loads as the others do.
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

_LONGEST: Final = 900.0  # [s]
_LOOK: Final = 0.02  # [s]
_PARTS: Final = "--parts"
_IN_CHILD: Final = "MOTHER_ROVER_COMPILES"
_STACK: Final = 1 << 17  # words, of which a compiler's deepest calls need a twentieth


def compile_ahead(scenario: AnyScenario, cancelled: Callable[[], bool] = lambda: False) -> bool:
    """Compile what the scenario's plant needs, in another process, unless that was done before.

    Args:
        scenario: whose plant is compiled.
        cancelled: asked again and again meanwhile; once it says so, compiling is left off.

    Returns:
        Whether the code is in the cache now. If it is not (nothing can be written there, or the
        other process failed), this process will compile by itself, as numba does.
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
    given = json.dumps(scenario.to_mapping())
    command = [sys.executable, "-P", "-m", __name__]  # -P: not from where it is started, but ours
    try:
        # On the machine's second core; if it fails, it fails.
        with (
            _at_work([*command, _PARTS], given, environment),
            _at_work(command, given, environment) as process,
        ):
            if not _has_succeeded(process, cancelled):
                return False
        marker.touch()
    except OSError:
        return False
    return True


def _has_succeeded(process: subprocess.Popen[bytes], cancelled: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + _LONGEST
    while process.poll() is None and not cancelled() and time.monotonic() < deadline:
        with suppress(subprocess.TimeoutExpired):
            process.wait(_LOOK)
    return process.returncode == 0


@contextmanager
def _at_work(
    command: list[str], given: str, environment: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    """Have a process at work, and end it afterwards."""
    with TemporaryFile("w+") as source:
        source.write(given)
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
    """A file in numba's cache that is there once a child has compiled exactly these sources."""
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
    """The child: read a scenario's values, compile its plant, or the parts that come last.

    Python keeps frames in blocks of 16 kB. Calls that cross the end of one have it mapped by the
    kernel and unmapped at each return: 300,000 times in a compilation, an eighth of its time. So
    all is called from a frame that asks for one large block.
    """
    _compile_given.__code__ = _compile_given.__code__.replace(co_stacksize=_STACK)
    return _compile_given()


def _compile_given() -> int:
    gc.disable()  # a sixth of the compiler's time would go into looking for garbage
    plant = build_plant(scenario_from_mapping(json.load(sys.stdin)))
    if isinstance(plant, SpatialPlant):
        cache_only(function for function, _ in plant.parts())
    if _PARTS in sys.argv:
        if isinstance(plant, SpatialPlant):
            plant.compile_parts()
        return 0
    plant.warm_up()
    if isinstance(plant, SpatialPlant):
        plant.unsettled_state()  # settling calls nothing that a step does not
    else:
        plant.initial_state()
    return 0


if __name__ == "__main__":
    sys.exit(main())
