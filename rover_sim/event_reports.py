"""What the simulation tells of: events of the plant and stopped drives, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msg_schemas.samples import Level
from rover_sim.actuators import CommandTimeout, stopped
from rover_sim.plant import Event, Phase, State, StepResult
from rover_sim.scenario import AnyScenario

_LATCH_WORDS = {
    "latch_free": "the nut is clear of the latch",
    "latch_hooking": "the nut climbs past the latch",
    "latch_engaged": "nut and latch are engaged",
    "latch_compressing": "the nut compresses the spring",
    "latch_released": "the latch has tripped",
}


@dataclass(frozen=True)
class EventReport:
    """Something to tell: an event of the plant or of the simulation, at its simulated time."""

    name: str
    message: str
    stamp_ns: int
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)


def timeout_report(timeout: CommandTimeout, stamp_ns: int) -> EventReport:
    """A drive that was stopped because its commands have ceased."""
    return EventReport(timeout.name, timeout.message, stamp_ns, Level.WARN, timeout.values)


def plant_event_report(
    event: Event, stamp_ns: int, after: State, result: StepResult, scenario: AnyScenario
) -> EventReport:
    """An event of the plant.

    Args:
        event: what happened.
        stamp_ns: its simulated time.
        after: the state at the end of the tick.
        result: what the step reported.
        scenario: what is simulated.
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
            f"{stopped(Phase.DIVERGED)}; the last good state, at {after.time:.6g} s, is kept; "
            "a smaller integration.h, a larger integration.max_halvings or a tether with damping "
            "may help"
        )
    elif event.name == "tether_broken":
        level = Level.ERROR
        message = f"{stopped(Phase.TETHER_BROKEN)}; tension {values['tension']:.4g} N"
    else:
        message = _in_words(event)
    return EventReport(event.name, message, stamp_ns, level, values)


def _in_words(event: Event) -> str:
    values = event.values
    if event.name == "take_off":
        return f"the rover takes off at {values['speed']:.4g} m/s"
    if event.name == "apex":
        return f"highest at {values['height']:.4g} m over the start"
    if event.name == "touchdown" and "attitude_variation" in values:
        return (
            f"down after {values['flight_time']:.4g} s: height {values['height']:.4g} m, "
            f"attitude changed by {values['attitude_variation']:+.4g} rad, "
            f"travelled {values['travel']:+.4g} m"
        )
    if event.name == "touchdown":
        return (
            f"down at {values['speed']:.4g} m/s with {values['load']:.4g} N, "
            f"from {values['height']:.4g} m over the last take-off"
        )
    if event.name == "drum_stop":
        where = "fully reeled in" if values["side"] < 0.0 else "with nothing left to pay out"
        return f"the drum is at its stop, {where}; tension {values['tension']:.4g} N"
    return _LATCH_WORDS.get(event.name, event.name)
