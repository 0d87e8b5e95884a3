"""Fixtures that all tests may use."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from random_seeds import TEST_SEED

from rover_runtime.ros import middleware
from rover_runtime.single_threaded import SINGLE_THREADED

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Processes

# The same examples each time, so that a failure is a change's. HYPOTHESIS_PROFILE=exploring looks
# for others, TEST_SEED for those of a seed (with the option --hypothesis-seed).
settings.register_profile("repeatable", derandomize=True, deadline=None, print_blob=True)
settings.register_profile("exploring", deadline=None, print_blob=True)
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE", "exploring" if TEST_SEED else "repeatable")
)

# Read when numpy and ROS are imported, which is why the fixtures import late: the tests keep all
# cores busy, publishing a wrong type is an error, and other machines on the network stay out.
os.environ.update(SINGLE_THREADED)
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
middleware.select_transport()
# A shell starts what runs in its background with SIGINT ignored, `nohup` with SIGHUP, and processes
# inherit that: tests that interrupt a process would wait for ever.
_AFTER_IGNORED: dict[signal.Signals, Callable[..., object] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGHUP: signal.SIG_DFL,
}
for _number, _handler in _AFTER_IGNORED.items():
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _handler)
# Nodes that only tests run are started by their module's name, as all others are.
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(Path(__file__).parent / "support"), *filter(None, [os.environ.get("PYTHONPATH")])]
)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without processes where only tests with processes are selected."""
    # `process`, alone or with further conditions in parentheses, as `tools/run_tests.py` writes it.
    selected = re.fullmatch(r"process( and \([^()]*\))*", config.option.markexpr)
    if selected is None or collection_path.suffix != ".py":
        return None
    return None if "mark.process" in collection_path.read_text("utf-8") else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that no worker has one left at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@contextmanager
def _shown_harness(folder: Path) -> Iterator[NodeHarness]:
    from rover_verify.harness import open_harness

    with open_harness(folder) as opened:
        try:
            yield opened
        finally:
            # Shown by pytest where a test has failed.
            print(opened.processes.output)


@pytest.fixture
def record_property(
    record_property: Callable[[str, object], None],
) -> Callable[[str, object], None]:
    """Record a property of a test; xdist cannot send numpy's numbers, so they become Python's."""
    import numpy as np

    def record(name: str, value: object) -> None:
        record_property(name, value.item() if isinstance(value, np.generic) else value)

    return record


@pytest.fixture
def harness(tmp_path: Path) -> Iterator[NodeHarness]:
    """A fresh ROS domain with processes and observers, for one test."""
    with _shown_harness(tmp_path) as opened:
        yield opened


@pytest.fixture(scope="module")
def shared_harness(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeHarness]:
    """A ROS domain that the tests of one module share, for what leaves no trace."""
    with _shown_harness(tmp_path_factory.mktemp("harness")) as opened:
        yield opened


@pytest.fixture
def domain(harness: NodeHarness) -> int:
    """The fresh ROS domain of this test."""
    return harness.domain


@pytest.fixture
def processes(harness: NodeHarness) -> Processes:
    """Starts executables in this test's domain."""
    return harness.processes


@pytest.fixture
def observer(harness: NodeHarness) -> Observer:
    """A node of the test in its domain."""
    return harness.observer()


@pytest.fixture
def own_multicast() -> Iterator[str]:
    """A multicast link of CAN frames that no other test on this computer uses."""
    from rover_verify.harness.ros_domain import multicast_link, reserved_domain

    with reserved_domain() as domain:
        yield multicast_link(domain)


@pytest.fixture(scope="session")
def compiled() -> None:
    """Fill the cache of compiled kernels once: a sim node that starts need not compile then."""
    from rover_sim import compile_ahead, load_scenario

    assert compile_ahead(load_scenario("paper_table1_low"))


@pytest.fixture(scope="session")
def compiled_in_space() -> None:
    """As `compiled`, for the spatial plant and its sensors."""
    from rover_sim import compile_ahead, load_scenario

    assert compile_ahead(load_scenario("free_hang"))


@pytest.fixture(scope="session", autouse=True)
def _shared_memory() -> Iterator[None]:
    """Remove what killed processes have left in shared memory."""
    yield
    from rover_verify.harness import clean_shared_memory

    clean_shared_memory()
