"""Draw a screenshot of the operators' page after an imaging stop, for the documents.

Starts the processes of `descent.launch.py` with the page, arms the winch, requests a stop with
imaging and takes the screenshot when it has ended:

    python tools/console_picture.py docs/console.png

Needs playwright and Debian's chromium.
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

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent
from rover_launch.plan import TRUE
from rover_verify.harness import open_harness
from rover_verify.harness.flight import DESCENT
from rover_verify.harness.launching import Launched, arm_winch

SIZE: ViewportSize = {"width": 1440, "height": 1000}
PAGE = "operator_console"
LONGEST = 1500.0  # wall time until the end of the stop [s]


def descend(launched: Launched, depth: float) -> None:
    """Arm, request a stop with imaging, and wait for its end."""
    launched.wait_until_ready()
    arm_winch(launched.observer)
    events = launched.observer.listen(topics.EVENTS)
    launched.observer.send_joint(
        topics.DESCENT_REQUEST, machine.OBSERVATION_STOP, depth, 0.0, stamp_ns=0
    )
    events.wait(
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
        "--depth", type=float, default=11.0, help="depth of the stop [m] (default: %(default)g)"
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, open_harness(Path(folder)) as harness:
        launched = Launched(harness, DESCENT, {"console": TRUE}, {PAGE: {"port": 0}})
        descend(launched, options.depth)
        address = launched.processes[PAGE].wait_for_output(r"the page is at (\S+)").group(1)
        take(address, options.picture.absolute())
    print(f"wrote {options.picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
