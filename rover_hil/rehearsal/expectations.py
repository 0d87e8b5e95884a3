"""Kinds of expectations under a step's `expect`, by their keys."""

from __future__ import annotations

from collections.abc import Mapping

from rover_hil.rehearsal.event_expectations import (
    EventExpectation,
    Metric,
    RefusalExpectation,
    Text,
    Value,
)
from rover_hil.rehearsal.expectation import Expectation
from rover_hil.rehearsal.stream_expectations import Age, Conforms, Gap, NoMessages, Rate

EXPECTATIONS: Mapping[str, type[Expectation]] = {
    "rate": Rate,
    "gap": Gap,
    "age": Age,
    "conforms": Conforms,
    "no_messages": NoMessages,
    "value": Value,
    "text": Text,
    "event": EventExpectation,
    "refusal": RefusalExpectation,
    "metric": Metric,
}
