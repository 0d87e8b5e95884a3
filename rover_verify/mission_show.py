"""Demonstration of a whole mission in the Marius Hills Hole.

The plant and all controllers, as the launch file ``mission`` starts them, run on the loop host. The
messages are recorded as over DDS, and the suite's command creates the report.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from rover_control.mission_legs import LegResult
from rover_control.mission_route import LegKind
from rover_launch.plan import HANGING_DEFAULTS
from rover_verify.flight import MISSION, Flight
from rover_verify.show import write_report
from rover_verify.tape import Tape

SCENARIO, PLAN = "marius_hills", "demonstration"
OVERRIDES: Mapping[str, object] = {"tether.length": 2.0}
LIMIT = 2400.0
"""Time limit of the mission [s]; a longer mission is shown up to here."""
_TARGET_TIME = 180.0  # wall time that the demonstration should take [s]
_UPDATE_TICKS = 50  # ticks
_BALANCE = 1e-4  # allowed error of the energy balance, as a fraction of the energy of the descent
_STOWED = 0.2  # tolerance of the length at the stow [m]


def show_mission(folder: Path, *, seed: int = 1, quiet: bool = False) -> dict[str, Any]:
    """Run the mission in an existing folder; returns the metrics including the verdict.

    Args:
        folder: for bag and report.
        seed: of the sensor errors.
        quiet: no progress bar.

    Raises:
        ShowError: a step failed.
    """
    began = time.monotonic()
    with tqdm(
        total=1, disable=quiet, dynamic_ncols=True, leave=False,
        bar_format="{desc} |{bar:20}| {postfix}",
    ) as bar:  # fmt: skip
        bar.set_description_str("loading the simulator")
        tape = Tape(folder / "bag")
        try:
            settings = {"mission_node": {"plan": PLAN, "checkpoint": "none"}}
            flight = Flight(
                MISSION, SCENARIO, OVERRIDES, seed=seed, parameters=settings, listener=tape.write
            )
            ready = time.monotonic() - began
            failure = _fly(flight, bar)
        finally:
            tape.close()
        flown = time.monotonic() - began - ready
        bar.set_description_str("reporting")
        bar.set_postfix_str("")
        write_report(folder, 0)
    path = folder / "metrics.json"
    metrics: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    mission = {
        **outcome(flight, failure),
        "ready_after_s": ready,
        "flown_in_s": flown,
        "real_time_factor": flight.time / flown,
        "wall_time_s": time.monotonic() - began,
    }
    verdict = judge(mission, metrics)
    metrics |= {
        "bag": "bag",
        "scenario": SCENARIO,
        "overrides": json.loads(HANGING_DEFAULTS["overrides"]) | dict(OVERRIDES),
        "seed": seed,
        "mission": mission,
        "wall_time_s": mission["wall_time_s"],
        "verdict": [{"text": text, "pass": holds} for text, holds in verdict],
        "pass": all(holds for _, holds in verdict),
    }
    path.write_text(json.dumps(metrics, indent=2) + "\n", encoding="utf-8")
    return metrics


def _fly(flight: Flight, bar: Any) -> str:
    """Run until the mission ends; returns why it could not continue, empty = no failure."""
    began = time.monotonic()
    mission = flight.mission

    def is_over() -> bool:
        if flight.host.ticks % _UPDATE_TICKS == 0:
            bar.total = len(mission.route.legs)
            bar.n = mission.route.number - 1 if mission.is_active else bar.total
            factor = flight.time / max(time.monotonic() - began, 1e-3)
            depth = -float(flight.state.G1[2])
            bar.set_description_str(f"{mission.phase.value:11}", refresh=False)
            bar.set_postfix_str(
                f"{depth:5.1f} m deep, {flight.time:5.0f} s simulated, "
                f"{factor:.1f} times as fast as real time"
            )
        return not mission.is_active

    try:
        flight.run(1.0)
        flight.go()
        is_finished = flight.run(LIMIT, is_over)
    except RuntimeError as error:
        return str(error)
    return "" if is_finished else f"not finished after {LIMIT:g} s"


def outcome(flight: Flight, failure: str) -> dict[str, Any]:
    """Metrics of a mission.

    Args:
        flight: the finished flight.
        failure: why it could not continue; empty = no failure.
    """
    mission, state = flight.mission, flight.state
    done = [each.leg for each in mission.record if each.result is LegResult.DONE]
    missed = {e.leg: e.reason for e in mission.record if e.result is not LegResult.DONE}
    scenario = flight.plant.scenario
    weight = scenario.tip_mass * scenario.gravity
    stow = mission.plan.stow
    is_at_stow = abs(state.length - stow) < _STOWED and -float(state.G1[2]) < stow + 1.0
    return {
        "plan": PLAN,
        "legs_done": done,
        "legs_missed": missed,
        "phase": mission.phase.value,
        "reason": failure or mission.reason,
        "home": is_at_stow and not mission.is_active and not failure,
        "depth_m": -float(state.G1[2]),
        "deepest_m": flight.max_depth,
        "pictures": mission.blackboard.pictures,
        "jumps": mission.blackboard.jumps,
        "jumps_planned": sum(leg.kind is LegKind.JUMP for leg in mission.route.legs),
        "peak_tension_N": flight.peak_tension,
        "breaking_load_N": scenario.tether.section.breaking_load,
        "energy_J": weight * flight.max_depth,
        "simulated_s": flight.time,
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
    bag = f"{'closed' if metrics.get('closed') else 'NOT closed'}, {rejected} messages"
    return [
        (f"rover      {home}", bool(mission["home"])),
        (f"legs       {legs}{f', not done: {skipped}' if skipped else ''}", not missed),
        (f"pictures   {mission['pictures']} of the wall", mission["pictures"] > 0),
        (
            f"jumps      {mission['jumps']} flown, {mission['jumps_planned']} planned",
            mission["jumps"] >= mission["jumps_planned"],
        ),
        (
            f"tether     tension up to {peak:.0f} N, breaking load {breaking_load:.0f} N",
            peak < breaking_load,
        ),
        (
            f"time       {mission['simulated_s']:.0f} s simulated, {pace}",
            mission["real_time_factor"] > 1.0,
        ),
        (f"bag        {bag} break the contract", bool(metrics.get("closed")) and rejected == 0),
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
        f"{mission['pictures']} pictures, jumped {mission['jumps']} times, {how};\n"
        f"{mission['simulated_s']:.0f} s simulated, all shown in {mission['wall_time_s']:.0f} s"
        f"{brief}:"
    )
