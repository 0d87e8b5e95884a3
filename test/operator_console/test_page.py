"""The page in a real browser: a descent by click, a refusal with its reason, a bag replayed."""

from __future__ import annotations

import json
import re
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from console_page import PATIENCE, browser_page, sync_api
from contract_bag import MadeUp, Parabola

from msg_schemas import topics
from msg_schemas.events import JumpEvent
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, MissionPhase
from msg_schemas.samples import TextSample
from operator_console.bag_shelf import BagShelf
from operator_console.page_access import PageAccess
from operator_console.server import Content, Server, ServerSettings
from operator_console.views import time_text
from rover_launch.loop import Parameters
from rover_launch.plan import HANGING_DEFAULTS, LOCKSTEP, MOCK, TRUE
from rover_verify.harness.flight import DESCENT

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from rover_verify.harness import NodeHarness

pytestmark = [pytest.mark.process]

START, LOW = 5.0, 30.0  # start and target depth [m]
POLL_PERIOD = 50  # [ms]
PLACE = {"wall": [], "floor": [[-9, -30, 9, -30]], "levels": [], "boulders": [[1, 0, -29, 1]]}
PHASES = {
    topics.MISSION_PHASE: MissionPhase.APPROACHING,
    topics.DESCENT_PHASE: DescentPhase.TRAVELLING,
    topics.DRIVE_PHASE: DrivePhase.BALANCING,
    topics.JUMP_PHASE: JumpPhase.LETTING_DOWN,
}
QUICK: dict[str, object] = {"estimator_settling_time": 1.5, "steady_dwell": 0.3}


class Pit:
    """Console, the mock plant, winch and descent as processes."""

    def __init__(self, harness: NodeHarness) -> None:
        from rover_verify.harness.launching import Launched

        self.console = harness.processes.start("operator_console.console_node", {"port": 0})
        overrides = json.loads(HANGING_DEFAULTS["overrides"]) | {"tether.length": START}
        given = {"plant": MOCK, "overrides": json.dumps(overrides), LOCKSTEP: TRUE}
        # Simulated time does not wait for the browser.
        changed: Parameters = {"winch_node": {"command_timeout": 30.0}, "descent_node": QUICK}
        Launched(harness, DESCENT, given, changed).wait_until_ready()
        self.address = self.console.wait_for_output(r"the page is at (\S+)").group(1)


@pytest.fixture
def pit(harness: NodeHarness) -> Pit:
    return Pit(harness)


def shown(page: Page, key: str) -> float:
    """A number of the page."""
    return float(page.inner_text(f'[data-value="{key}"] .value').replace("−", "-"))


def wait_for(page: Page, selector: str, text: str) -> None:
    """Wait until the whole text of an element matches."""
    element = sync_api().expect(page.locator(selector))
    element.to_have_text(re.compile(f"^(?:{text})$"), timeout=PATIENCE)


def wait_for_depth(page: Page, depth: float) -> None:
    """Wait until the page shows a larger depth [m]."""
    for _ in range(PATIENCE // POLL_PERIOD):
        if shown(page, "depth") > depth:
            return
        page.wait_for_timeout(POLL_PERIOD)
    raise AssertionError(f"the page shows no depth beyond {depth:g} m")


def order(page: Page, name: str, **arguments: float) -> None:
    """Fill in a command and press its button."""
    for argument, value in arguments.items():
        page.fill(f"#argument-{name}-{argument}", f"{value:g}")
    page.click(f'[data-command="{name}"]')


def descend(page: Page) -> None:
    """Until it is accepted: on a busy computer sensors may be stale for a moment."""
    for _ in range(20):
        order(page, "descend", depth=LOW, rate=0.2)
        assert re.search(r"depth \d+\.\d", page.inner_text("#confirm-now"))
        page.click("#confirm-yes")
        answer = page.locator('#answer:is([data-level="ok"], [data-level="error"])')
        wait_for(page, "#answer b", f"descend {LOW:g} m rate 0.2 m/s: .*")
        if "accepted" in answer.inner_text():
            return
        assert "[stale]" in answer.inner_text()
    raise AssertionError("the descent is refused again and again")


@pytest.mark.ros
def test_an_operator_descends_by_click_and_reads_the_reason_of_a_refusal(pit: Pit):
    with browser_page() as page:
        page.goto(pit.address)
        page.wait_for_selector('body[data-link="live"]')
        wait_for(page, "[data-phase=winch]", "disarmed")
        assert shown(page, "depth") == pytest.approx(START, abs=0.05)

        # A command that moves something needs confirmation; Cancel sends nothing.
        order(page, "arm")
        assert "arm?" in page.inner_text("#confirm-title")
        page.click("#confirm-no")
        assert page.is_hidden("#answer")
        order(page, "arm")
        page.click("#confirm-yes")
        page.wait_for_selector('#answer[data-level="ok"]')
        wait_for(page, "[data-phase=winch]", "hold")

        # The page refuses values beyond the contract, the node values beyond the machine.
        order(page, "descend", depth=5000.0)
        assert "depth: 5000 is outside 0 to 1000 m" in page.inner_text(".problem:visible")
        order(page, "descend", depth=900.0)
        page.click("#confirm-yes")
        page.wait_for_selector('#answer[data-level="error"]')
        refusal = page.inner_text("#answer")
        assert "descend 900 m: refused" in refusal
        assert "[out_of_limits]" in refusal
        assert re.search(r"\b48\b", refusal), refusal
        assert shown(page, "depth") == pytest.approx(START, abs=0.05)

        # A dead-man command lasts exactly while its button is pressed.
        page.click("details[data-group=winch] summary")
        page.fill("#argument-jog-rate", "0.02")
        page.hover("[data-command=jog]")
        page.mouse.down()
        wait_for(page, "[data-phase=winch]", "rate")
        wait_for_depth(page, START + 0.01)
        page.mouse.up()
        wait_for(page, "[data-phase=winch]", "hold")
        wait_for(page, "#answer b", "hold: accepted")

        descend(page)
        wait_for_depth(page, shown(page, "depth") + 0.05)
        assert f"descend {LOW:g}" in page.inner_text("#journal")

        # HOLD needs no confirmation.
        page.click("#hold")
        wait_for(page, "[data-phase=descent]", "holding")
        assert shown(page, "depth") < LOW

        # The page shows that the console has stopped.
        pit.console.stop()
        page.wait_for_selector("#lost", state="visible")
        assert "NO CONNECTION" in page.inner_text("#lost")
        assert page.is_disabled("#hold")
        assert page.is_disabled('[data-command="descend"]')


def test_a_bag_is_replayed_on_the_same_page(tmp_path: Path):
    made = MadeUp()
    jump = Parabola()
    made.jumps([jump], until=3.0, rate=50.0)
    made.event(2.5, JumpEvent.LANDED, "it stands", {})
    for topic, phase in PHASES.items():
        made.add(0.5, topic, TextSample(phase))
    made.write(tmp_path / "jump")
    settings = ServerSettings("127.0.0.1", 0, PageAccess(), BagShelf(tmp_path))
    server = Server(settings, _nothing, lambda: {"frames": [], "journal": []})
    server.latch("commands", {"commands": []})
    server.latch("place", {"place": PLACE})
    server.start()
    try:
        with browser_page() as page:
            page.goto(server.address)
            written = page.evaluate("import('/page/format.js').then((m) => m.machineTime(1.7e9))")
            assert written == time_text(1.7e9) == "22:13:20Z"
            page.wait_for_selector('#bags option[value="jump"]', state="attached")
            page.select_option("#bags", "jump")
            page.wait_for_selector('body[data-mode="replay"]')
            assert "of 00:03" in page.inner_text("#replay-time")
            page.wait_for_selector(".mark", state="attached")
            assert page.is_hidden("#journal li")
            page.select_option("#speed", "4")
            page.click("#play")
            wait_for(page, "#replay-time", "00:03 of .*")
            assert shown(page, "tension") == pytest.approx(5.0)
            assert "landed" in page.inner_text("#journal")
            assert page.inner_text("[data-phase=plant]").startswith("landed")
            for topic, phase in PHASES.items():
                shown_phase = page.inner_text(f"[data-phase={topic.partition('/')[0]}]")
                assert shown_phase.startswith(phase.replace("_", " "))
            for width in (1200, 1440):  # however long the phases are, HOLD stays at the top right
                page.set_viewport_size({"width": width, "height": 900})
                hold, mode = (page.locator(each).bounding_box() for each in ("#hold", "#mode"))
                assert hold is not None
                assert mode is not None
                assert (hold["y"] == mode["y"], hold["x"] > 0.5 * width) == (True, True)
            page.click(".mark")
            wait_for(page, "#replay-time", "00:02 of .*")
            page.click("#live")
            page.wait_for_selector('body[data-mode="live"]')
    finally:
        server.stop()


def _nothing(_request: Content) -> Future[Content]:
    raise AssertionError("no command is expected")
