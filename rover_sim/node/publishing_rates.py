"""Parameters of the rates at which a simulator publishes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from msg_schemas import topics
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.table import TOPICS


def table_rate(name: str) -> float:
    """Return a topic's rate in the contract [Hz]."""
    rate = TOPICS[name].rate
    if rate is None:
        raise AssertionError(f"{name} has no rate")
    return rate


def rate_parameter(about: str, name: str) -> Any:
    """Declare a parameter for a topic's rate in simulated time."""
    return parameter(
        table_rate(name), "Hz", f"{about}, in simulated time", 0.1, 1e4, read_only=True
    )


@dataclass(frozen=True)
class TruthRates:
    """Rates of the ground-truth topics and the camera, at most one sample per tick."""

    truth_rate: float = rate_parameter(
        "rate of the bodies' true motion and of the energies", topics.TRUTH_BODY1
    )
    tether_rate: float = rate_parameter("rate of the tether's true shape", topics.TRUTH_TETHER)
    camera_rate: float = rate_parameter("rate of the wall camera's measurements", topics.CAMERA)
    state_rate: float = rate_parameter("rate of the plant's whole state", topics.TRUTH_STATE)
    marker_rate: float = rate_parameter("rate of the visualization markers", topics.MARKERS)

    def check(self, tick: float) -> None:
        """Refuse rates above one sample per tick."""
        for field in dataclasses.fields(self):
            rate = getattr(self, field.name)
            if rate * tick > 1.0 + 1e-9:
                msg = (
                    f"{field.name} is {rate:g} Hz, it must be at most {1.0 / tick:g} Hz, "
                    f"once per tick of {tick:g} s"
                )
                raise ParameterError(msg)

    def of_topics(self, names: Iterable[str], default: float) -> dict[str, float]:
        """Return the rate [Hz] of each topic; `default` for topics without a parameter."""
        rates = {
            topics.TRUTH_BODY1: self.truth_rate,
            topics.TRUTH_BODY2: self.truth_rate,
            topics.TRUTH_ENERGY: self.truth_rate,
            topics.TRUTH_TETHER: self.tether_rate,
            topics.TRUTH_STATE: self.state_rate,
            topics.CAMERA: self.camera_rate,
            topics.MARKERS: self.marker_rate,
        }
        return {name: rates.get(name, default) for name in names}
