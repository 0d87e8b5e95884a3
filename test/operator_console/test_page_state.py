"""Frames, health in one word, the journal, and what is kept of the last minutes."""

from __future__ import annotations

import itertools
import json
from typing import Any

from msg_schemas import topics
from msg_schemas.machine import PAYOUT, REFERENCE, STRETCHED, TENSION, TETHER_OUT
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    Status,
    StatusSample,
    TextSample,
)
from operator_console.page_state import History, PageState, frame, health
from operator_console.telemetry import Telemetry


def estimate(length: float, tension: float = 16.0) -> JointSample:
    return JointSample(
        0,
        {
            PAYOUT: JointValue(length, 0.1),
            STRETCHED: JointValue(length),
            TENSION: JointValue(1.0, 0.0, tension),
            TETHER_OUT: JointValue(),
            REFERENCE: JointValue(length),
        },
    )


def told(node: str, message: str, level: Level = Level.OK, what: str = "node") -> StatusSample:
    return StatusSample(0, (Status(f"{node}: {what}", message, level, node),))


class Desk:
    """Telemetry and page_state as the console feeds them."""

    def __init__(self) -> None:
        self.telemetry, self.page_state = Telemetry(), PageState()

    def hear(self, topic: str, sample: object, now: float) -> None:
        self.telemetry.hear(topic, sample, now)
        self.page_state.see(topic, sample, now, 100.0 + now)

    def frame(self, now: float) -> dict[str, Any]:
        made = frame(self.telemetry.snapshot(now), self.page_state, now, 100.0 + now)
        found = json.loads(json.dumps(made, allow_nan=False))
        assert isinstance(found, dict)
        return found


def test_values_bear_their_age_and_grow_stale():
    desk = Desk()
    assert desk.frame(0.0)["values"]["depth"] == [None, None, True]
    desk.hear(topics.WINCH_ESTIMATE, estimate(12.5), 0.0)
    assert desk.frame(0.2)["values"]["depth"] == [12.5, 0.2, False]
    assert desk.frame(4.0)["values"]["depth"] == [12.5, 4.0, True]
    assert desk.frame(4.0)["geometry"]["stale"]


def test_the_shape_falls_back_on_the_payout_when_the_truth_falls_silent():
    desk = Desk()
    body = OdometrySample(0, (0.1, 0.0, -9.0), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    desk.hear(topics.TRUTH_BODY1, body, 0.0)
    assert desk.frame(0.1)["geometry"]["source"] == "simulation"
    assert desk.frame(30.0)["geometry"]["stale"], "the last that is known, greyed"
    desk.hear(topics.WINCH_ESTIMATE, estimate(12.5), 30.0)
    shape = desk.frame(30.1)["geometry"]
    assert shape["source"] == "payout"
    assert not shape["stale"]
    assert shape["tether"][-1][2] == -12.5


def test_the_worst_part_says_how_it_is():
    desk = Desk()
    assert desk.frame(0.0)["health"]["level"] == "unknown"
    desk.hear(topics.DIAGNOSTICS, told("winch_node", "ready"), 0.0)
    desk.hear(topics.DIAGNOSTICS, told("descent_node", "ready"), 0.0)
    assert desk.frame(0.1)["health"]["level"] == "ok"
    desk.hear(topics.DIAGNOSTICS, told("winch_node", "waiting for x", Level.WARN), 0.2)
    assert desk.frame(0.3)["health"] == {
        "level": "warn", "word": "warning", "text": "winch_node: waiting for x",
    }  # fmt: skip
    desk.hear(topics.DIAGNOSTICS, told("descent_node", "lost", Level.ERROR, "descent"), 0.2)
    found = desk.frame(0.3)["health"]
    assert found["level"] == "error"
    assert "lost" in found["text"]


def test_a_node_that_falls_silent_is_not_well():
    desk = Desk()
    desk.hear(topics.DIAGNOSTICS, told("winch_node", "ready"), 0.0)
    desk.hear(topics.WINCH_MODE, TextSample("hold"), 0.0)
    assert desk.frame(1.0)["words"]["winch"][2] is False
    made = desk.frame(9.0)
    assert made["health"]["level"] == "stale"
    assert made["words"]["winch"][:3] == ["hold", 9.0, True]
    (part,) = made["parts"]
    assert part["age"] == 9.0
    assert "it said: ready" in part["text"]


def test_a_fault_is_an_error_whatever_else_is_well():
    parts = [
        {"name": "a", "level": "ok", "text": "ready"},
        {"name": "winch", "level": "error", "text": "fault"},
        {"name": "b", "level": "warn", "text": "x"},
        {"name": "c", "level": "error", "text": "y"},
    ]
    assert health(parts)["text"] == "winch: fault and 1 more"


def test_the_journal_holds_events_and_refusals_with_their_reasons():
    desk = Desk()
    event = Status("stop_ended", "at 14 m", Level.OK, "descent_node", {})
    desk.hear(topics.EVENTS, StatusSample(0, (event,)), 1.0)
    refusal = Status(
        "descent_node: refused x", "too deep", Level.WARN, "descent_node",
        {"code": "out_of_limits"},
    )  # fmt: skip
    desk.hear(topics.DIAGNOSTICS, StatusSample(0, (refusal,)), 2.0)
    desk.hear(topics.DIAGNOSTICS, told("descent_node", "ready"), 3.0)
    first, second = (entry.as_dict() for entry in desk.page_state.journal)
    assert (first["time"], first["title"], first["text"]) == (101.0, "stop_ended", "at 14 m")
    assert (second["level"], second["text"]) == ("warn", "too deep [out_of_limits]")


def test_the_past_is_thinned_and_begins_anew_when_the_clock_is_put_back():
    history = History(length=10.0, period=0.5)
    for count in range(100):
        history.add({"time": 0.1 * count, "values": {}})
    times = [made["time"] for made in history.frames()]
    assert len(times) == 20
    assert all(later - earlier > 0.49 for earlier, later in itertools.pairwise(times))
    history.add({"time": 0.0, "values": {}})
    assert [made["time"] for made in history.frames()] == [0.0]
