"""``mother_rover bag compare``: compare bags as text, JSON and an HTML page."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from rover_bags.files.store import BagError
from rover_bags.views.compare import compare, write_comparison
from rover_bags.views.report import (
    EXIT_CODES,
    ProgressBars,
    ReportExitCode,
    add_output_arguments,
    beside,
    list_written,
    show,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Compare bags: the metrics of each in a column, differences marked, plots overlaid."
    )
    parser.epilog = EXIT_CODES
    parser.add_argument("first", type=Path, metavar="BAG", help="a folder or an .mcap file")
    parser.add_argument("others", type=Path, nargs="+", metavar="BAG", help="further bags")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder of comparison.json and comparison.html (default: beside the first bag, "
        "BAG_comparison)",
    )  # fmt: skip
    add_output_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`~rover_bags.views.report.ReportExitCode`."""
    first: Path = options.first
    bars = ProgressBars(quiet=options.quiet)
    try:
        comparison = compare(
            [first, *options.others], namespace=options.namespace, progress_factory=bars
        )
    except BagError as error:
        bars.close()
        print(f"mother_rover bag compare: {error}", file=sys.stderr)
        return ReportExitCode.REFUSED
    bars.close()
    if options.json:
        show(json.dumps(comparison.to_mapping(), indent=2))
    elif options.html:
        show(comparison.as_page())
    else:
        show(comparison.as_text())
    if options.out is None and (options.json or options.html):
        return ReportExitCode.OK
    folder = options.out or beside(first, "_comparison")
    return list_written("compare", folder, lambda: write_comparison(comparison, folder))
