"""``mother_rover validate page``: write the results in `docs/validation.md`.

The results are kept beside the document, in `docs/validation.yaml`: what `mother_rover validate
summary` found of measured sets, and what `mother_rover verify` measured of the requirements that
have a `reference` in `requirements.yaml`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import yaml

from msg_schemas.fields import FieldError
from msg_schemas.regular_files import LARGEST_TEXT, read_text
from msg_schemas.yaml_reader import read_yaml
from rover_validation.sets.summary import CableSummary, Summary, SummaryNumber, WheelSummary
from rover_verify.requirements.requirements import REFERENCES, Requirement, load_requirements, table

OK, REFUSED = 0, 2
BEGIN: Final = "<!-- results: written by `mother_rover validate page`; do not edit -->"
END: Final = "<!-- end of the results -->"

_ABOUT_CABLES: Final = """\
Identified from some takes, each cable predicts others from their first two frames and the motion of
the ends. Error: mean distance of the free markers from the third frame on. *Constant*: the part of
the squared error that stays the same through a take."""
_ABOUT_NUMBERS: Final = """\
Identified numbers with their 95 % intervals, per mass per length. A star marks a number that is at
its bound, or whose interval is wider than twice the number: the takes do not show it."""
_ABOUT_WHEELS: Final = """\
Each setting is predicted by the soil that is identified from the others, a sixth of them left out
at a time. RMS errors:"""
_ABOUT_REFERENCES: Final = """\
The requirements that hold the suite to measurements, other codes, closed forms, another formulation
of the same equations, conserved quantities and orders of convergence. A row is measured again by
`mother_rover verify --only ID`; the sets for the measurements are named by `--sets`."""


class ResultsError(Exception):
    """A file that cannot be used: its name, and what would be right."""


@dataclass(frozen=True)
class ValidationResults:
    """What the document shows.

    Attributes:
        summary: of the measured sets; None: none was summarised.
        measured: value of each requirement that was measured, by its identifier.
    """

    summary: Summary | None
    measured: Mapping[str, float]

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any]) -> ValidationResults:
        """Read what `to_mapping` returned.

        Raises:
            KeyError, TypeError, ValueError, AttributeError: it is none.
        """
        summary = content["summary"]
        return cls(
            None if summary is None else Summary.from_mapping(summary),
            {str(name): float(value) for name, value in content["measured"].items()},
        )

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for YAML, numbers rounded."""
        return {
            "summary": None if self.summary is None else self.summary.to_mapping(),
            "measured": {name: float(f"{value:.4g}") for name, value in self.measured.items()},
        }


@contextmanager
def _refusing(path: Path, what: str) -> Iterator[None]:
    """Refuse a file whose content is not what it should be."""
    try:
        yield
    except FieldError as error:
        raise ResultsError(str(error)) from None
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ResultsError(f"{path}: {what} ({error!r})") from None


def results_of(path: Path) -> ValidationResults:
    """Read the results that were kept; none where there is no file.

    Raises:
        ResultsError: the file is damaged.
    """
    if not path.exists():
        return ValidationResults(None, {})
    with _refusing(path, "holds no results"):
        return ValidationResults.from_mapping(read_yaml(path))


def summary_of(path: Path) -> Summary:
    """Read what `mother_rover validate summary` wrote.

    Raises:
        ResultsError: the file is none.
    """
    with _refusing(path, "is no summary; `mother_rover validate summary` writes one"):
        return Summary.from_mapping(read_yaml(path))


def measured_of(path: Path, rows: Sequence[Requirement]) -> dict[str, float]:
    """Read the values of the rows with a reference from `verification.json`.

    Raises:
        ResultsError: the file is none.
    """
    referred = {row.id for row in rows if row.reference}
    with _refusing(path, "is no verification; `mother_rover verify` writes one"):
        content = json.loads(read_text(path, LARGEST_TEXT))
        return {
            each["id"]: float(each["measured"])
            for each in content
            if each["id"] in referred and each["measured"] is not None
        }


def document(text: str, results: ValidationResults, rows: Sequence[Requirement]) -> str:
    """The document with its results written anew.

    Args:
        text: of the document, with the two markers.
        results: shown between them.
        rows: of the table of requirements.

    Raises:
        ResultsError: a marker is missing.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ResultsError(f"the document lacks the line {END if begin else BEGIN}")
    lines: list[str] = []
    if results.summary is not None:
        lines += _cables(results.summary)
        for wheel in results.summary.wheels:
            lines += _wheel(wheel, results.summary.wheel_source)
    lines += _references(rows, results.measured)
    return before + begin + "\n\n" + "\n".join(lines) + "\n" + end + after


def _cables(summary: Summary) -> list[str]:
    if not summary.cables:
        return []
    return [
        "### Cables that are held and moved at both ends",
        "",
        f"Measured by: {summary.cable_source}",
        "",
        _ABOUT_CABLES,
        "",
        *table(
            ("cable", "takes identified", "predicted", "error [mm]", "worst take [mm]",
             "first second [mm]", "constant", "in the 90 % band", "band [mm]", "faster (CPU time)"),
            [_cable_cells(each) for each in summary.cables],
        ),
        "",
        *_numbers_of_cables(summary.cables),
        "",
    ]  # fmt: skip


def _cable_cells(cable: CableSummary) -> tuple[str, ...]:
    errors = cable.errors
    return (
        cable.name, str(cable.takes), str(errors.takes), f"{errors.mean:.1f}",
        f"{errors.worst:.1f}", f"{errors.early:.1f}", f"{errors.still:.0%}",
        f"{errors.coverage:.0%}", f"{errors.width:.0f}", f"{errors.speed:.0f} times",
    )  # fmt: skip


def _numbers_of_cables(cables: Sequence[CableSummary]) -> list[str]:
    """A table of the numbers, one column a cable; a star marks what was not measured."""
    names = dict.fromkeys((each.name, each.unit) for cable in cables for each in cable.numbers)
    rows = []
    for name, unit in names:
        cells = [f"`{name}` [{unit}]"]
        for cable in cables:
            own = [each for each in cable.numbers if each.name == name]
            cells.append(_interval(own[0]) if own else "-")
        rows.append(tuple(cells))
    return [
        _ABOUT_NUMBERS,
        "",
        *table(("number", *(cable.name for cable in cables)), rows),
    ]


def _interval(number: SummaryNumber) -> str:
    star = "*" if number.remark else ""
    return f"{number.value:.3g}{star} [{number.low:.3g}, {number.high:.3g}]".replace("*", "\\*")


def _wheel(wheel: WheelSummary, source: str) -> list[str]:
    return [
        f"### Wheels on soil: {wheel.name.replace('_', ' ')}",
        "",
        f"Measured by: {source}",
        "",
        f"{wheel.runs} runs in {wheel.settings} settings. {_ABOUT_WHEELS}",
        "",
        *table(
            ("runs", "number", "forward force [N]", "sideways force [N]", "sinkage [mm]",
             "in the 90 % band"),
            [
                (each.label, str(each.runs), *(f"{value:.2f}" for value in each.rms),
                 f"{each.coverage:.0%}")
                for each in wheel.errors
            ],
        ),
        "",
        "The largest errors, predicted less measured:",
        "",
        *(f"- {text}" for text in wheel.largest),
        "",
        "Identified from all runs, with 95 % intervals:",
        "",
        *table(
            ("number", "value", "remark"),
            [
                (f"`{each.name}` [{each.unit}]", _interval(replace(each, remark="")), each.remark)
                for each in wheel.numbers
            ],
        ),
        "",
    ]  # fmt: skip


def _references(rows: Sequence[Requirement], measured: Mapping[str, float]) -> list[str]:
    """The table of all that the suite is held to."""
    lines = [
        "### All that the suite is held to",
        "",
        _ABOUT_REFERENCES,
        "",
    ]
    cells = []
    for kind in REFERENCES:
        for row in rows:
            if row.reference == kind:
                value = measured.get(row.id)
                shown = "not measured" if value is None else f"{value:.3g}"
                cells.append((f"`{row.id}`", kind, row.statement, str(row.limit), shown))
    return [
        *lines,
        *table(("requirement", "held to", "statement", "limit", "measured"), cells),
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Write the results in the document of the validation between its markers. New results are "
        "kept in --results, which the document is written from. Exit codes: 0 written, 2 a file is "
        "refused."
    )
    add = parser.add_argument
    add("--summary", type=Path, metavar="FILE", help="new results of `validate summary`")
    add("--verification", type=Path, metavar="FILE", help="new results of `verify`: its JSON file")
    add("--results", type=Path, default=Path("docs/validation.yaml"), metavar="FILE",
        help="results that are kept (default: %(default)s)")  # fmt: skip
    add("--out", type=Path, default=Path("docs/validation.md"), metavar="FILE",
        help="document to write (default: %(default)s)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write the document; 2 after a refusal."""
    rows = load_requirements()
    try:
        results = results_of(options.results)
        if options.summary is not None:
            results = replace(results, summary=summary_of(options.summary))
        if options.verification is not None:
            new = {**results.measured, **measured_of(options.verification, rows)}
            order = [row.id for row in rows if row.id in new]
            results = replace(results, measured={name: new[name] for name in order})
        kept = results.to_mapping()
        results = ValidationResults.from_mapping(kept)  # rounded, as the document shows them
        text = document(read_text(options.out, LARGEST_TEXT), results, rows)
        options.results.write_text(
            yaml.safe_dump(kept, sort_keys=False, allow_unicode=True, width=100), encoding="utf-8"
        )
        options.out.write_text(text, encoding="utf-8")
    except (ResultsError, UnicodeDecodeError) as error:
        print(f"mother_rover validate page: {error}", file=sys.stderr)
        return REFUSED
    print(f"Written: {options.out}, {options.results}")
    return OK
