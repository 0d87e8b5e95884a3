"""``bag_report``: what a bag tells, in the terminal, as JSON for machines and as a page for people.

The page stands alone: it opens offline, in any browser, and loads nothing.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

from tqdm import tqdm

from rover_bags.compare import compare, write_comparison
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_bags.read import Progress
from rover_bags.survey import Survey, survey
from rover_bags.views.animation import write_gif
from rover_bags.views.plots import Plot
from rover_bags.views.report_page import as_page
from rover_bags.views.summary import as_mapping, as_text


class ExitCode(IntEnum):
    """What the exit code of ``bag_report`` says."""

    OK = 0
    REFUSED = 2
    NOT_WRITTEN = 3


def write_report(found: Survey, folder: Path) -> list[Path]:
    """Writes ``metrics.json``, ``report.html``, the plots as SVG files and the animation.

    Args:
        found: What was read, measured and drawn.
        folder: Where to write; made if it is not there.

    Returns:
        The files written.

    Raises:
        OSError: They cannot be written.
    """
    bag, metrics, drawings = found.bag, found.metrics, found.drawings
    folder.mkdir(parents=True, exist_ok=True)
    numbers, page = folder / "metrics.json", folder / "report.html"
    numbers.write_text(json.dumps(as_mapping(bag, metrics), indent=2) + "\n", encoding="utf-8")
    written = [numbers]
    if drawings is None:
        return written
    page.write_text(as_page(bag, metrics, drawings), encoding="utf-8")
    written.append(page)
    scene = drawings.run or next(iter(drawings.scenes), None)
    if scene is not None:
        animation = folder / "animation.gif"
        write_gif(scene, animation)
        written.append(animation)
    first: tuple[Plot, ...] = drawings.plots[0] if drawings.plots else ()
    for plot in (*first, *drawings.overall, *drawings.recording):
        file = folder / f"{plot.name}.svg"
        svg = plot.svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
        file.write_text(svg + "\n", encoding="utf-8")
        written.append(file)
    return written


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="bag_report",
        description="Reports what a bag holds: what the machine did when, descents, pictures, "
        "drives and jumps with their figures, audits of energy and momentum, rates, gaps and "
        "latencies of every topic, events and refusals. Bags that were never closed or are "
        "damaged are read as far as they are whole; long ones in bounded memory. Several bags are "
        "compared side by side.",
        epilog="exit codes: 0 reported, 2 no bag or none that can be read, 3 the report could "
        "not be written",
    )
    parser.add_argument(
        "bags", type=Path, nargs="+", metavar="bag",
        help="the bag: its folder or its .mcap file; several: they are compared",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="write metrics.json, report.html, plots and animation here (default: beside the bag, "
        "BAG_report); of several bags comparison.json and comparison.html (default: beside the "
        "first, BAG_comparison)",
    )  # fmt: skip
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON and write nothing else")
    form.add_argument("--html", action="store_true", help="print the page and write nothing else")
    parser.add_argument("--namespace", help="which rover, where a bag holds several")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


class _Bars:
    """Progress bars of the passes over bags, on a terminal or a log."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: Any = None

    def __call__(self, path: Path, what: str) -> Progress:
        self.close()
        total = BagScan(path).size
        self._bar = tqdm(
            total=total, desc=f"{path.name}, {what}", unit="B", unit_scale=True, mininterval=0.5,
            disable=self._quiet, leave=True,
        )  # fmt: skip
        bar = self._bar

        def told(done: int) -> None:
            bar.update(max(0, min(done, total) - bar.n))

        return told

    def close(self) -> None:
        if self._bar is not None:
            self._bar.update(max(0, self._bar.total - self._bar.n))
            self._bar.close()
            self._bar = None


def main(arguments: Sequence[str] | None = None) -> int:
    """The executable ``bag_report``; returns an :class:`ExitCode`."""
    options = _parser().parse_args(arguments)
    bars = _Bars(quiet=options.quiet)
    try:
        if len(options.bags) > 1:
            return _compare(options, bars)
        (path,) = options.bags
        drawn = not options.json or options.out is not None
        found = survey(path, namespace=options.namespace, drawn=drawn, reading=bars)
    except BagError as error:
        bars.close()
        print(f"bag_report: {error}", file=sys.stderr)
        return ExitCode.REFUSED
    bars.close()
    if options.json:
        _show(json.dumps(as_mapping(found.bag, found.metrics), indent=2))
    elif options.html and found.drawings is not None:
        _show(as_page(found.bag, found.metrics, found.drawings))
    else:
        _show(as_text(found.bag, found.metrics))
    if options.out is None and (options.json or options.html):
        return ExitCode.OK
    folder = options.out or path.with_name(path.name + "_report")
    return _written(folder, lambda: write_report(found, folder))


def _compare(options: argparse.Namespace, bars: _Bars) -> int:
    comparison = compare(options.bags, namespace=options.namespace, reading=bars)
    bars.close()
    if options.json:
        _show(json.dumps(comparison.to_mapping(), indent=2))
    elif options.html:
        _show(comparison.as_page())
    else:
        _show(comparison.as_text())
    if options.out is None and (options.json or options.html):
        return ExitCode.OK
    first = options.bags[0]
    folder = options.out or first.with_name(first.name + "_comparison")
    return _written(folder, lambda: write_comparison(comparison, folder))


def _show(text: str) -> None:
    """Print; a reader such as `head` may leave early, and the report is written all the same."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _written(folder: Path, write: Callable[[], list[Path]]) -> int:
    try:
        written = write()
    except OSError as error:
        why = error.strerror
        print(f"bag_report: cannot write the report into {folder}: {why}", file=sys.stderr)
        return ExitCode.NOT_WRITTEN
    print("\nwritten: " + ", ".join(str(path) for path in written), file=sys.stderr)
    return ExitCode.OK


if __name__ == "__main__":
    sys.exit(main())
