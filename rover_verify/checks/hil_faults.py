"""The tests of the table of faults with processes, and their coverage; needs a checkout."""

from __future__ import annotations

import re
from pathlib import Path

from rover_hil.canopen.impairment import KINDS
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.suite_tests import failing

_TESTS = "test/rover_hil/test_faults.py"


def fault_table(batch: CheckBatch) -> Measured:
    """Number of failed tests with processes, and of impairment kinds without a test."""
    tests = failing(batch.folder, (_TESTS,))
    source = (Path(__file__).resolve().parents[2] / _TESTS).read_text(encoding="utf-8")
    missing = sorted(KINDS.keys() - set(re.findall(r"kind: (\w+)", source)))
    return Measured(
        tests.value + len(missing),
        f"{tests.note}; {len(KINDS)} kinds of faults, without a test: "
        f"{', '.join(missing) or 'none'}",
        tests.details,
    )
