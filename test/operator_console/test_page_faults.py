"""The page in a real browser names each injected fault in time and offers no motion through it."""

from __future__ import annotations

import json
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest
from console_page import browser_page, sync_api
from scripted_machine import ANSWER, BRIDGE, PLANT, ScriptedMachine

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent
from msg_schemas.phases import JumpPhase, LoadState, PlantPhase, WinchMode
from msg_schemas.samples import Level, Status
from operator_console.commands import COMMANDS
from rover_launch.plan import HANGING_DEFAULTS
from rover_runtime.ros.endpoint_matching import UNKNOWN_NODE

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from rover_verify.harness import NodeHarness, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

WITHIN = 1.0  # until a dead plant, winch or link is shown [s]
OF_REPORT = 1.5  # until a node's report at 2 Hz is shown [s]
SILENT = 4.0  # until a node without a stream is shown as silent [s]
MOVING = frozenset(name for name, row in COMMANDS.items() if row.moves)
NOTHING: frozenset[str] = frozenset()

# Resolves when the banner shows a level and a text in a mode of the page; the result is the time of
# day, and the longest time for which the browser itself did not look [ms].
SHOWN = """([level, text, mode, timeout]) => new Promise((resolve, reject) => {
  const begun = performance.now();
  let last = begun, pause = 0;
  const look = () => {
    const now = performance.now();
    [pause, last] = [Math.max(pause, now - last), now];
    const found = document.getElementById("health").dataset.level;
    const banner = document.getElementById("health-text").textContent;
    const badge = document.getElementById("mode").dataset.mode;
    if (found === level && new RegExp(text).test(banner) && badge === mode) {
      resolve([Date.now(), pause]);
    } else if (now - begun > timeout) {
      reject(new Error(`${badge}: ${found}: ${banner}`));
    } else {
      setTimeout(look, 10);
    }
  };
  look();
})"""


@dataclass(frozen=True)
class Fault:
    """What is injected, and what the page must show.

    Attributes:
        level, text: of the banner; the text begins with the faulty part.
        mode: of the badge.
        blocked: commands that are not offered.
        within: longest time until it is shown [s].
        before: what works before and is not shown at first.
    """

    inject: Callable[[ScriptedMachine], object]
    level: str
    text: str
    mode: str = "live"
    blocked: frozenset[str] = NOTHING
    within: float = OF_REPORT
    before: Callable[[ScriptedMachine], object] = lambda _: None


def dies(*nodes: str) -> Callable[[ScriptedMachine], None]:
    def inject(it: ScriptedMachine) -> None:
        it.nodes -= {*nodes}

    return inject


def winch_dies_while_the_drive_waits(it: ScriptedMachine) -> None:
    it.waits["drive_node"] = topics.DRIVE_GOAL
    it.nodes -= {"winch_node"}


def reports(node: str, text: str, level: Level = Level.ERROR) -> Callable[[ScriptedMachine], None]:
    return lambda it: it.fail(node, text, level)


def sets(**values: object) -> Callable[[ScriptedMachine], None]:
    def inject(it: ScriptedMachine) -> None:
        for name, value in values.items():
            setattr(it, name, value)

    return inject


def plant_stops(phase: PlantPhase) -> Callable[[ScriptedMachine], None]:
    def inject(it: ScriptedMachine) -> None:
        text = f"the plant has stopped: {phase.value}"
        it.simulation = Status(f"{PLANT}: plant", text, Level.ERROR, PLANT, {"paused": "false"})
        it.texts[topics.TRUTH_PHASE] = phase.value
        it.speed = 0.0

    return inject


def winch_faults(fault: str) -> Callable[[ScriptedMachine], None]:
    def inject(it: ScriptedMachine) -> None:
        it.texts[topics.WINCH_MODE] = WinchMode.FAULT.value
        it.fail("winch_node", fault)

    return inject


def link(*statuses: tuple[str, str, Level]) -> Callable[[ScriptedMachine], None]:
    return lambda it: it.connect(*statuses)


def jump_fails(it: ScriptedMachine) -> None:
    it.texts[topics.JUMP_PHASE] = JumpPhase.FAULT.value
    it.fail("jump_node", "not_tripped")


def tension_rises(it: ScriptedMachine) -> None:
    it.alarms.add(machine.OVER_TENSION)
    it.texts[topics.TENSION_WATCH] = LoadState.OVER_TENSION.value


def dead_bridge(it: ScriptedMachine) -> None:
    it.nodes -= {BRIDGE}
    it.missing |= {topics.WINCH_STATE}


def of(*nodes: str) -> frozenset[str]:
    """Commands that need one of these nodes."""
    return frozenset(name for name in MOVING if set(COMMANDS[name].nodes) <= {*nodes})


ANSWERS = ("link", ANSWER, Level.OK)
FAULTS = {
    "winch killed": Fault(dies("winch_node"), "error", "^winch: dead", "stale", MOVING, WITHIN),
    "winch killed while the drive waits": Fault(
        winch_dies_while_the_drive_waits, "error", "^winch: dead", "stale", MOVING, WITHIN
    ),
    "plant killed": Fault(dies(PLANT), "error", "^plant: dead", "stale", MOVING, WITHIN),
    "plant and winch killed": Fault(
        dies(PLANT, "winch_node"), "error", "^plant: dead.* and 1 more", "stale", MOVING, WITHIN
    ),
    "all killed": Fault(
        lambda it: it.nodes.clear(), "error", "^plant: dead", "stale", MOVING, WITHIN
    ),
    "clock stopped": Fault(
        sets(speed=0.0), "error", "^plant: simulated time stands still", "stale", MOVING, WITHIN
    ),
    "paused": Fault(ScriptedMachine.pause, "warn", "^simulation: paused", "paused"),
    "two plants": Fault(
        sets(other_clock=-0.4), "error", "^plant: two plants", "stale", MOVING, WITHIN
    ),
    "diverged": Fault(
        plant_stops(PlantPhase.DIVERGED), "error", "^plant: .*diverged", "stale", MOVING, WITHIN
    ),
    "tether broken": Fault(
        plant_stops(PlantPhase.TETHER_BROKEN), "error", "^plant: .*broken", "stale", MOVING, WITHIN
    ),
    "encoder lost": Fault(
        lambda it: it.missing.add(topics.WINCH_STATE), "error", "^plant: dead: .*winch/state",
        "stale", MOVING, WITHIN,
    ),
    "encoder not a number": Fault(
        lambda it: it.invalid.add(topics.WINCH_STATE), "error", "^plant: dead: .*winch/state",
        "stale", MOVING, WITHIN,
    ),
    "estimate lost": Fault(
        lambda it: it.missing.add(topics.WINCH_ESTIMATE), "error", "^winch: dead", "stale", MOVING,
        WITHIN,
    ),
    "estimate not a number": Fault(
        lambda it: it.invalid.add(topics.WINCH_ESTIMATE), "error", "^winch: dead", "stale", MOVING,
        WITHIN,
    ),
    "too slow": Fault(
        reports(PLANT, "too slow for a real-time factor of 1", Level.WARN), "warn",
        f"^{PLANT}: .*too slow",
    ),
    "descent killed": Fault(
        dies("descent_node"), "stale", "^descent_node: dead", blocked=of("descent_node"),
        within=WITHIN,
    ),
    "descent's state not a number": Fault(
        lambda it: it.invalid.add(topics.DESCENT_STATE), "stale", "^descent_node: dead",
        blocked=of("descent_node"), within=WITHIN,
    ),
    "drive killed": Fault(
        dies("drive_node"), "stale", "^drive_node: dead", blocked=of("drive_node"), within=WITHIN
    ),
    "jump killed": Fault(
        dies("jump_node"), "stale", "^jump_node: silent", blocked=of("jump_node"), within=SILENT
    ),
    "mission killed": Fault(
        dies("mission_node"), "stale", "^mission_node: silent", blocked=of("mission_node"),
        within=SILENT,
    ),
    "recorder killed": Fault(dies("bag_record"), "stale", "^bag_record: silent", within=SILENT),
    "disk full": Fault(
        reports("bag_record", "no space left on the device"), "error", "^bag_record: .*no space"
    ),
    "descent waits": Fault(
        lambda it: it.waits.update(descent_node=topics.IMU), "warn",
        f"^descent_node: waiting for {topics.IMU}",
    ),
    "brake stuck": Fault(winch_faults("brake_stuck"), "error", "^winch_node: .*brake_stuck"),
    "drum not following": Fault(
        winch_faults("not_following"), "error", "^winch_node: .*not_following"
    ),
    "over-tension": Fault(tension_rises, "error", "^winch: over tension"),
    "snag": Fault(lambda it: it.alarms.add(machine.SNAG), "error", "^winch: snag"),
    "load cell lost": Fault(
        reports("winch_node", "tension by the motor current", Level.WARN), "warn",
        "^winch_node: .*motor current",
    ),
    "jump fails": Fault(jump_fails, "error", "^jump_node: .*not_tripped"),
    "drive's motor in fault": Fault(
        link(ANSWERS, ("wheel_drive", "fault", Level.ERROR)), "error", "^link: wheel_drive: fault"
    ),
    "link without answer": Fault(
        link(("link", "no answer: winch_drive", Level.ERROR)), "error",
        "^link: no answer: winch_drive", "stale", MOVING, WITHIN,
    ),
    "link dead": Fault(
        lambda it: it.missing.update((topics.LINK_STATUS, topics.WINCH_STATE)), "error",
        "^link: dead", "stale", MOVING, WITHIN, link(ANSWERS),
    ),
    "bridge killed": Fault(
        dead_bridge, "error", "^link: dead", "stale", MOVING, WITHIN, link(ANSWERS)
    ),
}  # fmt: skip


def wait_for_banner(
    page: Page, level: str, text: str, mode: str = "live", within: float = 60.0
) -> float:
    """Wait for a banner; returns how long it took, without pauses of the browser [s]."""
    begun = time.time()
    shown, pause = page.evaluate(SHOWN, [level, text, mode, (within + 5.0) * 1e3])
    return float(shown) * 1e-3 - begun - max(0.0, float(pause) * 1e-3 - 0.05)


@dataclass(frozen=True)
class Console:
    """The page of a scripted machine."""

    page: Page
    machine: ScriptedMachine
    process: Process

    def wait(self, level: str, text: str, mode: str = "live", within: float = 60.0) -> float:
        """Wait for a banner; returns how long it took, without pauses of the browser [s]."""
        return wait_for_banner(self.page, level, text, mode, within)

    def offered(self) -> set[str]:
        """Moving commands whose buttons are enabled."""
        buttons = self.page.locator("#command-list button:enabled")
        return {*buttons.evaluate_all("all => all.map(each => each.dataset.command)")} & MOVING


@pytest.fixture(scope="module")
def console(shared_harness: NodeHarness) -> Iterator[Console]:
    process = shared_harness.processes.start("operator_console.console_node", {"port": 0})
    address = process.wait_for_output(r"the page is at (\S+)").group(1)
    scripted = ScriptedMachine(shared_harness.observer())
    try:
        with browser_page() as page:
            page.goto(address)
            yield Console(page, scripted, process)
    finally:
        scripted.close()


@pytest.fixture
def sound(console: Console) -> Console:
    """The console with a machine in which everything works."""
    console.machine.mend()
    console.page.set_viewport_size({"width": 1440, "height": 900})
    console.wait("ok", "parts are OK")
    assert console.offered() == MOVING - of("sim_node")
    return console


@pytest.mark.parametrize("name", FAULTS)
def test_the_page_shows_a_fault_and_offers_no_motion_through_it(sound: Console, name: str):
    fault, page = FAULTS[name], sound.page
    fault.before(sound.machine)
    if sound.machine.link:
        sync_api().expect(page.locator("#nodes")).to_contain_text(ANSWER)
    fault.inject(sound.machine)
    took = sound.wait(fault.level, fault.text, fault.mode, fault.within)
    print(f"{name}: shown after {took:.2f} s")
    assert took < fault.within
    # First in the list as well, and in the banner's colour.
    first = page.locator("#nodes li").first
    assert first.get_attribute("data-level") == fault.level
    assert re.match(fault.text.partition(":")[0], f"{first.locator('b').inner_text()}")
    assert sound.offered() == MOVING - fault.blocked
    for stop in ("#hold", "#abort"):
        assert page.is_enabled(stop)
    if fault.blocked == MOVING:
        assert "nothing may move: " in page.inner_text("#commands-note")
    elif fault.blocked:
        assert page.locator("details .why:not(:empty)").count() > 0


def test_a_node_that_ended_well_is_no_fault_and_one_that_failed_is(sound: Console):
    sound.machine.inactive |= {"descent_node", "bag_record"}
    nodes = sync_api().expect(sound.page.locator("#nodes"))
    nodes.to_contain_text(re.compile("bag_record\\s*inactive"))
    sound.machine.nodes -= {"descent_node", "bag_record"}
    nodes.not_to_contain_text("bag_record")
    nodes.not_to_contain_text("descent_node")
    sound.wait("ok", "parts are OK")
    assert sound.offered() == MOVING - of("descent_node")
    sound.machine.mend()
    sound.machine.fail("bag_record", "no space left on the device")
    sound.wait("error", "no space")
    sound.machine.inactive |= {"bag_record"}
    nodes.to_contain_text(re.compile("bag_record\\s*inactive"))
    sound.machine.nodes -= {"bag_record"}
    sound.wait("error", "^bag_record: silent.*no space")


def test_the_server_refuses_what_an_old_page_would_send(sound: Console):
    request = """([name, content]) => new Promise((resolve) => {
      const socket = new WebSocket(`ws://${location.host}/live`);
      socket.onopen = () => socket.send(JSON.stringify({ id: 7, command: name, ...content }));
      socket.onmessage = (event) => {
        const content = JSON.parse(event.data);
        if (content.kind === "outcome") { socket.close(); resolve(content); }
      };
    })"""
    sound.machine.nodes -= {"winch_node"}
    sound.wait("error", "^winch: dead", "stale")
    for name in sorted(MOVING):
        needed = [each for each in COMMANDS[name].arguments if each.required]
        given = {each.name: 0.05 for each in needed}
        answer = sound.page.evaluate(request, [name, {"arguments": given}])
        assert (answer["done"], answer["code"]) == (False, "stale"), answer
        assert "winch: dead" in answer["reason"]
    answer = sound.page.evaluate(request, ["jog", {"renew": "a pressed button"}])
    assert (answer["done"], answer["status"]) == (False, "ended")
    assert "winch: dead" in answer["reason"]


def test_hold_is_reachable_by_key_beside_an_open_confirmation(sound: Console):
    page, orders = sound.page, sound.machine.orders
    accepted = page.locator("#answer[data-level=ok]")
    page.fill("#argument-descend-depth", "10")
    page.click('[data-command="descend"]')
    assert page.is_visible("#confirm-yes")
    page.click("#hold")  # nothing lies in front of it
    assert page.is_hidden("#confirm")
    accepted.wait_for()
    page.click('[data-command="descend"]')
    page.focus("#argument-descend-depth")
    page.keyboard.press("Escape")
    accepted.wait_for()
    assert page.is_hidden("#confirm")
    assert orders.count(topics.WINCH_HOLD) == 2
    page.click('[data-command="descend"]')
    sound.machine.nodes -= {"winch_node"}
    page.wait_for_selector("#confirm", state="hidden")
    assert orders.count(topics.WINCH_HOLD) == 2


@pytest.mark.parametrize("height", [360, 700])
@pytest.mark.parametrize("width", [320, 360, 480, 800, 1150, 1440, 2560])
def test_hold_is_on_screen_at_every_width_and_abort_stands_apart(
    console: Console, width: int, height: int
):
    page = console.page
    page.set_viewport_size({"width": width, "height": height})
    page.mouse.wheel(0, 5000)
    is_reachable = """(name) => {
      const box = document.getElementById(name).getBoundingClientRect();
      const found = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
      return box.x >= 0 && box.right <= innerWidth && found?.closest(`#${name}`) !== null;
    }"""
    assert page.evaluate(is_reachable, "hold")
    assert page.evaluate(is_reachable, "abort")
    hold, abort = page.locator("#hold").bounding_box(), page.locator("#abort").bounding_box()
    assert hold is not None
    assert abort is not None
    assert abort["x"] - (hold["x"] + hold["width"]) >= 24.0
    banner = page.locator("#health").bounding_box()
    assert banner is not None
    assert banner["y"] + banner["height"] <= height / 2
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_stopped_server_is_shown_and_a_dead_one_too(sound: Console):
    page = sound.page
    sound.process.send(signal.SIGSTOP)
    try:
        assert sound.wait("stale", "not current", "silent", WITHIN) < WITHIN
        assert sound.offered() == NOTHING
        assert page.is_enabled("#hold")
    finally:
        sound.process.send(signal.SIGCONT)
    sound.wait("ok", "parts are OK")
    sound.process.kill_group()
    assert sound.wait("stale", "not current", "lost", WITHIN) < WITHIN
    assert sound.offered() == NOTHING
    assert page.is_disabled("#hold")
    assert "NO CONNECTION" in page.inner_text("#lost")


def test_processes_that_are_killed_stopped_or_ended_in_a_descent(
    harness: NodeHarness, console: Console
):
    start = harness.processes.start
    server = start("operator_console.console_node", {"port": 0, "use_sim_time": True})
    overrides = json.loads(HANGING_DEFAULTS["overrides"]) | {"tether.length": 5.0}
    # Slow, so that a busy computer is no fault of its own.
    given = {**HANGING_DEFAULTS, "overrides": json.dumps(overrides), "real_time_factor": 0.2}
    plant = start("rover_sim.node.mock_plant_node", given)
    winch = start("tether_winch.winch_node", {"use_sim_time": True})
    descent = start("rover_control.hanging.descent_node", {"use_sim_time": True})
    recorder = start("rover_bags.recording.record", None, "-o", "bag")
    observer = harness.observer()
    for node in ("winch_node", "descent_node"):
        observer.wait_until_ready(node)
    assert observer.call(topics.WINCH_REARM).success
    observer.send_joint(topics.DESCENT_REQUEST, machine.PLAIN_STOP, 30.0, 0.2, stamp_ns=0)
    observer.wait_for_event(DescentEvent.ENGAGED)
    browser = console.page.context.browser
    assert browser is not None
    with browser.new_page() as page:
        page.goto(server.wait_for_output(r"the page is at (\S+)").group(1))
        nodes = sync_api().expect(page.locator("#nodes"))
        nodes.to_contain_text("bag_record")
        wait_for_banner(page, "ok", "parts are OK")
        winch.kill_group()
        took = wait_for_banner(page, "error", "^winch: dead", "stale", WITHIN)
        assert took < WITHIN
        assert page.is_disabled("[data-command=descend]")
        winch = start("tether_winch.winch_node", {"use_sim_time": True})
        page.wait_for_selector('#mode[data-mode="live"]')
        plant.send(signal.SIGSTOP)
        took = wait_for_banner(page, "error", "^plant: dead", "stale", WITHIN)
        plant.send(signal.SIGCONT)
        assert took < WITHIN
        page.wait_for_selector('#mode[data-mode="live"]')
        assert descent.stop() == 0
        nodes.not_to_contain_text("descent_node")
        assert page.is_disabled("[data-command=descend]")
        recorder.kill_group()
        wait_for_banner(page, "stale", "^bag_record: silent", within=SILENT)
        assert plant.stop() == 0
        page.wait_for_selector('#mode[data-mode="absent"]')
        nodes.not_to_contain_text("plant")


def test_a_console_whose_port_was_in_use_can_be_configured_again(harness: NodeHarness):
    observer = harness.observer()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        given = {"autostart": False, "port": taken.getsockname()[1]}
        harness.processes.start("operator_console.console_node", given)
        assert not observer.change_state("operator_console", "configure")
    assert observer.change_state("operator_console", "configure")

    def subscribers() -> list[str]:
        found = observer.node.get_subscriptions_info_by_topic(topics.EVENTS)
        return [each.node_name for each in found]

    def all_are_named() -> bool:
        names = subscribers()
        return "operator_console" in names and UNKNOWN_NODE not in names

    observer.wait_until(all_are_named, "subscribers without a name")
    assert subscribers().count("operator_console") == 1
