"""Compile the plants ahead of time in child processes, so that every process runs the same code.

The last bits of results depend on how the code was compiled: on the order in which numba iterates
over sets of names, which Python's hash seed determines; on which functions were compiled and which
were loaded; on the scenario that a process runs. So nobody compiles for itself: the first process
on a machine lets two child processes compile every function that a simulation calls, always in the
same manner, and then loads the code as all others do. One child compiles half of the functions that
the other one reaches last; the other one waits for them.
"""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Final

import llvmlite.binding
import numba

from msg_schemas.file_lock import lock_file
from rover_sim.physics.integrators import planar
from rover_sim.physics.integrators.compile_targets import compile_for
from rover_sim.physics.numerics.compiled import (
    called_from_python,
    compile_anew,
    count_written,
    load_when,
    source_stamp,
    write_to_cache,
)
from rover_sim.plants.plant_factory import build_plant
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.scenarios.scenario import AnyScenario, SpatialScenario, load_scenario

_TIMEOUT: Final = 900.0  # [s]
_POLL_PERIOD: Final = 0.02  # [s]
_PROGRESS_PERIOD: Final = 5.0  # [s]
_PARTS: Final = "--parts"
_IN_CHILD: Final = "MOTHER_ROVER_COMPILES"
_HASH_SEED: Final = "0"
_STACK: Final = 1 << 17  # [words]; the deepest calls of the compiler need a twentieth of it
# Scenarios whose simulation calls every function of the model.
_COMPILED_FOR: Final = {"planar": "paper_table1_high", "spatial": "floor_rubble"}


Progress = Callable[[float, int], None]
"""Called every 5 s with the duration so far [s] and the number of functions that are compiled."""


def compile_ahead(
    scenario: AnyScenario,
    cancelled: Callable[[], bool] = lambda: False,
    progress: Progress = lambda _duration, _count: None,
) -> bool:
    """Compile the functions of a scenario's model in child processes, unless they are cached.

    Args:
        scenario: whose model is compiled, for all its scenarios.
        cancelled: polled meanwhile; True cancels the compilation.
        progress: called meanwhile.

    Returns:
        Whether the code is in the cache. If not (the cache is not writable, or a child failed),
        numba compiles in this process on the first call.
    """
    marker = compiled_marker(scenario.model)
    if marker.exists():
        return True
    if _IN_CHILD in os.environ:
        return False
    is_over = _shown_while(cancelled, progress)
    try:
        marker.parent.mkdir(parents=True, exist_ok=True)
        # Two compilations at a time would replace the code that others have loaded already.
        with marker.with_name("compiling.lock").open("w") as lock:
            if not lock_file(lock, is_over):
                return False
            if not marker.exists():
                if not _compile_in_children(scenario.model, lock, is_over):
                    return False
                marker.touch()
    except OSError:
        return False
    return True


def _shown_while(cancelled: Callable[[], bool], show: Progress) -> Callable[[], bool]:
    """Return `cancelled`, which also shows the progress when it is polled, from now on.

    The compilation may be that of another process, which this one waits for.
    """
    begin, begin_ns, shown = time.monotonic(), time.time_ns(), 0.0

    def polled() -> bool:
        nonlocal shown
        duration = time.monotonic() - begin
        if duration - shown >= _PROGRESS_PERIOD:
            shown = duration
            show(duration, count_written(begin_ns))
        return cancelled()

    return polled


def _compile_in_children(model: str, lock: IO[str], cancelled: Callable[[], bool]) -> bool:
    """Run the child processes; they keep the lock should this process be killed."""
    # -P: not from where it is started; runpy warns that the package has imported the module already
    command = [sys.executable, "-P", "-W", "ignore::RuntimeWarning:runpy", "-m", __name__, model]
    root = str(Path(__file__).resolve().parents[2])
    inherited = os.environ.get("PYTHONPATH")
    environment = {
        **os.environ,
        _IN_CHILD: "1",
        "PYTHONHASHSEED": _HASH_SEED,
        "PYTHONPATH": root if not inherited else os.pathsep.join((root, inherited)),
    }
    progress, report = os.pipe()
    with ExitStack() as running:
        running.callback(os.close, progress)
        start = partial(_running, environment=environment, lock=lock)
        try:
            parts = running.enter_context(start([*command, _PARTS], stdout=report))
        finally:
            os.close(report)  # the pipe ends with the child
        rest = running.enter_context(start(command, stdin=progress))
        deadline = time.monotonic() + _TIMEOUT
        children = (rest, parts)
        while alive := [child for child in children if child.poll() is None]:
            if cancelled() or time.monotonic() > deadline:
                return False
            _wait(alive[0])
    return all(child.returncode == 0 for child in children)


def _wait(child: subprocess.Popen[bytes]) -> None:
    try:
        child.wait(_POLL_PERIOD)
    except subprocess.TimeoutExpired:
        return


@contextmanager
def _running(
    command: list[str],
    environment: dict[str, str],
    lock: IO[str],
    stdin: int = subprocess.DEVNULL,
    stdout: int = subprocess.DEVNULL,
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process within the block."""
    process = subprocess.Popen(
        command,
        stdin=stdin,
        stdout=stdout,  # errors of a child are the suite's own: they go to standard error
        env=environment,
        pass_fds=[lock.fileno()],
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def compiled_marker(model: str) -> Path:
    """Return the path of a file in numba's cache that marks these exact sources as compiled."""
    physics = Path(planar.__file__).parents[1]
    digest = hashlib.sha256()
    for part in (numba.__version__, sys.version, llvmlite.binding.get_host_cpu_name()):
        digest.update(part.encode())
    digest.update(Path(__file__).read_bytes())
    for path in sorted(physics.rglob("*.py")):
        digest.update(source_stamp(path).encode())
    folder = Path(planar.advance._cache.cache_path)
    return folder / f"compiled_{model}_{digest.hexdigest()[:24]}"


# --- the child processes -------------------------------------------------------------------------


def main() -> int:
    """Compile a model, or its parts, as the child process.

    Python keeps frames in blocks of 16 kB. A call across the end of a block maps a new one, and its
    return unmaps it: 300,000 times in a compilation, an eighth of its time. All calls therefore
    start from a frame with one large block.
    """
    compile_model = _compile_parts if _PARTS in sys.argv else _compile_rest
    compile_model.__code__ = compile_model.__code__.replace(co_stacksize=_STACK)
    gc.disable()  # garbage collection would take a sixth of the compilation time
    compile_model(sys.argv[1])
    return 0


def _compile_parts(model: str) -> None:
    """Compile the functions that the other process does not, and report each by a byte."""
    scenario = load_scenario(_COMPILED_FOR[model])
    if not isinstance(scenario, SpatialScenario):
        return
    compile_anew()
    plant = SpatialPlant(scenario)
    targets = (*plant.step_parts(), *plant.sensor_functions())
    write_to_cache(function for function, _ in targets)
    for target in targets:
        compile_for(*target)
        sys.stdout.buffer.write(b".")
        sys.stdout.buffer.flush()


def _compile_rest(model: str) -> None:
    compile_anew()
    write_to_cache(called_from_python())
    plant = build_plant(load_scenario(_COMPILED_FOR[model]))
    if isinstance(plant, SpatialPlant):
        compiled = _Progress()
        for number, (function, _) in enumerate(plant.step_parts(), start=1):
            load_when(partial(compiled.wait_for, number), function)
        plant.warm_up()
        plant.unsettled_state()  # settling calls no further functions
    else:
        plant.warm_up()
        plant.initial_state()


class _Progress:
    """Number of functions that the other process has compiled, from standard input."""

    def __init__(self) -> None:
        self._count = 0

    def wait_for(self, count: int) -> None:
        """Wait until the other process has compiled that many, or has ended."""
        while self._count < count and sys.stdin.buffer.read(1):
            self._count += 1


if __name__ == "__main__":
    sys.exit(main())
