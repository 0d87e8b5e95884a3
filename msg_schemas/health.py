"""Health of a node as `diagnostics` reports it."""

from __future__ import annotations

from dataclasses import dataclass

from msg_schemas.phases import HealthState
from msg_schemas.samples import Level, Status


@dataclass(frozen=True)
class Health:
    """Readiness of one node.

    Attributes:
        node: its name.
        state: whether it can do its work.
        missing: inputs that it waits for.
    """

    node: str
    state: HealthState
    missing: tuple[str, ...] = ()

    @property
    def message(self) -> str:
        """The state for people."""
        if self.state is HealthState.WAITING:
            return f"waiting for {', '.join(self.missing)}"
        return self.state.value

    def status(self, values: dict[str, str]) -> Status:
        """The line of `diagnostics`, with further values."""
        level = Level.WARN if self.state is HealthState.WAITING else Level.OK
        own = {"state": self.state.value, "waiting_for": ", ".join(self.missing)}
        return Status(f"{self.node}: node", self.message, level, self.node, {**own, **values})


def read_health(status: Status) -> Health | None:
    """Decode a line of `diagnostics`; None = it is not the health of a node."""
    try:
        state = HealthState(status.values["state"])
        missing = tuple(status.values["waiting_for"].split(", "))
    except (KeyError, ValueError):
        return None
    return Health(status.hardware_id, state, missing if missing != ("",) else ())
