"""What may stand under a step's `expect`, by its word."""

from __future__ import annotations

from collections.abc import Mapping

from rover_hil.rehearsal.event_expectations import Event, Figure, Refused, Value, Word
from rover_hil.rehearsal.expectation import Expectation
from rover_hil.rehearsal.streams import Age, Gap, Obeys, Rate, Silent

EXPECTATIONS: Mapping[str, type[Expectation]] = {
    "rate": Rate,
    "gap": Gap,
    "age": Age,
    "obeys": Obeys,
    "silent": Silent,
    "value": Value,
    "word": Word,
    "event": Event,
    "refused": Refused,
    "figure": Figure,
}
