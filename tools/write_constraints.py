"""Write the constraints of pip: one version of each distribution, as the index resolves them today.

    python tools/write_constraints.py        writes constraints/make.txt and colcon.txt

`make` installs by the first, so that it installs the same again; `.ci/colcon` by the second, with
the versions of Ubuntu 24.04. Nothing is installed.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints"
README = ROOT / "README.md"
_PIP_LINE = re.compile(r"^pip install (.*)$", re.MULTILINE)
_HEADER = "# Written by `make constraints`; resolved by Python {python}.\n"


def pip_line() -> list[str]:
    """Return the requirements that the README installs with pip beside the packages of Ubuntu."""
    found = _PIP_LINE.findall(README.read_text(encoding="utf-8"))
    lists = {
        tuple(word for word in shlex.split(line, comments=True) if not word.startswith("-"))
        for line in found
    }
    if len(lists) != 1:
        raise ValueError(f"{README}: {len(lists)} different lists after `pip install`, not one")
    return list(lists.pop())


def resolved(requirements: Sequence[str]) -> dict[str, str]:
    """Return the version of each distribution that pip would install in an empty environment."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
    report = subprocess.run(
        [*command, "--no-build-isolation", "--report", "-", *requirements],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        check=True,
    )
    installed = json.loads(report.stdout)["install"]
    return {
        re.sub(r"[-_.]+", "-", each["metadata"]["name"]).lower(): each["metadata"]["version"]
        for each in installed
        if "dir_info" not in each["download_info"]  # ours
    }


def write(name: str, requirements: Sequence[str]) -> None:
    """Resolve requirements and write their versions to a file of the constraints."""
    lines = [f"{each}=={version}\n" for each, version in sorted(resolved(requirements).items())]
    python = ".".join(map(str, sys.version_info[:2]))
    (CONSTRAINTS / name).write_text(_HEADER.format(python=python) + "".join(lines), "utf-8")
    print(f"Written: constraints/{name} ({len(lines)} distributions)")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    write("make.txt", [".[test,bench,docs,dev,fuzz]", "setuptools>=71"])
    write("colcon.txt", ["--requirement", "constraints/ubuntu-24.04.in", *pip_line()])
