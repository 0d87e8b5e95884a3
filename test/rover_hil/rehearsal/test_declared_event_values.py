"""Expectations of events name only values that the event declares."""

import pytest

from msg_schemas.configuration import ConfigurationError
from msg_schemas.events import WinchEvent
from rover_hil.rehearsal.event_expectations import EventExpectation


def test_an_undeclared_value_is_refused_with_the_declared_names():
    with pytest.raises(ConfigurationError, match="it declares: length, reason"):
        EventExpectation(name=WinchEvent.HOLD, values=(("lenght", "1.0"),), within=1.0)
