"""Demonstration of a whole mission in the Marius Hills Hole, flown by the nodes.

The nodes of the launch file ``mission`` run in lockstep, as fast as the machine allows: plant and
controllers in one process, recorder and operators' page beside it. This process is the operator: it
starts the mission, follows it to its end, stops the processes, and has the bag reported. All
metrics are those of the report.
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msg_schemas import machine, topics
from msg_schemas.events import MissionEvent
from msg_schemas.phases import MissionPhase
from rover_bags.analysis.geometry import rotations
from rover_bags.reading.read import read_bag
from rover_control.mission.mission_plan import load_plan
from rover_control.mission.mission_route import LegKind, itinerary
from rover_launch.loop import Parameters
from rover_launch.plan import HANGING_DEFAULTS
from rover_sim import load_spatial
from rover_verify.demo import all_nodes
from rover_verify.demo.show import Show, ShowError, completed, write_report
from rover_verify.demo.stones import STONES, passage
from rover_verify.harness import open_harness
from rover_verify.harness.flight import MISSION
from rover_verify.harness.launching import Launched

SCENARIO, PLAN = "marius_hills", "demonstration"
OVERRIDES: Mapping[str, object] = json.loads(HANGING_DEFAULTS["overrides"]) | {
    "tether.length": 2.0,
    "environment.seed": 130,  # the floor falls towards the stones
    "environment.boulders.placed": list(STONES),
}
LIMIT = 3000.0
"""Wall time limit of the mission [s]."""
_READY_TIMEOUT = 300.0  # wall time; on a cold cache the simulator compiles [s]
_PAGE, _PAGE_PORT = "operator_console", 8642
_TARGET_TIME = 180.0  # wall time that the demonstration should take [s]
_BALANCE = 1e-4  # allowed error of the energy balance, as a fraction of the energy of the descent
_STOWED = 0.2  # tolerance of the length at the stow [m]
_ENDS = (MissionEvent.COMPLETED, MissionEvent.BLOCKED, MissionEvent.INTERRUPTED)

Metrics = Mapping[str, Any]


def show_mission(
    folder: Path,
    *,
    domain: int | None = None,
    seed: int = 1,
    quiet: bool = False,
    announce: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Run the mission in an existing folder; returns the metrics including the verdict.

    Args:
        folder: for bag and report.
        domain: ROS domain; None = a reserved one.
        seed: of the sensor errors.
        quiet: no progress bar.
        announce: called with lines for the operator.

    Raises:
        ShowError: a step failed.
        AssertionError: a process failed.
    """
    began = time.monotonic()
    with ExitStack() as closing:
        bar = closing.enter_context(
            tqdm(
                total=1, disable=quiet, dynamic_ncols=True, leave=False,
                bar_format="{desc} |{bar:20}| {remaining} left, {postfix}",
            )
        )  # fmt: skip
        harness = closing.enter_context(open_harness(folder, domain))
        settings: Parameters = {
            "mission_node": {"plan": PLAN, "checkpoint": "none"},
            _PAGE: {"port": _free_port()},
        }
        launched = Launched(harness, MISSION, arguments(seed), settings, arrange=all_nodes.merged)
        running = Show(launched, bar)
        running.follow(
            "starting",
            lambda: not running.not_ready(),
            lambda: f"waiting for {', '.join(running.not_ready())}",
            _READY_TIMEOUT,
        )
        page = running.processes[_PAGE].wait_for_output(r"the page is at (\S+)").group(1)
        announce(f"operators' page until the mission ends: {page}")
        setting = f"ROS_DOMAIN_ID={harness.domain} " if harness.domain else ""
        announce(f"in a second terminal: {setting}rover status")
        ready = time.monotonic() - began
        _fly(running)
        flown = time.monotonic() - began - ready
        plant = running.last(topics.SIM_STATUS).statuses[0]
        peak_tension = float(plant.values["peak_tension"])
        running.stop()
        bar.set_description_str("reporting")
        metrics = write_report(folder, harness.domain)
    body = read_bag(folder / "bag", {topics.TRUTH_BODY1}).series(topics.TRUTH_BODY1)
    if body is None:
        raise ShowError(f"the bag holds no {topics.TRUTH_BODY1}")
    stones = passage(load_spatial(SCENARIO, OVERRIDES), body.vector("position"), rotations(body))
    mission = {
        **outcome(metrics),
        "stone_height_m": stones.height,
        "stone_clearance_m": stones.clearance,
        "peak_tension_N": peak_tension,
        "ready_after_s": ready,
        "flown_in_s": flown,
        "real_time_factor": metrics["simulated_s"] / flown,
        "wall_time_s": time.monotonic() - began,
    }
    return completed(
        folder,
        metrics,
        judge(mission, metrics),
        scenario=SCENARIO,
        overrides=OVERRIDES,
        seed=seed,
        mission=mission,
        wall_time_s=mission["wall_time_s"],
    )


def arguments(seed: int) -> dict[str, str]:
    """Return the arguments of the launch: lockstep, as fast as possible, recorder and page."""
    return {
        "scenario": SCENARIO,
        "overrides": json.dumps(OVERRIDES),
        "seed": str(seed),
        "real_time_factor": "0",
        "lockstep": "true",
        "record": "bag",
        "console": "true",
        "frames": "false",
    }


def _free_port() -> int:
    """Return the page's usual port, or 0 = any where it is in use."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", _PAGE_PORT))
        except OSError:
            return 0
    return _PAGE_PORT


# --- the flight ----------------------------------------------------------------------------------


def _fly(running: Show) -> None:
    """Start the mission and follow it to its end."""
    observer = running.observer
    for name in (topics.MISSION_PHASE, topics.DESCENT_STATE, topics.SIM_STATUS):
        observer.listen(name)
    answer = observer.call(topics.MISSION_GO)
    if not answer.success:
        raise ShowError(f"the mission does not start: {answer.message}")
    running.bar.reset(len(itinerary(load_plan(PLAN))))

    def status() -> str:
        started = running.observer.events(MissionEvent.LEG_STARTED)
        running.bar.n = int(started[-1].values["number"]) - 1 if started else 0
        phase = running.last(topics.MISSION_PHASE)
        running.bar.set_description_str(f"{phase.text if phase else '':11}", refresh=False)
        state = running.last(topics.DESCENT_STATE)
        return "" if state is None else f"{state.joints[machine.DEPTH].position:.1f} m deep"

    running.follow("mission", lambda: running.observer.events(*_ENDS), status, LIMIT)


# --- the outcome ---------------------------------------------------------------------------------


def outcome(metrics: Metrics) -> dict[str, Any]:
    """Metrics of the mission, from those of the report of its bag."""
    events = metrics["events"]

    def named(*names: MissionEvent) -> list[Mapping[str, Any]]:
        return [each for each in events if each["name"] in names]

    ends = named(*_ENDS)
    phases = named(MissionEvent.PHASE_CHANGED)
    # An interval of a few samples has no depth.
    descents = [each for each in metrics["descents"] if each["depth_to_m"] is not None]
    plan = load_plan(PLAN)
    scenario = load_spatial(SCENARIO, OVERRIDES)
    deepest = max((each["depth_to_m"] for each in descents), default=math.nan)
    last = descents[-1] if descents else {"to_m": math.nan, "depth_to_m": math.nan}
    phase = phases[-1]["values"]["phase"] if phases else ""
    is_standing_by = phase == MissionPhase.STANDBY and bool(named(MissionEvent.COMPLETED))
    is_at_stow = abs(last["to_m"] - plan.stow) < _STOWED and last["depth_to_m"] < plan.stow + 1.0
    return {
        "plan": PLAN,
        "legs_done": [each["values"]["leg"] for each in named(MissionEvent.LEG_COMPLETED)],
        "legs_missed": {
            each["values"]["leg"]: each["message"] for each in named(MissionEvent.LEG_FAILED)
        },
        "phase": phase,
        "reason": ends[-1]["message"] if ends else "the mission has not ended",
        "home": is_at_stow and is_standing_by,
        "depth_m": last["depth_to_m"],
        "deepest_m": deepest,
        "pictures": metrics["coverage"]["images"] if metrics["coverage"] else 0,
        "jumps": len(metrics["jumps"]),
        "jumps_planned": sum(leg.kind is LegKind.JUMP for leg in itinerary(plan)),
        "breaking_load_N": scenario.tether.section.breaking_load,
        "energy_J": scenario.tip_mass * scenario.gravity * deepest,
        "simulated_s": metrics["simulated_s"],
    }


def judge(mission: Mapping[str, Any], metrics: Mapping[str, Any]) -> list[tuple[str, bool]]:
    """Check each requirement; returns lines of text and whether they pass."""
    missed = mission["legs_missed"]
    skipped = "; ".join(f"{leg}: {reason}" for leg, reason in missed.items())
    total = len(mission["legs_done"]) + len(missed)
    where = f"{mission['depth_m']:.1f} m below the fairlead, {mission['phase']}"
    home = (
        "hangs at the stow"
        if mission["home"]
        else (f"NOT at the stow, {where}: {mission['reason']}")
    )
    peak, breaking_load = mission["peak_tension_N"], mission["breaking_load_N"]
    drift, moved = metrics.get("energy_drift_J"), mission["energy_J"]
    drift = drift if isinstance(drift, int | float) else math.nan
    energy = f"balance error {drift:+.1e} J of {moved:.0f} J released by the descent"
    counts = metrics.get("topics", {}).values()
    rejected = sum(item.get("rejected") or 0 for item in counts)
    legs = f"{len(mission['legs_done'])} of {total} done"
    pace = f"{mission['real_time_factor']:.1f} times as fast as real time"
    warnings = len(metrics.get("warnings", ()))
    clearance = mission["stone_clearance_m"]
    passed = (
        "NOT jumped over"
        if not clearance > 0.0
        else f"jumped over with a clearance of {clearance:.2f} m"
    )
    bag = (
        f"{'closed' if metrics.get('closed') else 'NOT closed'}, {rejected} messages break the "
        f"contract, {warnings} warnings about its data"
    )
    return [
        (f"rover      {home}", bool(mission["home"])),
        (f"legs       {legs}{f', not done: {skipped}' if skipped else ''}", not missed),
        (f"pictures   {mission['pictures']} of the wall", mission["pictures"] > 0),
        (
            f"jumps      {mission['jumps']} flown, {mission['jumps_planned']} planned",
            mission["jumps"] >= mission["jumps_planned"],
        ),
        (f"stones     {mission['stone_height_m']:.2f} m high, {passed}", clearance > 0.0),
        (
            f"tether     tension up to {peak:.0f} N, breaking load {breaking_load:.0f} N",
            peak < breaking_load,
        ),
        (
            f"time       {mission['simulated_s']:.0f} s simulated, {pace}",
            mission["real_time_factor"] > 1.0,
        ),
        (f"bag        {bag}", bool(metrics.get("closed")) and rejected == warnings == 0),
        (f"energy     {energy}", abs(drift) <= _BALANCE * moved),
    ]


def summary(metrics: Mapping[str, Any]) -> str:
    """One sentence about the mission."""
    mission = metrics["mission"]
    how = (
        "and came back to the stow"
        if mission["home"]
        else f"and is {mission['depth_m']:.1f} m below the fairlead now, {mission['phase']}: "
        f"{mission['reason']}"
    )
    brief = (
        ""
        if mission["wall_time_s"] <= _TARGET_TIME
        else f", more than the target of {_TARGET_TIME:g} s"
    )
    return (
        f"In the Marius Hills Hole the rover went down to {mission['deepest_m']:.1f} m, took "
        f"{mission['pictures']} pictures, {how};\n"
        f"{mission['simulated_s']:.0f} s simulated, all shown in {mission['wall_time_s']:.0f} s"
        f"{brief}:"
    )
