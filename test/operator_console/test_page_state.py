"""Frames, overall health, journal and history."""

from __future__ import annotations

import itertools
import json
from typing import Any

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent
from msg_schemas.health import Health
from msg_schemas.phases import HealthState, WinchMode
from msg_schemas.refusal import RefusalCode, RefusalReport
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    Status,
    StatusSample,
    TextSample,
)
from operator_console.page_state import PageState, ValueHistory, frame, health
from operator_console.telemetry import Telemetry


def estimate(length: float, tension: float = 16.0) -> JointSample:
    return JointSample(
        0,
        {
            machine.PAYOUT: JointValue(length, 0.1),
            machine.STRETCHED: JointValue(length),
            machine.TENSION: JointValue(1.0, 0.0, tension),
            machine.TETHER_OUT: JointValue(),
            machine.REFERENCE: JointValue(length),
        },
    )


def report(node: str, message: str, level: Level, what: str) -> StatusSample:
    return StatusSample(0, (Status(f"{node}: {what}", message, level, node),))


def health_of(node: str, *missing: str) -> StatusSample:
    state = HealthState.WAITING if missing else HealthState.READY
    return StatusSample(0, (Health(node, state, missing).status({}),))


class Console:
    """Telemetry and page state as the console node uses them."""

    def __init__(self) -> None:
        self.telemetry, self.page_state = Telemetry(), PageState()

    def on_sample(self, topic: str, sample: object, now: float) -> None:
        self.telemetry.on_sample(topic, sample, now)
        self.page_state.on_sample(topic, sample, now, 100.0 + now)

    def frame(self, now: float) -> dict[str, Any]:
        made = frame(self.telemetry.snapshot(now), self.page_state, now, 100.0 + now)
        found = json.loads(json.dumps(made, allow_nan=False))
        assert isinstance(found, dict)
        return found


def test_values_have_an_age_and_become_stale():
    console = Console()
    assert console.frame(0.0)["values"]["depth"] == [None, None, True]
    console.on_sample(topics.WINCH_ESTIMATE, estimate(12.5), 0.0)
    assert console.frame(0.2)["values"]["depth"] == [12.5, 0.2, False]
    assert console.frame(4.0)["values"]["depth"] == [12.5, 4.0, True]
    assert console.frame(4.0)["geometry"]["stale"]


def test_geometry_falls_back_to_the_payout_when_the_truth_is_missing():
    console = Console()
    body = OdometrySample(0, (0.1, 0.0, -9.0), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    console.on_sample(topics.TRUTH_BODY1, body, 0.0)
    assert console.frame(0.1)["geometry"]["source"] == "simulation"
    assert console.frame(30.0)["geometry"]["stale"], "the last known geometry is stale"
    console.on_sample(topics.WINCH_ESTIMATE, estimate(12.5), 30.0)
    shape = console.frame(30.1)["geometry"]
    assert shape["source"] == "payout"
    assert not shape["stale"]
    assert shape["tether"][-1][2] == -12.5


def test_the_worst_part_sets_the_overall_health():
    console = Console()
    assert console.frame(0.0)["health"]["level"] == "unknown"
    console.on_sample(topics.DIAGNOSTICS, health_of("winch_node"), 0.0)
    console.on_sample(topics.DIAGNOSTICS, health_of("descent_node"), 0.0)
    assert console.frame(0.1)["health"]["title"] == "no plant"
    console.on_sample(
        topics.WINCH_STATE, JointSample(0, {machine.WINCH_DRUM: JointValue(10.0)}), 0.1
    )
    assert console.frame(0.1)["health"]["level"] == "ok"
    console.on_sample(topics.DIAGNOSTICS, health_of("winch_node", "x"), 0.2)
    assert console.frame(0.3)["health"] == {
        "level": "warn", "title": "warning", "text": "winch_node: waiting for x",
    }  # fmt: skip
    console.on_sample(
        topics.DIAGNOSTICS, report("descent_node", "lost", Level.ERROR, "descent"), 0.2
    )
    found = console.frame(0.3)["health"]
    assert found["level"] == "error"
    assert "lost" in found["text"]


def test_a_silent_node_makes_the_health_stale():
    console = Console()
    console.on_sample(topics.DIAGNOSTICS, health_of("winch_node"), 0.0)
    console.on_sample(topics.WINCH_MODE, TextSample(WinchMode.HOLD), 0.0)
    assert console.frame(1.0)["phases"]["winch"][2] is False
    made = console.frame(9.0)
    assert made["health"]["level"] == "stale"
    assert made["phases"]["winch"][:3] == ["hold", 9.0, True]
    (part,) = made["parts"]
    assert "silent for 9 s" in part["text"]
    assert "last report: ready" in part["text"]


def test_a_fault_outranks_warnings():
    parts = [
        {"name": "a", "level": "ok", "text": "ready"},
        {"name": "winch", "level": "error", "text": "fault"},
        {"name": "b", "level": "warn", "text": "x"},
        {"name": "c", "level": "error", "text": "y"},
    ]
    assert health(parts, has_plant=False)["text"] == "winch: fault and 1 more"


def test_the_journal_holds_events_and_refusals_with_their_reasons():
    console = Console()
    event = Status(DescentEvent.STOP_COMPLETED, "at 14 m", Level.OK, "descent_node", {})
    console.on_sample(topics.EVENTS, StatusSample(0, (event,)), 1.0)
    refusal = RefusalReport("descent_node", "x", RefusalCode.OUT_OF_LIMITS, "too deep").status()
    console.on_sample(topics.DIAGNOSTICS, StatusSample(0, (refusal,)), 2.0)
    console.on_sample(topics.DIAGNOSTICS, health_of("descent_node"), 3.0)
    first, second = (entry.as_dict() for entry in console.page_state.journal)
    assert (first["time"], first["text"]) == (101.0, "at 14 m")
    assert first["title"] == DescentEvent.STOP_COMPLETED
    assert (second["level"], second["text"]) == ("warn", "too deep [out_of_limits]")


def test_history_is_thinned_and_restarts_with_the_clock():
    history = ValueHistory(length=10.0, period=0.5)
    for count in range(100):
        history.add({"time": 0.1 * count, "values": {}})
    times = [made["time"] for made in history.frames()]
    assert len(times) == 20
    assert all(later - earlier > 0.49 for earlier, later in itertools.pairwise(times))
    history.add({"time": 0.0, "values": {}})
    assert [made["time"] for made in history.frames()] == [0.0]
