"""Few refusals are reported at once; of a flood the last one is reported too."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level
from rover_runtime.refusal_log import SHOWN_PER_PERIOD, RefusalLog


def refusal(number: int, subject: str = topics.JUMP_REQUEST) -> Refusal:
    return Refusal(subject, RefusalCode.STALE, f"reason {number}")


def test_few_refusals_are_reported_at_once_with_their_count():
    log = RefusalLog("node")
    reported = [log.take(refusal(number)) for number in range(SHOWN_PER_PERIOD)]
    assert [status.message for status in reported if status] == [
        f"reason {number}" for number in range(SHOWN_PER_PERIOD)
    ]
    last = reported[-1]
    assert last is not None
    assert last.name == f"node: refused {topics.JUMP_REQUEST}"
    assert last.level is Level.WARN
    assert last.values == {
        "subject": topics.JUMP_REQUEST,
        "code": "stale",
        "refused": str(SHOWN_PER_PERIOD),
        "not_shown": "0",
    }
    assert log.end_period() == ()


def test_the_last_refusal_of_a_flood_is_reported_when_the_period_ends():
    log = RefusalLog("node")
    reported = [log.take(refusal(number)) for number in range(SHOWN_PER_PERIOD + 7)]
    assert sum(status is not None for status in reported) == SHOWN_PER_PERIOD
    (summary,) = log.end_period()
    assert "7 more" in summary.message
    assert f"reason {SHOWN_PER_PERIOD + 6}" in summary.message
    assert summary.values["code"] == "stale"
    assert summary.values["not_shown"] == "6"
    assert summary.values["refused"] == str(SHOWN_PER_PERIOD + 7) == str(log.refused)


def test_a_flood_on_one_topic_hides_nothing_of_another():
    log = RefusalLog("node")
    for number in range(SHOWN_PER_PERIOD + 1):
        log.take(refusal(number))
    status = log.take(refusal(0, topics.WINCH_COMMAND))
    assert status is not None
    assert status.values["refused"] == "1"
    (summary,) = log.end_period()
    assert summary.name.endswith(topics.JUMP_REQUEST)


def test_a_new_period_reports_again_and_continues_the_count():
    log = RefusalLog("node")
    for number in range(2 * SHOWN_PER_PERIOD):
        log.take(refusal(number))
    log.end_period()
    assert log.end_period() == ()
    status = log.take(refusal(0))
    assert status is not None
    assert status.values["refused"] == str(2 * SHOWN_PER_PERIOD + 1)
