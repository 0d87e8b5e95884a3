"""Run all tests in parallel: first those in one process, on all cores, then those with processes.

A test with processes may fail under the load of the others. The failed ones run once more, one
after the other; those that then pass are listed as flaky, each with its first traceback.

    python tools/run_tests.py [--one-process] [PYTEST ARGUMENT ...]    e.g. -k winch, -m "not slow"

--one-process leaves the tests with processes out. Several -m must all hold.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

PASSED, FAILED, INTERRUPTED, NO_TESTS = 0, 1, 2, 5
"""Exit codes of pytest."""

_TIMEOUT = "--timeout=600"
_BY_FILE = ("--dist=loadfile", "--no-loadscope-reorder")  # the slow ones first
_ONE_PROCESS = ("--numprocesses=auto", "--maxprocesses=4", *_BY_FILE)
# They wait half of the time: one more than the cores of a small machine.
_WITH_PROCESSES = ("--numprocesses=3", *_BY_FILE)
_AGAIN = ("--last-failed", "--last-failed-no-failures=none")


def split_arguments(arguments: Sequence[str]) -> tuple[bool, list[str], list[str]]:
    """Return whether one process is enough, the expressions of markers, and pytest's arguments."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--one-process", action="store_true")
    parser.add_argument("-m", dest="markers", action="append", default=[])
    known, others = parser.parse_known_args(arguments)
    return known.one_process, known.markers, others


def combined(required: str, selected: Sequence[str]) -> str:
    """Return the expression of markers of all."""
    return " and ".join([required, *(f"({each})" for each in selected)])


def failures(report: Path) -> dict[str, str]:
    """Return the tracebacks of the tests that failed, by name, of a report in JUnit's format."""
    if not report.exists():
        return {}
    found = {}
    for case in ET.parse(report).iter("testcase"):
        texts = [each.text or "" for each in case if each.tag in ("failure", "error")]
        if texts:
            found[f"{case.get('classname')}.{case.get('name')}"] = "\n".join(texts)
    return found


def flaky(first: Mapping[str, str], again: Mapping[str, str]) -> str:
    """Describe the tests that failed beside others and passed alone; empty = none."""
    passed = {name: text for name, text in first.items() if name not in again}
    if not passed:
        return ""
    details = "".join(f"\n---- {name}\n{text}\n" for name, text in passed.items())
    names = "".join(f"FLAKY {name}\n" for name in passed)
    return f"\n==== flaky: failed beside other tests, passed alone ====\n{details}\n{names}"


def _pytest(*arguments: str) -> int:
    status = subprocess.run([sys.executable, "-m", "pytest", _TIMEOUT, *arguments], check=False)
    return PASSED if status.returncode == NO_TESTS else status.returncode


def main(arguments: Sequence[str]) -> int:
    """Run the tests; returns the exit code of pytest."""
    one_process, selected, others = split_arguments(arguments)
    in_one_process = _pytest("-m", combined("not process", selected), *_ONE_PROCESS, *others)
    if one_process or in_one_process == INTERRUPTED:
        return in_one_process
    markers = combined("process", selected)
    with tempfile.TemporaryDirectory() as folder:
        beside, alone = Path(folder) / "beside.xml", Path(folder) / "alone.xml"
        with_processes = _pytest("-m", markers, *_WITH_PROCESSES, *others, f"--junit-xml={beside}")
        if with_processes == FAILED:
            print("\nRunning the failed tests again, one after the other:", flush=True)
            with_processes = _pytest("-m", markers, *_AGAIN, *others, f"--junit-xml={alone}")
            print(flaky(failures(beside), failures(alone)), end="", flush=True)
    return with_processes or in_one_process


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
