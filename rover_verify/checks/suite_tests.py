"""Requirements that are verified by tests of the source tree; the value is the number of failures.

A skipped test verifies nothing: the row then states the missing prerequisite.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from rover_verify.checks import Batch, Measured, NotPossible

_ROOT = Path(__file__).parents[2]


def failing(folder: Path, tests: tuple[str, ...], root: Path = _ROOT) -> Measured:
    """Return the number of failing tests.

    Args:
        folder: scratch folder.
        tests: files or tests, as pytest arguments.
        root: root of the source tree.

    Raises:
        NotPossible: there is no source tree, or a prerequisite of a test is missing.
    """
    missing = [name for name in tests if not (root / name.partition("::")[0]).is_file()]
    if missing:
        raise NotPossible(f"{missing[0]} comes with the source tree only")
    results = folder / "results.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--timeout=600"]
    ended = subprocess.run(
        [*command, f"--junitxml={results}", *tests],
        cwd=root,
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
    return Measured(len(failed), f"{len(cases)} tests of {', '.join(files)}", failed)


def layouts(batch: Batch) -> Measured:
    """Failing tests of the RViz, PlotJuggler and Foxglove files."""
    return failing(batch.folder, ("test/test_layouts.py",))


def documented(batch: Batch) -> Measured:
    """Failing tests of the documented commands."""
    names = ("commands", "orders", "runs", "sessions")
    files = [f"test/test_documented_{name}.py" for name in names]
    return failing(batch.folder, (*files, "test/test_documents.py", "test/test_tutorials.py"))


def browser(batch: Batch) -> Measured:
    """Failing tests of the page in a real browser."""
    return failing(batch.folder, ("test/operator_console/test_page.py",))


def offline(batch: Batch) -> Measured:
    """Failing tests of the page's requests; in a browser, requests to other servers fail."""
    server = "test/operator_console/test_server.py"
    names = (
        "test_the_page_loads_only_files_of_this_server",
        "test_no_file_of_the_page_refers_to_another_server",
    )
    page = "test/operator_console/test_page.py::test_a_bag_is_replayed_on_the_same_page"
    return failing(batch.folder, (*(f"{server}::{name}" for name in names), page))


def access(batch: Batch) -> Measured:
    """Failing tests of access to view and to command."""
    server = "test/operator_console/test_server.py"
    names = (
        "test_nothing_is_shown_without_the_token",
        "test_other_host_names_and_sites_are_refused",
        "test_wrong_tokens_are_counted",
        "test_view_only_accepts_no_command",
    )
    pages = "test/operator_console/test_page_access.py"
    return failing(batch.folder, (pages, *(f"{server}::{name}" for name in names)))


def command_line(batch: Batch) -> Measured:
    """Failing tests of the command ``rover``."""
    return failing(batch.folder, ("test/operator_console/test_command_line.py",))
