"""An answer is recognised as one's own, and the end of what was asked for as that."""

from collections.abc import Mapping
from typing import Any

import pytest

from msg_schemas import topics
from msg_schemas.refusal import REQUEST_ACCEPTED, Refusal, RefusalCode
from msg_schemas.refusal_log import RefusalLog
from msg_schemas.samples import Level, Status, StatusSample
from operator_console.commands import COMMANDS
from operator_console.exchange import Exchange, Outcome, Verdict, answer_of, joined

ME = "rover#1"


def asked(name: str, **values: object) -> Exchange:
    return Exchange(COMMANDS[name].order(values), ME)


def event(
    exchange: Exchange,
    name: str,
    message: str = "",
    level: Level = Level.OK,
    node: str = "",
    **values: Any,
) -> None:
    texts = {key: str(value) for key, value in values.items()}
    status = Status(name, message, level, node or exchange.request.taker, texts)
    exchange.hear(topics.EVENTS, StatusSample(1, (status,)))


def accept(exchange: Exchange, commander: str = ME) -> None:
    event(exchange, REQUEST_ACCEPTED, commander=commander)


def refuse(exchange: Exchange, commander: str, node: str = "") -> None:
    refusal = Refusal(exchange.request.topic, RefusalCode.WRONG_PHASE, "not now")
    refusal.commander = commander
    status = RefusalLog(node or exchange.request.taker).take(refusal)
    assert status is not None
    exchange.hear(topics.DIAGNOSTICS, StatusSample(1, (status,)))


def ended(exchange: Exchange) -> tuple[bool, str]:
    assert exchange.ending is not None
    return exchange.ending.is_done, exchange.ending.reason


def test_an_acceptance_is_one_s_own():
    exchange = asked("payout", length=12.0)
    accept(exchange, "rover#2")
    assert exchange.outcome is None
    accept(exchange)
    assert exchange.outcome is not None
    assert exchange.outcome.is_accepted


def test_a_refusal_is_one_s_own_and_bears_code_and_reason():
    exchange = asked("payout", length=12.0)
    refuse(exchange, "rover#2")
    refuse(exchange, "")
    refuse(exchange, ME, node="descent_node")
    assert exchange.outcome is None
    refuse(exchange, ME)
    refused = Outcome(Verdict.REFUSED, topics.WINCH_REQUEST, "not now", "wrong_phase")
    assert exchange.outcome == refused
    assert refused.text == "winch/request refused: not now [wrong_phase]"


def test_the_end_of_another_stop_is_not_one_s_own():
    exchange = asked("descend", depth=12.5)
    event(exchange, "stop_ended", "reached", depth=12.5)  # said before, and kept for late comers
    accept(exchange)
    event(exchange, "stop_ended", "reached", depth=11.0)
    event(exchange, "stop_ended", "reached", node="winch_node", depth=12.5)
    assert exchange.ending is None
    event(exchange, "stop_ended", "reached", depth=12.5)
    assert ended(exchange) == (True, "reached")


@pytest.mark.parametrize(
    ("name", "level", "message"),
    [
        ("stop_ended", Level.WARN, "not steady within 60 s"),
        ("descent_interrupted", Level.WARN, "the winch is in fault"),
        ("descent_holding", Level.OK, "asked to hold"),
    ],
)
def test_a_descent_may_end_otherwise(name: str, level: Level, message: str):
    exchange = asked("observe", depth=12.5)
    accept(exchange)
    event(exchange, name, message, level, depth=12.5)
    done, reason = ended(exchange)
    assert not done
    assert message in reason


@pytest.mark.parametrize(
    ("values", "done"),
    [({"length": 12.01}, True), ({"length": 9.0}, False), ({"length": "nan"}, False), ({}, False)],
)
def test_a_winch_that_holds_elsewhere_has_not_come_there(values: Mapping[str, Any], done: bool):
    exchange = asked("payout", length=12.0)
    accept(exchange)
    event(exchange, "winch_hold", "holds", **values)
    assert ended(exchange) == (done, "holds")


def test_a_jump_is_over_at_rest_on_the_ground_and_lost_when_the_spring_is_let_down():
    good, bad = asked("jump", stroke=0.2), asked("jump", stroke=0.2)
    for exchange in (good, bad):
        event(exchange, "jump_compressing")
        accept(exchange)
    for name in ("jump_flight", "jump_landed"):
        event(good, name)
    assert good.ending is None
    assert [status.name for status in good.story] == ["jump_flight", "jump_landed"]
    event(good, "jump_standby", "at rest on the ground")
    assert ended(good) == (True, "at rest on the ground")
    event(bad, "jump_letting_down", "no take-off", Level.ERROR)
    event(bad, "jump_standby", "the spring is let down")
    assert ended(bad) == (False, "jump_letting_down: no take-off")


def test_a_goal_in_a_frame_is_answered_by_its_stamp():
    exchange = asked("drive", way=2.0)
    exchange.commander = "1500000123 ns"
    accept(exchange, "1500000000 ns")
    assert exchange.outcome is None
    accept(exchange, "1500000123 ns")
    assert exchange.outcome is not None
    event(exchange, "drive_done", "all goals are reached")
    assert ended(exchange) == (True, "all goals are reached")


def test_a_renewal_that_is_refused_ends_what_was_accepted():
    exchange = asked("jog", rate=-0.01)
    accept(exchange)
    accept(exchange)
    assert exchange.ending is None
    refuse(exchange, ME)
    assert ended(exchange) == (False, "refused: not now [wrong_phase]")


def test_a_service_s_answer_is_read_with_its_code():
    said = str(Refusal(topics.WINCH_HOLD, RefusalCode.NOT_ARMED, "the winch is [odd] in stop"))
    assert answer_of(topics.WINCH_HOLD, False, said) == Outcome(
        Verdict.REFUSED, topics.WINCH_HOLD, "the winch is [odd] in stop", "not_armed"
    )
    assert answer_of(topics.SIM_STEP, False, "it runs").code == ""
    assert answer_of(topics.SIM_STEP, False, "it [runs]").reason == "it [runs]"
    assert answer_of(topics.WINCH_HOLD, True, "coming to rest").is_accepted


def part(verdict: Verdict, code: str = "") -> Outcome:
    return Outcome(verdict, "s", verdict.value, code)


IDLE = part(Verdict.REFUSED, "wrong_phase")
STALE = part(Verdict.REFUSED, "stale")
DONE = part(Verdict.ACCEPTED)
AWAY = part(Verdict.NOBODY)
LOST = part(Verdict.NO_ANSWER)


@pytest.mark.parametrize(
    ("parts", "needs_all", "verdict"),
    [
        ((DONE, AWAY), False, Verdict.ACCEPTED),
        ((DONE, AWAY), True, Verdict.ACCEPTED),
        ((AWAY, AWAY), False, Verdict.NOBODY),
        ((IDLE, DONE), False, Verdict.ACCEPTED),
        ((IDLE, DONE), True, Verdict.REFUSED),
        ((IDLE, IDLE), False, Verdict.REFUSED),
        ((DONE, STALE), False, Verdict.REFUSED),
        ((DONE, LOST, STALE), False, Verdict.NO_ANSWER),
        ((IDLE, AWAY), False, Verdict.REFUSED),
        ((LOST,), False, Verdict.NO_ANSWER),
    ],
)
def test_an_order_that_goes_several_ways_is_as_good_as_its_worst(
    parts: tuple[Outcome, ...], needs_all: bool, verdict: Verdict
):
    assert joined(parts, needs_all).verdict is verdict
