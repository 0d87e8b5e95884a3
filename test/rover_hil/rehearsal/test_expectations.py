"""Each expectation against what was heard: right, wrong, late, and nothing at all."""

from __future__ import annotations

from typing import Any

import pytest

from msg_schemas import topics
from msg_schemas.configuration import read
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM
from msg_schemas.samples import JointSample, JointValue, Level, Status, StatusSample, TextSample
from rover_hil.rehearsal.expectations import EXPECTATIONS
from rover_hil.rehearsal.finding import Finding, Verdict
from rover_hil.rehearsal.history import Heard, History, Window

BEGIN, END = 100.0, 103.0
LINK = "hil_bridge: link"


def ns(time: float) -> int:
    return round(time * 1e9)


class Scene:
    """A history, and a window of three seconds."""

    def __init__(self, mark: float = -1.0) -> None:
        self.history = History()
        self.window = Window(self.history, ns(BEGIN), ns(END), ns(mark) if mark >= 0 else -1)

    def hear(self, topic: str, time: float, sample: Any, age: float = 0.0) -> None:
        stamp = ns(time)
        self.history.add(topic, Heard(stamp, ns(time + age), stamp, sample))

    def drum(
        self, time: float, velocity: float = 0.0, brake: float = 0.0, age: float = 0.0
    ) -> None:
        joints = {WINCH_DRUM: JointValue(20.0, velocity), WINCH_BRAKE: JointValue(brake)}
        self.hear(topics.WINCH_STATE, time, JointSample(ns(time), joints), age)

    def drums(self, rate: float, begin: float = BEGIN, end: float = END, **values: float) -> None:
        for index in range(round((end - begin) * rate) + 1):
            self.drum(begin + index / rate, **values)

    def status(self, topic: str, time: float, name: str, message: str = "", **values: str) -> None:
        told = Status(name, message, Level.OK, name.partition(":")[0], values)
        self.hear(topic, time, StatusSample(ns(time), (told,)))

    def judge(self, kind: str, **keys: Any) -> Finding:
        (finding,) = read(EXPECTATIONS[kind], keys).judge(self.window)
        return finding

    def is_decided(self, kind: str, now: float, **keys: Any) -> bool:
        decided: bool = read(EXPECTATIONS[kind], keys).is_decided(self.window, ns(now))
        return decided


WINCH = {"topics": [topics.WINCH_STATE]}
VELOCITY = {"topic": topics.WINCH_STATE, "field": "winch_drum.velocity"}


@pytest.mark.parametrize(
    ("rate", "end", "verdict"),
    [
        (200.0, END, Verdict.PASS),
        (150.0, END, Verdict.FAIL),
        (250.0, END, Verdict.FAIL),
        (200.0, END - 1.0, Verdict.FAIL),  # it fell silent
    ],
)
def test_a_rate_is_that_of_the_whole_window(rate: float, end: float, verdict: Verdict):
    scene = Scene()
    scene.drums(rate, end=end)
    assert scene.judge("rate", **WINCH, minimum=190.0, maximum=210.0).verdict is verdict


def test_a_rate_of_nothing_fails():
    finding = Scene().judge("rate", **WINCH, maximum=10.0)
    assert finding.verdict is Verdict.FAIL
    assert finding.measured == "0 messages in 3 s"


def test_a_gap_counts_from_the_window_s_ends_too():
    scene = Scene()
    scene.drums(100.0, end=END - 0.2)
    assert scene.judge("gap", **WINCH, at_most=0.25).verdict is Verdict.PASS
    assert scene.judge("gap", **WINCH, at_most=0.1).measured == "0.2 s"
    assert Scene().judge("gap", **WINCH, at_most=10.0).verdict is Verdict.FAIL


def test_an_age_may_be_exceeded_by_the_share_that_is_said():
    scene = Scene()
    scene.drums(100.0, age=0.002)
    scene.drum(BEGIN + 1.0, age=0.3)
    assert scene.judge("age", **WINCH, at_most=0.01).verdict is Verdict.PASS
    assert scene.judge("age", **WINCH, at_most=0.01, share=1.0).measured == "300 ms"
    assert Scene().judge("age", **WINCH, at_most=0.01).verdict is Verdict.FAIL


def test_one_message_that_breaks_the_contract_is_one_too_many():
    scene = Scene()
    scene.drums(10.0)
    assert scene.judge("obeys", **WINCH).verdict is Verdict.PASS
    bad = Heard(ns(BEGIN + 1), ns(BEGIN + 1), 0, None, "winch_drum.velocity is nan")
    scene.history.add(topics.WINCH_STATE, bad)
    finding = scene.judge("obeys", **WINCH)
    assert finding.verdict is Verdict.FAIL
    assert finding.measured == "31 of 32; the first other: winch_drum.velocity is nan"
    assert Scene().judge("obeys", **WINCH).verdict is Verdict.FAIL


def test_silence_may_begin_later():
    scene = Scene()
    scene.drums(10.0, end=BEGIN + 0.5)
    assert scene.judge("silent", **WINCH, after=0.6).verdict is Verdict.PASS
    assert scene.judge("silent", **WINCH, after=0.3).verdict is Verdict.FAIL
    assert not scene.is_decided("silent", END + 0.1, **WINCH)
    assert scene.is_decided("silent", END + 0.6, **WINCH)


def test_a_value_is_reached_in_time_or_too_late():
    scene = Scene()
    scene.drums(100.0)
    scene.drum(END + 0.3, velocity=0.2)
    wanted = {**VELOCITY, "minimum": 0.1, "counts_from": "end"}
    assert scene.judge("value", **wanted, within=0.5).measured == "0.3 s"
    assert scene.judge("value", **wanted, within=0.2).verdict is Verdict.FAIL
    assert scene.is_decided("value", END, **wanted, within=0.5)


def test_a_value_that_holds_always_is_judged_when_its_time_is_over():
    scene = Scene(mark=BEGIN + 1.0)
    scene.drums(100.0)
    wanted = {**VELOCITY, "maximum": 0.0, "when": "always", "counts_from": "mark", "within": 2.5}
    assert not scene.is_decided("value", END + 9.0, **wanted)
    scene.drum(END + 0.6)
    assert scene.is_decided("value", END + 0.6, **wanted)
    assert scene.judge("value", **wanted).verdict is Verdict.PASS
    scene.drum(END + 0.4, velocity=0.01)
    assert scene.judge("value", **wanted).measured == "0 to 0.01 m/s"
    assert scene.judge("value", **wanted).verdict is Verdict.FAIL


def test_a_value_of_which_nothing_came_does_not_hold():
    wanted = {**VELOCITY, "maximum": 9.0, "when": "always"}
    assert Scene().judge("value", **wanted).verdict is Verdict.FAIL


def test_a_word_that_stands_already_counts():
    scene = Scene()
    scene.hear(topics.WINCH_MODE, BEGIN - 50.0, TextSample("hold"))
    scene.hear(topics.WINCH_MODE, BEGIN + 0.4, TextSample("stop"))
    assert scene.judge("word", topic=topics.WINCH_MODE, words="hold").measured == "0 s"
    assert scene.judge("word", topic=topics.WINCH_MODE, words=["stop", "fault"]).measured == "0.4 s"
    later = {"topic": topics.WINCH_MODE, "words": "hold", "counts_from": "end"}
    assert scene.judge("word", **later).measured == "it says 'stop'"


def test_an_event_is_told_with_its_time_also_when_it_is_late():
    scene = Scene()
    scene.status(topics.EVENTS, BEGIN - 1.0, "winch_disarmed")
    scene.status(topics.EVENTS, BEGIN + 1.25, "winch_disarmed", "it is silent", error_code="5")
    assert (
        scene.judge("event", name="winch_disarmed", within=2.0).measured == "1.25 s: it is silent"
    )
    assert scene.judge("event", name="winch_disarmed", within=1.0).verdict is Verdict.FAIL
    held = {"name": "winch_disarmed", "within": 2.0}
    assert scene.judge("event", **held, values={"error_code": 5}).verdict is Verdict.PASS
    assert scene.judge("event", **held, values={"error_code": 6}).verdict is Verdict.FAIL
    assert scene.judge("event", **held, node="jump").verdict is Verdict.FAIL


def test_what_must_not_come_is_waited_for_and_fails_when_it_comes():
    scene = Scene()
    wanted = {"name": "winch_disarmed", "absent": True, "within": 3.5}
    assert not scene.is_decided("event", END + 0.6, **wanted)
    assert scene.is_decided("event", END + 1.1, **wanted)
    assert scene.judge("event", **wanted).verdict is Verdict.PASS
    scene.status(topics.EVENTS, END + 0.6, "winch_disarmed")
    assert scene.judge("event", **wanted).verdict is Verdict.PASS
    scene.status(topics.EVENTS, END + 0.4, "winch_disarmed")
    assert scene.judge("event", **wanted).verdict is Verdict.FAIL


def test_a_refusal_is_that_of_its_subject_for_its_reason():
    scene = Scene()
    told = "hil_bridge: refused " + topics.WINCH_COMMAND
    scene.status(topics.DIAGNOSTICS, BEGIN + 0.1, told, "stamped 0.8 s ago", code="stale")
    wanted = {"subject": topics.WINCH_COMMAND, "code": "stale"}
    assert scene.judge("refused", **wanted).verdict is Verdict.PASS
    assert scene.judge("refused", **wanted, mentions="0.8 s").verdict is Verdict.PASS
    assert scene.judge("refused", **wanted, mentions="0.9 s").verdict is Verdict.FAIL
    other = {"subject": topics.WINCH_COMMAND, "code": "not_armed"}
    assert scene.judge("refused", **other).verdict is Verdict.FAIL
    assert scene.judge("refused", **wanted, absent=True).verdict is Verdict.FAIL


def test_a_figure_is_taken_from_the_first_report_after_the_actions():
    scene = Scene()
    for time, lost in ((BEGIN - 0.2, "3"), (BEGIN + 0.8, "9"), (END + 0.3, "12")):
        scene.status(topics.LINK_STATUS, time, LINK, "all devices answer", lost=lost)
    wanted = {"status": LINK, "key": "lost"}
    assert scene.judge("figure", **wanted, maximum=12.0).verdict is Verdict.PASS
    assert scene.judge("figure", **wanted, maximum=11.0).measured == "12"
    assert scene.judge("figure", **wanted, measure="change", maximum=8.0).measured == "9"
    reached = {**wanted, "measure": "reached", "minimum": 9.0}
    assert scene.judge("figure", **reached, within=1.0).measured == "0.8 s"
    assert scene.judge("figure", **reached, within=0.5).verdict is Verdict.FAIL
    assert scene.judge("figure", status=LINK, equals="all devices answer").verdict is Verdict.PASS
    assert scene.judge("figure", status=LINK, equals="none answers").verdict is Verdict.FAIL
    assert scene.judge("figure", status=LINK, key="no", maximum=1.0).verdict is Verdict.FAIL


def test_without_a_report_after_the_actions_a_figure_is_awaited_and_at_last_fails():
    scene = Scene()
    scene.status(topics.LINK_STATUS, END - 0.1, LINK, lost="0")
    wanted = {"status": LINK, "key": "lost", "maximum": 0.0}
    assert not scene.is_decided("figure", END + 9.0, **wanted)
    assert scene.judge("figure", **wanted).verdict is Verdict.FAIL
