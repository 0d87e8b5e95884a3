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


def test_slack_is_done_only_when_the_winch_has_completed_the_motion():
    done = completion("slack", WinchEvent.HOLD, reason=Reason.COMPLETED)
    held = completion("slack", WinchEvent.HOLD, reason=Reason.REQUESTED)
    assert done is not None
    assert done.is_done
    assert held is not None
    assert not held.is_done


def test_a_jump_without_take_off_is_not_done():
    ended = completion("jump", JumpEvent.NO_TAKE_OFF)
    assert ended is not None
    assert not ended.is_done


def test_a_criterion_refuses_values_that_its_events_do_not_declare():
    with pytest.raises(ValueError, match="no value 'lenght', it declares: length, reason"):
        CompletionCriterion(WinchEvent.HOLD, tolerances={"lenght": ("length", 0.05)})
    with pytest.raises(ValueError, match="no value 'reason', it declares: none"):
        CompletionCriterion(NodeEvent.ACTIVE, reasons=(Reason.COMPLETED,))
