"""Values of events: only those that the event declares."""

import pytest

from msg_schemas.events import EVENTS, EventName, EventReport, NodeEvent, WinchEvent
from msg_schemas.faults import Reason


@pytest.mark.parametrize("name", EVENTS.values(), ids=str)
def test_an_event_is_reported_with_all_its_declared_values(name: EventName):
    values = {value: 1.0 for value in name.values if value != "reason"}
    reason = Reason.REQUESTED if "reason" in name.values else None
    assert set(EventReport(name, "text", values, reason).texts()) == set(name.values)


def test_an_undeclared_value_is_refused_with_the_declared_names():
    with pytest.raises(ValueError, match="'lenght', it declares length, reason"):
        EventReport(WinchEvent.HOLD, "holds", {"lenght": 1.0})


def test_a_reason_is_refused_where_the_event_declares_none():
    with pytest.raises(ValueError, match="'reason', it declares none"):
        EventReport(NodeEvent.ACTIVE, "active", reason=Reason.REQUESTED)
