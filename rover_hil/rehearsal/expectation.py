"""What all expectations share: ranges, times, and what they offer.

An expectation is a frozen configuration: its fields are the keys of the procedure. Times are in
seconds of the clock that stamps the machine's messages, and are measured by these stamps, so that
neither a slow network nor a busy rehearsal changes what is found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_hil.rehearsal.finding import Finding
from rover_hil.rehearsal.history import Window

NANO = 1e9
LATE = 0.5
"""For what must not come: so long is it listened for after the time that is judged [s]."""
_LONGEST = 3600.0  # [s]


def within_bounds(value: float, minimum: float | None, maximum: float | None) -> bool:
    """Whether a value lies in a range, one or both ends of which may be open."""
    return (minimum is None or value >= minimum) and (maximum is None or value <= maximum)


def range_text(minimum: float | None, maximum: float | None, unit: str) -> str:
    """A range in words."""
    unit = "" if unit in {"", "-"} else f" {unit}"
    if minimum is None:
        return f"at most {maximum:g}{unit}"
    if maximum is None:
        return f"at least {minimum:g}{unit}"
    return f"{minimum:g} to {maximum:g}{unit}"


def check_range(minimum: float | None, maximum: float | None) -> None:
    """Refuse a range without ends, or with none between them."""
    if minimum is None and maximum is None:
        raise ConfigurationError("minimum", None, "missing; minimum, maximum or both must be given")
    if minimum is not None and maximum is not None and minimum > maximum:
        raise ConfigurationError("minimum", minimum, f"should be at most the maximum, {maximum:g}")


def bound(unit: str, about: str) -> Any:
    """A field for one end of a range."""
    return quantity(unit, about, None, optional=True)


def within(about: str, default: float = 1.0) -> Any:
    """A field for a time [s]."""
    return quantity("s", about, default, minimum=0.0, maximum=_LONGEST)


@dataclass(frozen=True, kw_only=True)
class Expectation(Configuration):
    """What all kinds have."""

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return ()

    @property
    def needs_time(self) -> bool:
        """Whether it is judged over the time that the actions take."""
        return False

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing; asked when the actions have ended."""
        raise NotImplementedError

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        raise NotImplementedError
