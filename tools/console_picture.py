"""Draw a screenshot of the operators' page after an imaging stop, for the documents.

Starts simulator, winch, descent and page, arms the winch, requests a stop with imaging and takes
the screenshot when it has ended:

    python tools/console_picture.py docs/console.png

Needs playwright and Debian's chromium. On a slow machine use --factor 0.5 or less.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from playwright.sync_api import ViewportSize, sync_playwright

from msg_schemas import topics
from msg_schemas.events import DescentEvent
from msg_schemas.machine import OBSERVATION_STOP
from rover_launch.plan import HANGING_DEFAULTS
from rover_verify.harness import NodeHarness, Observer, open_harness

ROOT = Path(__file__).parents[1]
SIZE: ViewportSize = {"width": 1440, "height": 1000}
PAGE = r"the page is at (\S+)"
LONGEST = 1500.0  # wall time until the end of the stop [s]


def start(harness: NodeHarness, factor: float) -> str:
    """Start all processes; return the address of the page."""
    begin = harness.processes.start
    begin("rover_sim.node.sim_node", {**HANGING_DEFAULTS, "real_time_factor": factor})
    with_descent = ROOT / "config" / "winch_descent.yaml"
    begin("tether_winch.winch_node", {"use_sim_time": True}, params_file=with_descent)
    begin("rover_control.hanging.descent_node", {"use_sim_time": True})
    page = begin("operator_console.console_node", {"use_sim_time": True, "port": 0})
    return page.wait_for_output(PAGE).group(1)


def descend(observer: Observer, depth: float) -> None:
    """Arm, request a stop with imaging, and wait for its end."""
    observer.listen(topics.CLOCK).wait(timeout=LONGEST)  # the first start compiles the plant
    for node in ("winch_node", "descent_node"):
        observer.wait_until_ready(node)
    assert observer.call(topics.WINCH_REARM).success
    observer.send_joint(topics.DESCENT_REQUEST, OBSERVATION_STOP, depth, 0.0, stamp_ns=0)
    observer.listen(topics.EVENTS).wait(
        lambda sample: any(each.name == DescentEvent.STOP_COMPLETED for each in sample.statuses),
        timeout=LONGEST,
    )


def take(address: str, picture: Path) -> None:
    """Open the page and write a screenshot."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("chromium is missing: run apt-get install chromium")
    own: dict[str, str | float | bool] = {
        name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"
    }
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, env=own)
        page = browser.new_page(viewport=SIZE)
        page.goto(address)
        page.wait_for_selector('body[data-link="live"]')
        page.wait_for_timeout(3000.0)
        page.screenshot(path=str(picture))
        browser.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate the descent and write the screenshot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="file to write, .png")
    parser.add_argument(
        "--factor", type=float, default=1.0, help="real-time factor (default: %(default)g)"
    )
    parser.add_argument(
        "--depth", type=float, default=11.0, help="depth of the stop [m] (default: %(default)g)"
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, open_harness(Path(folder)) as harness:
        address = start(harness, options.factor)
        descend(harness.observer(), options.depth)
        take(address, options.picture.absolute())
    print(f"wrote {options.picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
