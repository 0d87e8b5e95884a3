"""The page in a real browser never hides a danger, and HOLD is always within reach."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from console_page import browser_page

from msg_schemas import machine, topics
from msg_schemas.health import Health
from msg_schemas.phases import HealthState
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    Level,
    Sample,
    Status,
    StatusSample,
)
from operator_console.bag_shelf import BagShelf
from operator_console.console_node import command_rows
from operator_console.page_access import Access
from operator_console.page_state import PageState, frame
from operator_console.server import Content, Server, ServerSettings
from operator_console.telemetry import Telemetry

if TYPE_CHECKING:
    from playwright.sync_api import Page

PERIOD = 0.05  # of samples and frames [s]
WITHIN = 1000.0  # a danger is shown at the latest [ms]


def health(node: str, missing: tuple[str, ...] = ()) -> StatusSample:
    state = HealthState.WAITING if missing else HealthState.READY
    return StatusSample(1, (Health(node, state, missing).status({}),))


class Machine:
    """A machine whose parts can die, shown by a server."""

    def __init__(self) -> None:
        self.dead: set[str] = set()
        self.orders: list[str] = []
        settings = ServerSettings("127.0.0.1", 0, Access(), BagShelf(None))
        self.server = Server(settings, self._on_command, lambda: {"frames": [], "journal": []})
        self.server.latch("commands", {"commands": command_rows()})
        self._telemetry, self._state = Telemetry(), PageState()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._begun = time.monotonic()

    def _on_command(self, request: Content) -> Future[Content]:
        self.orders.append(str(request["command"]))
        answer: Future[Content] = Future()
        answer.set_result({"done": True, "reason": "done", "code": "", "status": "accepted"})
        return answer

    def samples(self, now: float) -> Iterator[tuple[str, Sample]]:
        stamp_ns = round((now - self._begun) * 1e9)
        if "plant" not in self.dead:
            yield topics.CLOCK, ClockSample(stamp_ns)
            status = Status(
                "sim_node: simulation", "runs", Level.OK, "sim_node", {"paused": "false"}
            )
            yield topics.SIM_STATUS, StatusSample(stamp_ns, (status,))
            drum = {machine.WINCH_DRUM: JointValue(5.0, 0.1), machine.WINCH_BRAKE: JointValue(1.0)}
            yield topics.WINCH_STATE, JointSample(stamp_ns, drum)
            yield topics.DIAGNOSTICS, health("drive_node", (topics.DRIVE_GOAL,))
        if "winch" not in self.dead:
            yield topics.DIAGNOSTICS, health("winch_node")
            estimate = {
                machine.PAYOUT: JointValue(5.0, 0.1),
                machine.TENSION: JointValue(1.0, 0.0, 16.0),
            }
            yield topics.WINCH_ESTIMATE, JointSample(stamp_ns, estimate)

    def _run(self) -> None:
        while not self._stop.wait(PERIOD):
            now = time.monotonic()
            for topic, sample in self.samples(now):
                self._telemetry.on_sample(topic, sample, now)
            made = frame(self._telemetry.snapshot(now), self._state, now, now - self._begun)
            self.server.send("frame", made)

    @contextmanager
    def shown(self, width: int = 1440, height: int = 900) -> Iterator[Page]:
        self.server.start()
        self._thread.start()
        try:
            with browser_page(width, height) as page:
                page.goto(self.server.address)
                page.wait_for_selector('#health:not([data-level="unknown"])')
                yield page
        finally:
            self._stop.set()
            self._thread.join()
            self.server.stop()


@pytest.mark.parametrize("part", ["winch", "plant"])
def test_a_dead_part_is_red_and_first_and_nothing_may_move(part: str):
    made = Machine()
    with made.shown() as page:
        page.wait_for_selector('#health[data-level="warn"]')  # the drive waits for a goal
        assert page.is_enabled('[data-command="descend"]')
        made.dead.add(part)
        begun = time.monotonic()
        page.wait_for_selector('#health[data-level="error"]')
        waited = (time.monotonic() - begun) * 1e3
        assert waited < WITHIN + 500.0  # of the browser and the driver
        page.wait_for_selector('#mode[data-mode="stale"]')
        assert page.inner_text("#health-text").startswith(f"{part}: dead")
        assert page.inner_text("#nodes li >> nth=0").split()[1] == part
        assert page.inner_text("#mode-title") == "STALE"
        assert f"nothing may move: {part}" in page.inner_text("#commands-note")
        moving = [row["name"] for row in command_rows() if row["moves"]]
        for name in moving:
            assert page.is_disabled(f'[data-command="{name}"]'), name
        assert page.is_enabled("#hold")
        assert page.is_enabled("#abort")
        made.dead.clear()
        page.wait_for_selector('#mode[data-mode="live"]')
        assert page.is_enabled('[data-command="descend"]')


def test_hold_is_reachable_by_key_beside_an_open_confirmation():
    made = Machine()
    with made.shown() as page:
        page.fill("#argument-descend-depth", "10")
        page.click('[data-command="descend"]')
        assert page.is_visible("#confirm-yes")
        page.click("#hold")  # nothing lies in front of it
        assert page.is_hidden("#confirm")
        page.click('[data-command="descend"]')
        page.focus("#argument-descend-depth")
        page.keyboard.press("Escape")
        page.wait_for_selector('#answer[data-level="ok"]')
        assert page.is_hidden("#confirm")
        assert made.orders == ["hold", "hold"]
        page.click('[data-command="descend"]')
        made.dead.add("winch")
        page.wait_for_selector("#confirm", state="hidden")
        assert made.orders == ["hold", "hold"]


@pytest.mark.parametrize("width", [320, 480, 760, 1150, 1440, 2560])
def test_hold_is_on_screen_at_every_width_and_abort_stands_apart(width: int):
    made = Machine()
    with made.shown(width, 700) as page:
        page.mouse.wheel(0, 5000)
        page.wait_for_timeout(100)
        hit = """() => {
          const box = document.getElementById("hold").getBoundingClientRect();
          const found = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
          return box.x >= 0 && box.right <= innerWidth && found.closest("#hold") !== null;
        }"""
        assert page.evaluate(hit)
        hold, abort = page.locator("#hold").bounding_box(), page.locator("#abort").bounding_box()
        assert hold is not None
        assert abort is not None
        assert abort["x"] - (hold["x"] + hold["width"]) >= 24.0
