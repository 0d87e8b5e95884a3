"""The tests of the table of faults with processes, and their coverage; needs a checkout."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from rover_hil.canopen.impairment import KINDS
from rover_verify.checks import CheckBatch, Measured, NotPossible

_TESTS = Path(__file__).resolve().parents[2] / "test" / "rover_hil" / "test_faults.py"
_LONGEST = 1800.0  # [s]


def fault_table(batch: CheckBatch) -> Measured:
    """Number of failed tests with processes, and of impairment kinds without a test."""
    if not _TESTS.exists():
        raise NotPossible(f"the tests are not installed, only in a checkout: {_TESTS}")
    report = batch.folder / "faults.xml"
    command = [sys.executable, "-m", "pytest", "-q", str(_TESTS), f"--junitxml={report}"]
    folder = _TESTS.parents[2]
    completed = subprocess.run(
        command, cwd=folder, env=os.environ, capture_output=True, timeout=_LONGEST, check=False
    )
    if not report.exists():
        raise NotPossible(
            f"pytest wrote no report: {completed.stdout.decode(errors='replace')[-500:]}"
        )
    cases = list(ET.parse(report).iter("testcase"))
    failed = [
        str(case.get("name"))
        for case in cases
        if any(case.find(what) is not None for what in ("failure", "error", "skipped"))
    ]
    source = _TESTS.read_text(encoding="utf-8")
    missing = sorted(KINDS.keys() - set(re.findall(r"kind: (\w+)", source)))
    return Measured(
        len(failed) + len(missing),
        f"{len(cases)} tests, {len(KINDS)} kinds of faults; failed: {', '.join(failed) or 'none'}; "
        f"without a test: {', '.join(missing) or 'none'}",
    )
