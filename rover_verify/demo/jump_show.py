"""Demonstration of a tethered jump over DDS, compared with an independent code.

Simulator, jump controller, winch controller and recorder run as four processes in lockstep, in a
ROS domain of their own. This process is the operator: it requests a jump, waits for the landing,
stops the processes, creates the report, and compares height and attitude with another code's result
for the same jump.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msg_schemas import machine, topics
from msg_schemas.events import JumpEvent
from msg_schemas.phases import JumpPhase
from msg_schemas.refusal import read_refusal
from msg_schemas.samples import JointSample, JointValue
from rover_launch.plan import FALSE
from rover_verify.demo.show import Show, ShowError, completed, write_report
from rover_verify.harness import open_harness
from rover_verify.harness.launching import Launched, missing_streams

SCENARIO = "paper_table1_high"
OVERRIDES = {"start.geometry": "+K", "start.slack": 2.0, "tether.elements": 20}
STROKE, NUT_SPEED = 0.2, 0.1


@dataclass(frozen=True)
class Reference:
    """Metric of this jump from an independent code, and its tolerance."""

    key: str
    label: str
    value: float
    tolerance: float
    unit: str


# Exudyn 1.13 with Green's strain, 20 elements: the source study's Table 1 with 0.5 GPa, rover above
# the start (+K), slack 2. Its values have four digits.
REFERENCES = (
    Reference("jump_height_m", "jump height", 0.3084, 5e-4, "m"),
    Reference("attitude_variation_rad", "attitude variation", 0.6615, 2e-3, "rad"),
)
# The jump's energy is k delta^2 / 2 = 16.48 J.
MAX_ENERGY_DRIFT = 1e-5

MAX_LOSS = 0.10

# On a cold cache the simulator compiles before it is ready.
_READY_TIMEOUT = 170.0
_JUMP_TIMEOUT = 60.0
_CONTROLLERS = ("jump_node", "winch_node")
_ENDS = (
    JumpEvent.STANDBY, JumpEvent.FAULT, JumpEvent.ABORTED, JumpEvent.CANCELLED, JumpEvent.FAILED,
)  # fmt: skip


def _missing(show: Show, bag: Path) -> str:
    """What a jump still waits for: nodes, recorded streams, a standing rover; empty = ready."""
    contact, phase = show.last(topics.CONTACT), show.last(topics.JUMP_PHASE)
    stands = contact is not None and contact.joints[machine.FLOOR_SWITCH].position == 1.0
    waiting = show.not_ready() or [f"{name} in the bag" for name in missing_streams(bag)]
    if not (waiting or (stands and phase is not None and phase.text == JumpPhase.STANDBY)):
        waiting = ["the rover to stand"]
    return ", ".join(waiting)


def _jump(show: Show) -> None:
    """Request a jump as an operator does, and follow it until the landing.

    Raises:
        ShowError: it is refused, let down, or ends in a fault.
    """
    observer = show.observer
    since = len(observer.listen(topics.EVENTS))
    request = JointSample(0, {machine.JUMP_STROKE: JointValue(STROKE, NUT_SPEED, 0.0)})
    observer.send(topics.JUMP_REQUEST, request)

    def is_over() -> bool:
        ends = observer.events(*_ENDS, since=since)
        reasons = [each.message for each in ends if each.name != JumpEvent.STANDBY]
        reasons += [
            refusal.reason
            for sample in observer.listen(topics.DIAGNOSTICS).samples
            for status in sample.statuses
            if (refusal := read_refusal(status)) is not None
            and refusal.subject == topics.JUMP_REQUEST
        ]
        if reasons:
            raise ShowError(f"no jump: {'; '.join(reasons)}")
        return bool(ends)

    def status() -> str:
        phase = show.last(topics.JUMP_PHASE)
        return "" if phase is None else str(phase.text)

    show.follow("jumping", is_over, status, _JUMP_TIMEOUT)


def judge(metrics: Mapping[str, Any]) -> list[tuple[str, bool]]:
    """Compare each metric; returns lines of text and whether they pass."""
    lines: list[tuple[str, bool]] = []
    for reference in REFERENCES:
        value = metrics.get(reference.key)
        if not isinstance(value, int | float):
            lines.append((f"{reference.label}: not in the report", False))
            continue
        difference = value - reference.value
        text = (
            f"{reference.label} {value:+.4f} {reference.unit}, independent code "
            f"{reference.value:+.4f}: difference {difference:+.1e}, allowed {reference.tolerance:g}"
        )
        lines.append((text, abs(difference) <= reference.tolerance))
    drift = metrics.get("energy_drift_J")
    if not isinstance(drift, int | float):
        lines.append(("energy drift: not in the report", False))
    else:
        text = f"energy drift {drift:+.1e} J, allowed {MAX_ENERGY_DRIFT:g}"
        lines.append((text, abs(drift) <= MAX_ENERGY_DRIFT))
    jumps = len(metrics.get("jumps", []))
    lines.append((f"jumps in the bag {jumps}, 1 requested", jumps == 1))
    closed = bool(metrics.get("closed"))
    lines.append((f"bag {'closed' if closed else 'NOT closed'} by its recorder", closed))
    streams = metrics.get("topics", {}).values()
    for key, what, allowed in (
        ("rejected", "messages that break the contract", 0.0),
        ("dropped", "messages dropped by the recorder", 0.0),
        # A busy machine may lose some messages.
        ("lost_in_transport", "messages lost in transit", MAX_LOSS),
    ):
        count = sum(item[key] for item in streams)
        total = sum(item["count"] for item in streams)
        text = f"{count} of {count + total} {what}, allowed {allowed:.0%}"
        lines.append((f"recording {text}", count <= allowed * (count + total)))
    return lines


def show_jump(folder: Path, factor: float, *, quiet: bool = False) -> dict[str, Any]:
    """Run the demonstration in an existing folder; returns the metrics including the verdict.

    Raises:
        ShowError: a step failed.
        AssertionError: a process failed.
    """
    began = time.monotonic()
    with ExitStack() as closing:
        harness = closing.enter_context(open_harness(folder))
        bar = closing.enter_context(
            tqdm(disable=quiet, dynamic_ncols=True, leave=False, bar_format="{desc} {postfix}")
        )
        given = {
            "scenario": SCENARIO, "overrides": json.dumps(OVERRIDES), "frames": FALSE,
            "real_time_factor": str(factor), "record": "bag",
        }  # fmt: skip
        show = Show(Launched(harness, _CONTROLLERS, given, defaults={}), bar)
        for name in (topics.CONTACT, topics.JUMP_PHASE, topics.CLOCK):
            show.observer.listen(name)

        def missing() -> str:
            return _missing(show, folder / "bag")

        show.follow("waiting for", lambda: not missing(), missing, _READY_TIMEOUT)
        ready = time.monotonic() - began
        _jump(show)
        show.stop()
        bar.set_description_str("reporting")
        metrics = write_report(folder, harness.domain)
    return completed(
        folder,
        metrics,
        judge(metrics),
        scenario=SCENARIO,
        overrides=OVERRIDES,
        real_time_factor=factor,
        ros_domain_id=harness.domain,
        ready_after_s=ready,
        wall_time_s=time.monotonic() - began,
        reference={r.key: {"value": r.value, "tolerance": r.tolerance} for r in REFERENCES},
    )


def summary(metrics: Mapping[str, Any]) -> str:
    """One sentence about the demonstration."""
    return (
        f"A jump of {STROKE:g} m stroke on a tether of 5 m, commanded by a message, simulated,\n"
        f"recorded and reported by separate processes in {metrics['wall_time_s']:.0f} s:"
    )
