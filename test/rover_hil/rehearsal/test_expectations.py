"""Each expectation against received messages: in range, out of range, late, none."""

from __future__ import annotations

from typing import Any

import pytest

from msg_schemas import machine, topics
from msg_schemas.configuration import read
from msg_schemas.events import BridgeEvent
from msg_schemas.refusal import RefusalCode, RefusalReport
from msg_schemas.samples import JointSample, JointValue, Level, Status, StatusSample, TextSample
from rover_hil.rehearsal.expectation_result import ExpectationResult, Result
from rover_hil.rehearsal.expectations import EXPECTATIONS
from rover_hil.rehearsal.message_history import EvaluationWindow, MessageHistory, ReceivedMessage

BEGIN, END = 100.0, 103.0
LINK = "hil_bridge: link"


def ns(time: float) -> int:
    return round(time * 1e9)


class Scene:
    """A history, and a window of three seconds."""

    def __init__(self, mark: float = -1.0) -> None:
        self.history = MessageHistory()
        self.window = EvaluationWindow(
            self.history, ns(BEGIN), ns(END), ns(mark) if mark >= 0 else -1
        )

    def receive(self, topic: str, time: float, sample: Any, age: float = 0.0) -> None:
        stamp = ns(time)
        self.history.add(topic, ReceivedMessage(stamp, ns(time + age), stamp, sample))

    def drum(
        self, time: float, velocity: float = 0.0, brake: float = 0.0, age: float = 0.0
    ) -> None:
        joints = {
            machine.WINCH_DRUM: JointValue(20.0, velocity),
            machine.WINCH_BRAKE: JointValue(brake),
        }
        self.receive(topics.WINCH_STATE, time, JointSample(ns(time), joints), age)

    def drums(self, rate: float, begin: float = BEGIN, end: float = END, **values: float) -> None:
        for index in range(round((end - begin) * rate) + 1):
            self.drum(begin + index / rate, **values)

    def status(self, topic: str, time: float, name: str, message: str = "", **values: str) -> None:
        status = Status(name, message, Level.OK, name.partition(":")[0], values)
        self.receive(topic, time, StatusSample(ns(time), (status,)))

    def refuse(self, time: float, subject: str, code: RefusalCode, reason: str) -> None:
        status = RefusalReport("hil_bridge", subject, code, reason).status()
        self.receive(topics.DIAGNOSTICS, time, StatusSample(ns(time), (status,)))

    def evaluate(self, kind: str, **keys: Any) -> ExpectationResult:
        (result,) = read(EXPECTATIONS[kind], keys).evaluate(self.window)
        return result

    def is_decided(self, kind: str, now: float, **keys: Any) -> bool:
        decided: bool = read(EXPECTATIONS[kind], keys).is_decided(self.window, ns(now))
        return decided


WINCH = {"topics": [topics.WINCH_STATE]}
VELOCITY = {"topic": topics.WINCH_STATE, "field": "winch_drum.velocity"}


@pytest.mark.parametrize(
    ("rate", "end", "result"),
    [
        (200.0, END, Result.PASS),
        (150.0, END, Result.FAIL),
        (250.0, END, Result.FAIL),
        (200.0, END - 1.0, Result.FAIL),  # it stopped
    ],
)
def test_a_rate_covers_the_whole_window(rate: float, end: float, result: Result):
    scene = Scene()
    scene.drums(rate, end=end)
    assert scene.evaluate("rate", **WINCH, minimum=190.0, maximum=210.0).result is result


def test_a_rate_without_messages_fails():
    result = Scene().evaluate("rate", **WINCH, maximum=10.0)
    assert result.result is Result.FAIL
    assert result.measured == "0 messages in 3 s"


def test_a_gap_includes_the_ends_of_the_window():
    scene = Scene()
    scene.drums(100.0, end=END - 0.2)
    assert scene.evaluate("gap", **WINCH, maximum=0.25).result is Result.PASS
    assert scene.evaluate("gap", **WINCH, maximum=0.1).measured == "0.2 s"
    assert Scene().evaluate("gap", **WINCH, maximum=10.0).result is Result.FAIL


def test_an_age_is_tested_at_its_quantile():
    scene = Scene()
    scene.drums(100.0, age=0.002)
    scene.drum(BEGIN + 1.0, age=0.3)
    assert scene.evaluate("age", **WINCH, maximum=0.01).result is Result.PASS
    assert scene.evaluate("age", **WINCH, maximum=0.01, quantile=1.0).measured == "300 ms"
    assert Scene().evaluate("age", **WINCH, maximum=0.01).result is Result.FAIL


def test_one_invalid_message_fails():
    scene = Scene()
    scene.drums(10.0)
    assert scene.evaluate("conforms", **WINCH).result is Result.PASS
    bad = ReceivedMessage(ns(BEGIN + 1), ns(BEGIN + 1), 0, None, "winch_drum.velocity is nan")
    scene.history.add(topics.WINCH_STATE, bad)
    result = scene.evaluate("conforms", **WINCH)
    assert result.result is Result.FAIL
    assert result.measured == "31 of 32; first violation: winch_drum.velocity is nan"
    assert Scene().evaluate("conforms", **WINCH).result is Result.FAIL


def test_messages_may_be_allowed_at_the_beginning():
    scene = Scene()
    scene.drums(10.0, end=BEGIN + 0.5)
    assert scene.evaluate("no_messages", **WINCH, after=0.6).result is Result.PASS
    assert scene.evaluate("no_messages", **WINCH, after=0.3).result is Result.FAIL
    assert not scene.is_decided("no_messages", END + 0.1, **WINCH)
    assert scene.is_decided("no_messages", END + 0.6, **WINCH)


def test_a_value_is_reached_in_time_or_late():
    scene = Scene()
    scene.drums(100.0)
    scene.drum(END + 0.3, velocity=0.2)
    keys = {**VELOCITY, "minimum": 0.1, "since": "end"}
    assert scene.evaluate("value", **keys, within=0.5).measured == "0.3 s"
    assert scene.evaluate("value", **keys, within=0.2).result is Result.FAIL
    assert scene.is_decided("value", END, **keys, within=0.5)


def test_a_value_to_be_kept_is_evaluated_after_its_time():
    scene = Scene(mark=BEGIN + 1.0)
    scene.drums(100.0)
    keys = {**VELOCITY, "maximum": 0.0, "when": "always", "since": "mark", "within": 2.5}
    assert not scene.is_decided("value", END + 9.0, **keys)
    scene.drum(END + 0.6)
    assert scene.is_decided("value", END + 0.6, **keys)
    assert scene.evaluate("value", **keys).result is Result.PASS
    scene.drum(END + 0.4, velocity=0.01)
    assert scene.evaluate("value", **keys).measured == "0 to 0.01 m/s"
    assert scene.evaluate("value", **keys).result is Result.FAIL


def test_a_value_without_messages_fails():
    keys = {**VELOCITY, "maximum": 9.0, "when": "always"}
    assert Scene().evaluate("value", **keys).result is Result.FAIL


def test_a_text_that_is_published_already_counts():
    scene = Scene()
    scene.receive(topics.WINCH_MODE, BEGIN - 50.0, TextSample("hold"))
    scene.receive(topics.WINCH_MODE, BEGIN + 0.4, TextSample("stop"))
    assert scene.evaluate("text", topic=topics.WINCH_MODE, one_of="hold").measured == "0 s"
    assert (
        scene.evaluate("text", topic=topics.WINCH_MODE, one_of=["stop", "fault"]).measured
        == "0.4 s"
    )
    later = {"topic": topics.WINCH_MODE, "one_of": "hold", "since": "end"}
    assert scene.evaluate("text", **later).measured == "it is 'stop'"


def test_an_event_is_reported_with_its_time_also_when_late():
    scene = Scene()
    scene.status(topics.EVENTS, BEGIN - 1.0, BridgeEvent.TRIPPED)
    scene.status(topics.EVENTS, BEGIN + 1.25, BridgeEvent.TRIPPED, "it is silent", device="5")
    assert (
        scene.evaluate("event", name=BridgeEvent.TRIPPED, within=2.0).measured
        == "1.25 s: it is silent"
    )
    assert scene.evaluate("event", name=BridgeEvent.TRIPPED, within=1.0).result is Result.FAIL
    keys = {"name": BridgeEvent.TRIPPED, "within": 2.0}
    assert scene.evaluate("event", **keys, values={"device": 5}).result is Result.PASS
    assert scene.evaluate("event", **keys, values={"device": 6}).result is Result.FAIL
    assert scene.evaluate("event", **keys, node="jump").result is Result.FAIL


def test_an_event_that_must_be_absent_is_awaited_and_fails_if_it_occurs():
    scene = Scene()
    keys = {"name": BridgeEvent.TRIPPED, "absent": True, "within": 3.5}
    assert not scene.is_decided("event", END + 0.6, **keys)
    assert scene.is_decided("event", END + 1.1, **keys)
    assert scene.evaluate("event", **keys).result is Result.PASS
    scene.status(topics.EVENTS, END + 0.6, BridgeEvent.TRIPPED)
    assert scene.evaluate("event", **keys).result is Result.PASS
    scene.status(topics.EVENTS, END + 0.4, BridgeEvent.TRIPPED)
    assert scene.evaluate("event", **keys).result is Result.FAIL


def test_a_refusal_matches_subject_and_reason():
    scene = Scene()
    scene.refuse(BEGIN + 0.1, topics.WINCH_COMMAND, RefusalCode.STALE, "stamped 0.8 s ago")
    keys = {"subject": topics.WINCH_COMMAND, "code": "stale"}
    assert scene.evaluate("refusal", **keys).result is Result.PASS
    other = {"subject": topics.WINCH_COMMAND, "code": "not_armed"}
    assert scene.evaluate("refusal", **other).result is Result.FAIL
    assert scene.evaluate("refusal", **keys, absent=True).result is Result.FAIL


def test_a_metric_is_taken_from_the_first_report_after_the_actions():
    scene = Scene()
    for time, lost in ((BEGIN - 0.2, "3"), (BEGIN + 0.8, "9"), (END + 0.3, "12")):
        scene.status(topics.LINK_STATUS, time, LINK, "all devices answer", lost=lost)
    keys = {"status": LINK, "key": "lost"}
    assert scene.evaluate("metric", **keys, maximum=12.0).result is Result.PASS
    assert scene.evaluate("metric", **keys, maximum=11.0).measured == "12"
    assert scene.evaluate("metric", **keys, measure="change", maximum=8.0).measured == "9"
    reached = {**keys, "measure": "reached", "minimum": 9.0}
    assert scene.evaluate("metric", **reached, within=1.0).measured == "0.8 s"
    assert scene.evaluate("metric", **reached, within=0.5).result is Result.FAIL
    assert scene.evaluate("metric", **keys, equals="12").result is Result.PASS
    assert scene.evaluate("metric", **keys, equals="9").result is Result.FAIL
    assert scene.evaluate("metric", status=LINK, key="no", maximum=1.0).result is Result.FAIL


def test_without_a_report_after_the_actions_a_metric_is_awaited_and_fails():
    scene = Scene()
    scene.status(topics.LINK_STATUS, END - 0.1, LINK, lost="0")
    keys = {"status": LINK, "key": "lost", "maximum": 0.0}
    assert not scene.is_decided("metric", END + 9.0, **keys)
    assert scene.evaluate("metric", **keys).result is Result.FAIL
