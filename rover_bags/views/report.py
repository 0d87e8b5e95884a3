"""``mother_rover bag report``: reports a bag in the terminal, as JSON and as a page.

The page stands alone: it opens offline, in any browser, and loads nothing.
"""

import argparse
import json
import re
import sys
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, Self

from tqdm import tqdm

from msg_schemas.regular_files import writing_problem
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_bags.reading.read import Progress, json_object
from rover_bags.views.animation import MovingScene, write_gif
from rover_bags.views.bag_analysis import BagAnalysis, analyse_bag
from rover_bags.views.plots import Plot
from rover_bags.views.report_page import as_page
from rover_bags.views.summary import as_mapping, as_text
from rover_runtime.text_output import discard


class ReportExitCode(IntEnum):
    """Exit codes of ``mother_rover bag report``, ``bag compare`` and ``bag export``."""

    OK = 0
    REFUSED = 2
    NOT_WRITTEN = 3


_NUMBERS: Final = "metrics.json"
_PAGE: Final = "report.html"
_ANIMATION: Final = "animation.gif"
_FILES: Final = "files"
"""Entry of ``metrics.json`` that lists the files of the report."""
_OWN_FILE: Final = re.compile(r"[\w-]+\.(html|gif|svg)")

EXIT_CODES = "Exit codes: 0 reported, 2 no readable bag, 3 the report could not be written."


def write_report(found: BagAnalysis, folder: Path) -> list[Path]:
    """Writes ``metrics.json``, ``report.html``, the plots as SVG files and the animation.

    Files of an earlier report in the folder, which its ``metrics.json`` lists, are removed.

    Args:
        found: What was read, measured and drawn.
        folder: Where to write; made if it is not there.

    Returns:
        The files written.

    Raises:
        OSError: They cannot be written.
    """
    bag, metrics, drawings = found.bag, found.metrics, found.drawings
    scene: MovingScene | None = None
    plots: dict[str, Plot] = {}
    if drawings is not None:
        scene = drawings.run or next(iter(drawings.scenes), None)
        first = drawings.plots[0] if drawings.plots else ()
        every = (*first, *drawings.overall, *drawings.recording)
        plots = {f"{plot.name}.svg": plot for plot in every}
    files = [_NUMBERS, *([_PAGE] if drawings else []), *([_ANIMATION] if scene else []), *plots]
    folder.mkdir(parents=True, exist_ok=True)
    for name in _files_of_report(folder) - set(files):
        (folder / name).unlink(missing_ok=True)
    content = {**as_mapping(bag, metrics), _FILES: files}
    (folder / _NUMBERS).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    if drawings is not None:
        (folder / _PAGE).write_text(as_page(bag, metrics, drawings), encoding="utf-8")
    if scene is not None:
        write_gif(scene, folder / _ANIMATION)
    for name, plot in plots.items():
        svg = plot.svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
        (folder / name).write_text(svg + "\n", encoding="utf-8")
    return [folder / name for name in files]


def _files_of_report(folder: Path) -> set[str]:
    """Names of the files of the report in a folder; empty without one."""
    try:
        content = json_object((folder / _NUMBERS).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return set()
    listed = content.get(_FILES)
    names = listed if isinstance(listed, list) else []
    return {name for name in names if isinstance(name, str) and _OWN_FILE.fullmatch(name)}


def beside(bag: Path, suffix: str) -> Path:
    """Return the folder of results beside a bag, which may be given as ``.``."""
    whole = bag if bag.name.strip(".") else bag.resolve()
    return whole.with_name(whole.name + suffix)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Report what a bag contains: activities of the machine, metrics of descents, imaging, "
        "drives and jumps, audits of energy and momentum, rates, gaps and latencies of every "
        "topic, events and refusals. A bag that was never closed or is damaged is read as far as "
        "it is valid; a long one in bounded memory."
    )
    parser.epilog = EXIT_CODES
    parser.add_argument("bag", type=Path, help="the bag: its folder or its .mcap file")
    content = "metrics.json, report.html, plots and animation (default: beside the bag, BAG_report)"
    add_output_arguments(parser, content)


def add_output_arguments(parser: argparse.ArgumentParser, content: str) -> None:
    """Add the arguments that reports and comparisons share.

    Args:
        parser: of the command.
        content: of the folder that is written, and its default.
    """
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"folder of {content}")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON and write nothing else")
    form.add_argument("--html", action="store_true", help="print the page and write nothing else")
    parser.add_argument("--namespace", metavar="NS", help="rover, if a bag holds several")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")


class ProgressBars:
    """Progress bars of the passes over bags, on a terminal or a log; a context that ends them."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: Any = None

    def __call__(self, path: Path, what: str) -> Progress:
        """Start the bar of one pass over a bag; return the function that moves it."""
        self.close()
        total = BagScan(path).size
        self._bar = tqdm(
            total=total, desc=f"{path.name}, {what}", unit="B", unit_scale=True, mininterval=0.5,
            disable=self._quiet, leave=True,
        )  # fmt: skip
        bar = self._bar

        def show(done: int) -> None:
            bar.update(max(0, min(done, total) - bar.n))

        return show

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Complete the bar that is shown."""
        if self._bar is not None:
            self._bar.update(max(0, self._bar.total - self._bar.n))
            self._bar.close()
            self._bar = None


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`ReportExitCode`."""
    path: Path = options.bag
    try:
        with ProgressBars(quiet=options.quiet) as bars:
            found = analyse_bag(
                path,
                namespace=options.namespace,
                with_drawings=not options.json or options.out is not None,
                progress_factory=bars,
            )
    except BagError as error:
        return refused("report", error)
    if options.json:
        text = json.dumps(as_mapping(found.bag, found.metrics), indent=2)
    elif options.html and found.drawings is not None:
        text = as_page(found.bag, found.metrics, found.drawings)
    else:
        text = as_text(found.bag, found.metrics)
    folder = beside(path, "_report")
    return deliver("report", options, text, folder, lambda folder: write_report(found, folder))


def complain(command: str, problem: object) -> None:
    """Print a problem of a command of ``mother_rover bag`` on standard error."""
    print(f"mother_rover bag {command}: {problem}", file=sys.stderr)


def refused(command: str, error: Exception) -> ReportExitCode:
    """Print why a command cannot read its bags; return its exit code."""
    complain(command, error)
    return ReportExitCode.REFUSED


def show(text: str) -> None:
    """Print; a reader such as `head` may leave early, and the report is written all the same."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        discard(sys.stdout)


def deliver(
    command: str,
    options: argparse.Namespace,
    text: str,
    default: Path,
    write: Callable[[Path], list[Path]],
) -> int:
    """Print the text; write the files and list them on standard error, unless only text is wanted.

    Args:
        command: of ``mother_rover bag``.
        options: with those of `add_output_arguments`.
        text: to print.
        default: folder of the files where `options` names none.
        write: writes the files into a folder.

    Returns:
        An :class:`ReportExitCode`.
    """
    show(text)
    if options.out is None and (options.json or options.html):
        return ReportExitCode.OK
    folder: Path = options.out or default
    try:
        written = write(folder)
    except OSError as error:
        complain(command, writing_problem(error, folder))
        return ReportExitCode.NOT_WRITTEN
    print("\nwritten: " + ", ".join(str(path) for path in written), file=sys.stderr)
    return ReportExitCode.OK
