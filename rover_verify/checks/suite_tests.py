"""Requirements that are verified by tests of the source tree: by failures, or by what they record.

A skipped test verifies nothing: the row then states the missing prerequisite.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

from rover_hil.canopen.impairment import KINDS
from rover_verify.checks import CheckBatch, Measured, NotPossible

_ROOT = Path(__file__).resolve().parents[2]
_FAULT_TESTS = "test/rover_hil/test_faults.py"


def run_tests(
    tests: tuple[str, ...],
    batch: CheckBatch,
    quantity: str = "",
    worst: Callable[[Iterable[float]], float] = max,
    root: Path = _ROOT,
) -> Measured:
    """Return the worst value of a quantity that tests record, or the number of failing tests.

    Args:
        tests: files or tests, as pytest arguments.
        batch: scratch folder, and the seed of tests that draw at random.
        quantity: name that the tests give to ``record_property``; empty: the failures are counted.
        worst: chooses one of the values; it is NaN where a test fails or none is recorded.
        root: root of the source tree.

    Raises:
        NotPossible: there is no source tree, or a prerequisite of a test is missing.
    """
    missing = [name for name in tests if not (root / name.partition("::")[0]).is_file()]
    if missing:
        raise NotPossible(f"{missing[0]} comes with the source tree only")
    results = batch.folder / "results.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--timeout=600"]
    ended = subprocess.run(
        [*command, f"--hypothesis-seed={batch.seed}", f"--junitxml={results}", *tests],
        cwd=root,
        env={**os.environ, "TEST_SEED": str(batch.seed)},
        capture_output=True,
        text=True,
        check=False,
    )
    if not results.exists():
        raise NotPossible(f"pytest ended with {ended.returncode}: {ended.stderr.strip()[-300:]}")
    cases = list(ET.parse(results).iter("testcase"))
    for case in cases:
        skipped = case.find("skipped")
        if skipped is not None:
            raise NotPossible(f"{case.get('name')}: {skipped.get('message')}")
    if not cases:
        raise NotPossible(f"pytest found none of {', '.join(tests)}")
    failed = {
        str(case.get("name")): str(problem.get("message"))[:200]
        for case in cases
        for problem in (*case.findall("failure"), *case.findall("error"))
    }
    files = sorted({name.partition("::")[0] for name in tests})
    note = f"{len(cases)} tests of {', '.join(files)}"
    if not quantity:
        return Measured(len(failed), note, failed)
    values = {
        f"{case.get('name')} {number}": float(str(each.get("value")))
        for case in cases
        for number, each in enumerate(case.iterfind(f"properties/property[@name='{quantity}']"), 1)
    }
    if failed or not values:
        return Measured(math.nan, note, failed or {quantity: "not recorded"})
    return Measured(worst(values.values()), note, values)


def fault_table(batch: CheckBatch) -> Measured:
    """Number of failed tests with processes, and of impairment kinds without a test."""
    tests = run_tests((_FAULT_TESTS,), batch)
    source = (_ROOT / _FAULT_TESTS).read_text(encoding="utf-8")
    missing = sorted(KINDS.keys() - set(re.findall(r"kind: (\w+)", source)))
    note = f"{tests.note}; {len(KINDS)} kinds of faults, without a test: {missing or 'none'}"
    return Measured(tests.value + len(missing), note, tests.details)
