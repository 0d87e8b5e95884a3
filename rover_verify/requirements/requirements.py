"""Read and check the requirements in `requirements.yaml`, and write them as a document."""

from __future__ import annotations

import argparse
import importlib.resources
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from msg_schemas.yaml_reader import read_yaml

METHODS = ("test", "analysis", "demonstration")
STATUSES = ("required", "open")
REFERENCES = (
    "measurement", "another code", "closed form", "another formulation", "conservation",
    "convergence",
)  # fmt: skip
"""What a requirement may hold the suite's numbers to."""
OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<=": lambda measured, limit: measured <= limit,
    ">=": lambda measured, limit: measured >= limit,
    "==": lambda measured, limit: measured == limit,
}
CHECKS_PACKAGE = "rover_verify.checks"

_ID = re.compile(r"[A-Z]+(-[A-Z0-9]+)*-\d\d")
_CHECK = re.compile(r"[a-z_]+\.[a-z_0-9]+(\(.+\))?")
_KEYS = {
    "id", "statement", "method", "limit", "check", "tests", "status", "milestone", "command",
    "note", "reference", "quantity",
}  # fmt: skip
_NEEDED = {"id", "statement", "method"}
_NO_FAILURE = ["==", 0, "failing tests"]


class RequirementError(ValueError):
    """The table of requirements is malformed; the message names the row and the correct form."""


@dataclass(frozen=True)
class Limit:
    """Limit of a measured value."""

    operator: str
    value: float
    unit: str

    def holds(self, measured: float) -> bool:
        """Return whether the value is within the limit; NaN never is."""
        return not math.isnan(measured) and OPERATORS[self.operator](measured, self.value)

    def worst(self, values: Iterable[float]) -> float:
        """Return the value that is nearest to the limit or farthest beyond it."""
        return min(values) if self.operator == ">=" else max(values)

    def __str__(self) -> str:
        """Return the text of the limit, e.g. ``<= 1e-06 J``."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.operator} {self.value:g}{unit}"


@dataclass(frozen=True)
class Requirement:
    """One row of the table.

    Attributes:
        id: identifier, never reused.
        area: heading of the row.
        statement: the requirement, as a sentence.
        method: test, analysis or demonstration.
        limit: limit of the measured value.
        check: ``module.function`` below `CHECKS_PACKAGE`, with arguments after the batch in
            parentheses if it takes any; or None.
        tests: files or tests, as pytest arguments, which verify it in place of a check.
        quantity: name of the values that the tests record, of which the worst is held to the limit;
            empty: the number of failing tests is.
        status: ``required`` (must pass) or ``open`` (not implemented or not met yet; a check is
            measured and reported, but does not decide).
        milestone: milestone of an open requirement.
        command: command that verifies this row.
        note: further information.
        reference: what it holds the suite's numbers to, of `REFERENCES`; empty if to a limit alone.
    """

    id: str
    area: str
    statement: str
    method: str
    limit: Limit
    check: str | None
    tests: tuple[str, ...]
    status: str
    milestone: str
    command: str
    note: str
    reference: str = ""
    quantity: str = ""

    @property
    def is_verified(self) -> bool:
        """Whether a check or tests verify it."""
        return self.check is not None or bool(self.tests)


def load_requirements(text: str | None = None) -> list[Requirement]:
    """Read the table, by default the one of the package.

    Raises:
        RequirementError: a row is malformed, or an identifier is not unique.
    """
    if text is None:
        source = importlib.resources.files("rover_verify.requirements").joinpath(
            "requirements.yaml"
        )
        text = source.read_text(encoding="utf-8")
    content = read_yaml(text, "requirements.yaml")
    if not isinstance(content, list):
        raise RequirementError("the table should be a list of areas")
    rows: list[Requirement] = []
    for area in content:
        if not isinstance(area, dict) or not {"area", "rows"} <= set(area):
            raise RequirementError(f"an area should hold area and rows, not {str(area)[:60]}")
        rows += [_read(row, area) for row in area["rows"]]
    seen: set[str] = set()
    for row in rows:
        if row.id in seen:
            raise RequirementError(f"{row.id} occurs twice; identifiers must be unique")
        seen.add(row.id)
    return rows


def _read(row: Any, area: Mapping[str, Any]) -> Requirement:
    if not isinstance(row, dict) or not isinstance(row.get("id"), str):
        raise RequirementError(f"a row should be a mapping with an id, not {str(row)[:60]}")
    name = row["id"]
    if not _ID.fullmatch(name):
        raise RequirementError(f"{name}: an identifier should look like AREA-TOPIC-01")
    unknown, missing = set(row) - _KEYS, _NEEDED - set(row)
    if unknown or missing:
        wrong = f"unknown {sorted(unknown)}" if unknown else f"missing {sorted(missing)}"
        raise RequirementError(f"{name}: {wrong}; a row has {', '.join(sorted(_KEYS))}")
    if row["method"] not in METHODS:
        raise RequirementError(f"{name}: method {row['method']!r}, not one of {METHODS}")
    status = row.get("status", area.get("status", "required"))
    if status not in STATUSES:
        raise RequirementError(f"{name}: status {status!r}, not one of {STATUSES}")
    reference = row.get("reference", "")
    if reference and reference not in REFERENCES:
        raise RequirementError(f"{name}: reference {reference!r}, not one of {REFERENCES}")
    check = row.get("check")
    if check is not None and not _CHECK.fullmatch(str(check)):
        raise RequirementError(
            f"{name}: check {check!r} should read module.function or module.function(argument, ...)"
        )
    tests = row.get("tests", [])
    if not isinstance(tests, list) or not all(isinstance(each, str) for each in tests):
        raise RequirementError(f"{name}: tests {tests!r} should be a list of pytest arguments")
    quantity = str(row.get("quantity", ""))
    if tests and check is not None:
        raise RequirementError(f"{name}: has tests, so no check")
    if quantity and not tests:
        raise RequirementError(f"{name}: has a quantity, so tests that record it")
    if ("limit" in row) is bool(tests and not quantity):
        raise RequirementError(f"{name}: a limit is of a check, or of a quantity that tests record")
    if check is None and not tests and status == "required":
        raise RequirementError(f"{name}: required, and has neither check nor tests")
    return Requirement(
        id=name,
        area=str(area["area"]),
        statement=" ".join(str(row["statement"]).split()),
        method=row["method"],
        limit=_read_limit(name, row.get("limit", _NO_FAILURE)),
        check=check,
        tests=tuple(tests),
        status=status,
        milestone=str(row.get("milestone", area.get("milestone", ""))),
        command=str(row.get("command", f"mother_rover verify --only {name}")),
        note=" ".join(str(row.get("note", "")).split()),
        reference=reference,
        quantity=quantity,
    )


def _read_limit(name: str, limit: Any) -> Limit:
    if not isinstance(limit, list) or len(limit) != 3:
        raise RequirementError(f"{name}: limit {limit!r} should be [operator, number, unit]")
    operator, value, unit = limit
    if operator not in OPERATORS:
        raise RequirementError(f"{name}: operator {operator!r}, not one of {list(OPERATORS)}")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RequirementError(f"{name}: limit {value!r} should be a finite number")
    return Limit(operator, float(value), str(unit))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table in Markdown."""
    return [
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows),
    ]


def document(rows: Sequence[Requirement]) -> str:
    """Return the table as Markdown."""
    lines = [
        "# Requirements",
        "",
        "Generated by `mother_rover requirements` from",
        "`rover_verify/requirements/requirements.yaml`; do not edit.",
        "`make verify` measures all rows.",
        "",
        "Rows with status `required` must pass; `open` rows are not implemented or not met yet.",
    ]
    head = ("id", "requirement", "limit", "method", "status", "command")
    for area, group in groupby(rows, lambda row: row.area):
        lines += ["", f"## {area}", "", *table(head, map(_cells, group))]
    return "\n".join(lines) + "\n"


def _cells(row: Requirement) -> tuple[str, ...]:
    status = row.status if not row.milestone else f"{row.status} ({row.milestone})"
    statement = row.statement if not row.note else f"{row.statement} ({row.note})"
    command = f"`{row.command}`" if row.is_verified else "-"
    return row.id, statement, str(row.limit), row.method, status, command


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--out", type=Path, default=Path("docs/requirements.md"), metavar="FILE",
                        help="file to write (default: %(default)s)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write the document."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(document(load_requirements()), encoding="utf-8")
    print(f"Written: {options.out}")
    return 0
