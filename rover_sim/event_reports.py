"""Reports of the plant's events and of drives stopped by a command timeout, with messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msg_schemas.samples import Level
from rover_sim.actuators import CommandTimeout, stopped
from rover_sim.plant import Event, Phase, State, StepResult
from rover_sim.scenario import AnyScenario

_LATCH_WORDS = {
    "latch_free": "the nut is clear of the latch",
    "latch_hooking": "the nut moves past the latch",
    "latch_engaged": "nut and latch are engaged",
    "latch_compressing": "the nut compresses the spring",
    "latch_released": "the latch has tripped",
}


@dataclass(frozen=True)
class EventReport:
    """A report of an event of the plant or the simulation, at its simulated time."""

    name: str
    message: str
    stamp_ns: int
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)


def timeout_report(timeout: CommandTimeout, stamp_ns: int) -> EventReport:
    """Report a drive that its watchdog has stopped."""
    return EventReport(timeout.name, timeout.message, stamp_ns, Level.WARN, timeout.values)


def plant_event_report(
    event: Event, stamp_ns: int, after: State, result: StepResult, scenario: AnyScenario
) -> EventReport:
    """Report an event of the plant.

    Args:
        event: the event.
        stamp_ns: its simulated time.
        after: the state at the end of the tick.
        result: of the step.
        scenario: of the plant.
    """
    values: dict[str, object] = dict(event.values)
    level = Level.OK
    if event.name == "diverged":
        level = Level.ERROR
        integration = scenario.integration
        values |= {
            "plant_time": after.time,
            "newton_iterations": result.newton_iterations,
            "h": integration.h,
            "tolerance": integration.tolerance,
            "max_halvings": integration.max_halvings,
        }
        message = (
            f"{stopped(Phase.DIVERGED)}; the last converged state is at {after.time:.6g} s; try a "
            "smaller integration.h, a larger integration.max_halvings or more damping of the tether"
        )
    elif event.name == "tether_broken":
        level = Level.ERROR
        message = f"{stopped(Phase.TETHER_BROKEN)}; tension {values['tension']:.4g} N"
    else:
        message = _message_of(event)
    return EventReport(event.name, message, stamp_ns, level, values)


def _message_of(event: Event) -> str:
    values = event.values
    if event.name == "take_off":
        return f"the rover takes off at {values['speed']:.4g} m/s"
    if event.name == "apex":
        return f"apex {values['height']:.4g} m above the start"
    if event.name == "touchdown" and "attitude_variation" in values:
        return (
            f"touchdown after {values['flight_time']:.4g} s: height {values['height']:.4g} m, "
            f"attitude variation {values['attitude_variation']:+.4g} rad, "
            f"travel {values['travel']:+.4g} m"
        )
    if event.name == "touchdown":
        return (
            f"touchdown at {values['speed']:.4g} m/s with a load of {values['load']:.4g} N, "
            f"{values['height']:.4g} m above the last take-off"
        )
    if event.name == "drum_stop":
        where = "fully reeled in" if values["side"] < 0.0 else "fully paid out"
        return f"the drum is at its stop, {where}; tension {values['tension']:.4g} N"
    return _LATCH_WORDS.get(event.name, event.name)
