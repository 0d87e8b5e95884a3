"""What a controller tells of itself: something has changed, with the reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msg_schemas.samples import Level


@dataclass(frozen=True)
class Transition:
    """Something that changed, with its reason and its values; nodes tell it as an event."""

    name: str
    reason: str
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)
