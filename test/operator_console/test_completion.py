"""Completion criteria of the operators' commands."""

import pytest

from msg_schemas.events import EventName, JumpEvent, NodeEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.samples import Status
from operator_console.commands import COMMANDS
from operator_console.completion import Completion, CompletionCriterion


def completion(command: str, event: EventName, **values: str) -> Completion | None:
    criterion = COMMANDS[command].completion
    assert criterion is not None
    return criterion.evaluate(Status(event, "text", event.level, "node", values), {})


def is_done(command: str, event: EventName, **values: str) -> bool:
    found = completion(command, event, **values)
    assert found is not None
    return found.is_done


def test_slack_is_done_when_the_winch_has_given_it_or_taken_it_up():
    assert is_done("slack", WinchEvent.SLACK_REACHED, reason=Reason.COMPLETED)
    assert not is_done("slack", WinchEvent.HOLD, reason=Reason.REQUESTED)
    assert completion("slack", WinchEvent.TOUCHDOWN) is None


@pytest.mark.parametrize("reason", list(Reason))
def test_a_payout_is_done_only_when_the_winch_has_completed_the_motion(reason: Reason):
    """Also near its goal, a hold by another operator or a touchdown is not its end."""
    near = {"length": "20.001", "reason": reason.value}
    assert is_done("payout", WinchEvent.HOLD, **near) is (reason is Reason.COMPLETED)


def test_a_jump_without_take_off_is_not_done():
    ended = completion("jump", JumpEvent.NO_TAKE_OFF)
    assert ended is not None
    assert not ended.is_done


def test_a_criterion_refuses_values_that_its_events_do_not_declare():
    with pytest.raises(ValueError, match="no value 'lenght', it declares: length, reason"):
        CompletionCriterion(WinchEvent.HOLD, matching={"lenght": "length"})
    with pytest.raises(ValueError, match="no value 'reason', it declares: none"):
        CompletionCriterion(NodeEvent.ACTIVE, reasons=(Reason.COMPLETED,))
