"""A request recognises its own answer and its own end."""

from collections.abc import Mapping
from typing import Any

import pytest

from msg_schemas import topics
from msg_schemas.events import DescentEvent, DriveEvent, JumpEvent, NodeEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Status, StatusSample
from operator_console.commands import COMMANDS
from operator_console.exchange import Exchange, OrderStatus, Outcome, answer_of, joined
from rover_runtime.refusal_log import RefusalLog

ME = "rover#1"


def exchange_of(name: str, **values: object) -> Exchange:
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
    status = Status(name, message, level, node or exchange.request.node, texts)
    exchange.on_statuses(topics.EVENTS, StatusSample(1, (status,)))


def accept(exchange: Exchange, source: str = ME) -> None:
    event(exchange, NodeEvent.REQUEST_ACCEPTED, command_source=source)


def refuse(exchange: Exchange, source: str, node: str = "") -> None:
    refusal = Refusal(exchange.request.topic, RefusalCode.WRONG_PHASE, "not now")
    refusal.command_source = source
    status = RefusalLog(node or exchange.request.node).take(refusal)
    assert status is not None
    exchange.on_statuses(topics.DIAGNOSTICS, StatusSample(1, (status,)))


def ended(exchange: Exchange) -> tuple[bool, str]:
    assert exchange.completion is not None
    return exchange.completion.is_done, exchange.completion.reason


def test_only_an_acceptance_with_the_own_name_counts():
    exchange = exchange_of("payout", length=12.0)
    accept(exchange, "rover#2")
    assert exchange.outcome is None
    accept(exchange)
    assert exchange.outcome is not None
    assert exchange.outcome.is_accepted


def test_only_a_refusal_with_the_own_name_counts_with_code_and_reason():
    exchange = exchange_of("payout", length=12.0)
    refuse(exchange, "rover#2")
    refuse(exchange, "")
    refuse(exchange, ME, node="descent_node")
    assert exchange.outcome is None
    refuse(exchange, ME)
    refused = Outcome(OrderStatus.REFUSED, topics.WINCH_REQUEST, "not now", "wrong_phase")
    assert exchange.outcome == refused
    assert refused.text == "winch/request refused: not now [wrong_phase]"


def test_the_end_of_another_stop_does_not_complete_the_request():
    exchange = exchange_of("descend", depth=12.5)
    event(
        exchange, DescentEvent.STOP_COMPLETED, "reached", depth=12.5
    )  # latched before the request
    accept(exchange)
    event(exchange, DescentEvent.STOP_COMPLETED, "reached", depth=11.0)
    event(exchange, DescentEvent.STOP_COMPLETED, "reached", node="winch_node", depth=12.5)
    assert exchange.completion is None
    event(exchange, DescentEvent.STOP_COMPLETED, "reached", depth=12.5)
    assert ended(exchange) == (True, "reached")


@pytest.mark.parametrize(
    ("name", "level", "message"),
    [
        (DescentEvent.STOP_FAILED, Level.WARN, "not steady within 60 s"),
        (DescentEvent.INTERRUPTED, Level.WARN, "the winch is in fault"),
        (DescentEvent.HOLDING, Level.OK, "exchange_of to hold"),
    ],
)
def test_a_descent_may_end_without_success(name: str, level: Level, message: str):
    exchange = exchange_of("observe", depth=12.5)
    accept(exchange)
    event(exchange, name, message, level, depth=12.5)
    done, reason = ended(exchange)
    assert not done
    assert message in reason


@pytest.mark.parametrize(
    ("values", "done"),
    [({"reason": Reason.COMPLETED}, True), ({"reason": Reason.REQUESTED}, False), ({}, False)],
)
def test_a_winch_that_holds_before_its_goal_is_not_done(values: Mapping[str, Any], done: bool):
    exchange = exchange_of("payout", length=12.0)
    accept(exchange)
    event(exchange, WinchEvent.HOLD, "holds", **values)
    assert ended(exchange) == (done, "holds")


def test_a_jump_is_done_at_rest_on_the_ground_and_fails_when_the_spring_is_unloaded():
    good, bad = exchange_of("jump", stroke=0.2), exchange_of("jump", stroke=0.2)
    for exchange in (good, bad):
        event(exchange, JumpEvent.COMPRESSING)
        accept(exchange)
    for name in (JumpEvent.FLIGHT, JumpEvent.LANDED):
        event(good, name)
    assert good.completion is None
    assert [status.name for status in good.events] == [JumpEvent.FLIGHT, JumpEvent.LANDED]
    event(good, JumpEvent.STANDBY, "at rest on the ground")
    assert ended(good) == (True, "at rest on the ground")
    event(bad, JumpEvent.FAILED, "no take-off", Level.ERROR)
    event(bad, JumpEvent.STANDBY, "the spring is let down")
    assert ended(bad) == (False, "jump_failed: no take-off")


def test_a_goal_in_a_frame_is_matched_by_its_stamp():
    exchange = exchange_of("drive", distance=2.0)
    exchange.command_source = "1500000123 ns"
    accept(exchange, "1500000000 ns")
    assert exchange.outcome is None
    accept(exchange, "1500000123 ns")
    assert exchange.outcome is not None
    event(exchange, DriveEvent.COMPLETED, "all goals are reached")
    assert ended(exchange) == (True, "all goals are reached")


def test_a_refused_renewal_ends_the_accepted_request():
    exchange = exchange_of("jog", rate=-0.01)
    accept(exchange)
    accept(exchange)
    assert exchange.completion is None
    refuse(exchange, ME)
    assert ended(exchange) == (False, "refused: not now [wrong_phase]")


def test_a_service_s_answer_is_read_with_its_code():
    answer = str(Refusal(topics.WINCH_HOLD, RefusalCode.NOT_ARMED, "the winch is [odd] in stop"))
    assert answer_of(topics.WINCH_HOLD, False, answer) == Outcome(
        OrderStatus.REFUSED, topics.WINCH_HOLD, "the winch is [odd] in stop", "not_armed"
    )
    assert answer_of(topics.SIM_STEP, False, "it runs").code == ""
    assert answer_of(topics.SIM_STEP, False, "it [runs]").reason == "it [runs]"
    assert answer_of(topics.WINCH_HOLD, True, "coming to rest").is_accepted


def part(status: OrderStatus, code: str = "") -> Outcome:
    return Outcome(status, "s", status.value, code)


IDLE = part(OrderStatus.REFUSED, "wrong_phase")
STALE = part(OrderStatus.REFUSED, "stale")
DONE = part(OrderStatus.ACCEPTED)
UNAVAILABLE = part(OrderStatus.UNAVAILABLE)
UNANSWERED = part(OrderStatus.NO_ANSWER)


@pytest.mark.parametrize(
    ("parts", "all_required", "status"),
    [
        ((DONE, UNAVAILABLE), False, OrderStatus.ACCEPTED),
        ((DONE, UNAVAILABLE), True, OrderStatus.ACCEPTED),
        ((UNAVAILABLE, UNAVAILABLE), False, OrderStatus.UNAVAILABLE),
        ((IDLE, DONE), False, OrderStatus.ACCEPTED),
        ((IDLE, DONE), True, OrderStatus.REFUSED),
        ((IDLE, IDLE), False, OrderStatus.REFUSED),
        ((DONE, STALE), False, OrderStatus.REFUSED),
        ((DONE, UNANSWERED, STALE), False, OrderStatus.NO_ANSWER),
        ((IDLE, UNAVAILABLE), False, OrderStatus.REFUSED),
        ((UNANSWERED,), False, OrderStatus.NO_ANSWER),
    ],
)
def test_several_calls_are_as_good_as_their_worst_result(
    parts: tuple[Outcome, ...], all_required: bool, status: OrderStatus
):
    assert joined(parts, all_required).status is status
