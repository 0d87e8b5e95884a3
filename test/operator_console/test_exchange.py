"""A request recognises its own answer and its own end."""

import pytest

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState, split_name
from msg_schemas.events import EventName, JumpEvent, NodeEvent
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, PoseSample, Status, StatusSample
from operator_console.commands import COMMANDS
from operator_console.exchange import Exchange, OrderResult, OrderStatus, answer_of, joined

ME = "rover#1"


def exchange_of(name: str, **values: object) -> Exchange:
    return Exchange(COMMANDS[name].order(values), ME)


def record(
    exchange: Exchange,
    state: CommandState,
    text: str = "",
    name: str = ME,
    reason: RefusalCode | Reason | None = None,
    node: str = "",
) -> None:
    sender, identifier = split_name(name)
    taken = CommandRecord(
        node or exchange.node, exchange.subject, sender, identifier, 1, state,
        reason=reason, text=text,
    )  # fmt: skip
    exchange.on_statuses(topics.COMMANDS, StatusSample(1, (taken.status(),)))


def event(exchange: Exchange, name: EventName, message: str = "", node: str = "") -> None:
    status = Status(name, message, Level.OK, node or exchange.node)
    exchange.on_statuses(topics.EVENTS, StatusSample(1, (status,)))


def accept(exchange: Exchange, name: str = ME) -> None:
    record(exchange, CommandState.ACCEPTED, name=name)


def refuse(exchange: Exchange, name: str, node: str = "") -> None:
    record(exchange, CommandState.REFUSED, "not now", name, RefusalCode.WRONG_PHASE, node)


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
    refused = OrderResult(OrderStatus.REFUSED, topics.WINCH_REQUEST, "not now", "wrong_phase")
    assert exchange.outcome == refused


def test_only_the_own_record_completes_the_request():
    exchange = exchange_of("descend", depth=12.5)
    record(exchange, CommandState.DONE, "another one", "rover#0")
    accept(exchange)
    record(exchange, CommandState.DONE, "another one", "rover#2")
    record(exchange, CommandState.RUNNING, "travelling")
    assert exchange.completion is None
    record(exchange, CommandState.DONE, "depth reached", reason=Reason.COMPLETED)
    assert ended(exchange) == (True, "depth reached")
    record(exchange, CommandState.FAILED, "held and resumed meanwhile")
    assert ended(exchange) == (True, "depth reached")


@pytest.mark.parametrize(
    "state", [CommandState.FAILED, CommandState.SUPERSEDED, CommandState.EXPIRED]
)
def test_a_request_may_end_without_success(state: CommandState):
    exchange = exchange_of("observe", depth=12.5)
    accept(exchange)
    record(exchange, state, "the winch is in fault")
    assert ended(exchange) == (False, f"{state}: the winch is in fault")


def test_a_request_that_needs_no_time_is_accepted_and_done_at_once():
    exchange = exchange_of("payout", length=12.0)
    record(exchange, CommandState.DONE, "nothing to do")
    assert exchange.outcome is not None
    assert exchange.outcome.is_accepted
    assert ended(exchange) == (True, "nothing to do")


def test_events_since_the_acceptance_are_kept_and_a_restart_loses_the_request():
    exchange = exchange_of("jump", stroke=0.2)
    event(exchange, JumpEvent.STANDBY)
    accept(exchange)
    event(exchange, JumpEvent.COMPRESSING)
    event(exchange, NodeEvent.ACTIVE, node="winch_node")
    assert [status.name for status in exchange.events] == [JumpEvent.COMPRESSING]
    assert exchange.completion is None
    event(exchange, NodeEvent.ACTIVE)
    assert ended(exchange) == (False, "jump_node has started again, the command is lost")


def test_a_goal_in_a_frame_is_matched_by_its_stamp():
    exchange = exchange_of("drive", distance=2.0)
    exchange.aim(PoseSample(1_500_000_123, (2.0, 0.0, 0.0)))
    accept(exchange)
    accept(exchange, "#1500000000")
    assert exchange.outcome is None
    accept(exchange, "#1500000123")
    assert exchange.outcome is not None
    record(exchange, CommandState.DONE, "all goals are reached", "#1500000123")
    assert ended(exchange) == (True, "all goals are reached")


def test_a_call_follows_the_first_record_that_the_node_takes_after_it():
    exchange = Exchange(COMMANDS["mission-go"].order({}), after_ns=100)

    def report(taken_ns: int, state: CommandState, text: str = "") -> None:
        go = CommandRecord(
            "mission_node", topics.MISSION_GO, "", str(taken_ns), taken_ns, state, text=text
        )
        exchange.on_statuses(topics.COMMANDS, StatusSample(1, (go.status(),)))

    report(90, CommandState.DONE, "the mission before")
    assert exchange.record is None
    report(120, CommandState.ACCEPTED)
    report(150, CommandState.DONE, "another operator's")
    report(120, CommandState.RUNNING, "look from 15 m")
    assert exchange.completion is None
    report(120, CommandState.DONE, "the rover is home")
    assert ended(exchange) == (True, "the rover is home")


def test_a_refused_renewal_ends_the_accepted_request():
    exchange = exchange_of("jog", rate=-0.01)
    accept(exchange)
    accept(exchange)
    assert exchange.completion is None
    refuse(exchange, ME)
    assert ended(exchange) == (False, "refused: not now [wrong_phase]")


def test_a_service_s_answer_is_read_with_its_code():
    answer = str(Refusal(topics.WINCH_HOLD, RefusalCode.NOT_ARMED, "the winch is [odd] in stop"))
    assert answer_of(topics.WINCH_HOLD, False, answer) == OrderResult(
        OrderStatus.REFUSED, topics.WINCH_HOLD, "the winch is [odd] in stop", "not_armed"
    )
    assert answer_of(topics.SIM_STEP, False, "it runs").code == ""
    assert answer_of(topics.SIM_STEP, False, "it [runs]").reason == "it [runs]"
    assert answer_of(topics.WINCH_HOLD, True, "coming to rest").is_accepted


def part(status: OrderStatus, code: str = "") -> OrderResult:
    return OrderResult(status, "s", status.value, code)


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
    parts: tuple[OrderResult, ...], all_required: bool, status: OrderStatus
):
    assert joined(parts, all_required).status is status


def test_what_an_order_went_without_is_named():
    missing = OrderResult(OrderStatus.UNAVAILABLE, topics.DRIVES_ARM, "hil_bridge does not run")
    found = joined([DONE, missing], all_required=True)
    reason = f"accepted (without {topics.DRIVES_ARM}: hil_bridge does not run)"
    assert (found.status, found.by, found.reason) == (OrderStatus.ACCEPTED, "s", reason)
