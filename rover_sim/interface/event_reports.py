"""Reports of the plant's events and of drives stopped by a command timeout, with messages."""

from __future__ import annotations

from msg_schemas.events import EventReport, PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from rover_sim.devices.actuators import CommandTimeout, stopped
from rover_sim.plants.plant import Event, State, StepResult
from rover_sim.scenarios.scenario import AnyScenario

_LATCH_WORDS = {
    PlantEvent.LATCH_FREE: "the nut is clear of the latch",
    PlantEvent.LATCH_HOOKING: "the nut moves past the latch",
    PlantEvent.LATCH_ENGAGED: "nut and latch are engaged",
    PlantEvent.LATCH_COMPRESSING: "the nut compresses the spring",
    PlantEvent.LATCH_RELEASED: "the latch has tripped",
}


def timeout_report(timeout: CommandTimeout, stamp_ns: int) -> EventReport:
    """Report a drive that its watchdog has stopped."""
    name = SimulationEvent.COMMAND_TIMEOUT
    return EventReport(name, timeout.message, timeout.values, stamp_ns=stamp_ns)


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
    if event.name is PlantEvent.DIVERGED:
        integration = scenario.integration
        values |= {
            "plant_time": after.time,
            "newton_iterations": result.newton_iterations,
            "h": integration.h,
            "tolerance": integration.tolerance,
            "max_halvings": integration.max_halvings,
        }
        message = (
            f"{stopped(PlantPhase.DIVERGED)}; the last converged state is at {after.time:.6g} s; "
            "try a smaller integration.h, a larger integration.max_halvings or more tether damping"
        )
    elif event.name is PlantEvent.TETHER_BROKEN:
        message = f"{stopped(PlantPhase.TETHER_BROKEN)}; tension {values['tension']:.4g} N"
    else:
        message = _message_of(event)
    return EventReport(event.name, message, values, stamp_ns=stamp_ns)


def _message_of(event: Event) -> str:
    values = event.values
    if event.name is PlantEvent.TAKE_OFF:
        return f"the rover takes off at {values['speed']:.4g} m/s"
    if event.name is PlantEvent.APEX:
        return f"apex {values['height']:.4g} m above the start"
    if event.name is PlantEvent.TOUCHDOWN and "attitude_variation" in values:
        return (
            f"touchdown after {values['flight_time']:.4g} s: height {values['height']:.4g} m, "
            f"attitude variation {values['attitude_variation']:+.4g} rad, "
            f"travel {values['travel']:+.4g} m"
        )
    if event.name is PlantEvent.TOUCHDOWN:
        return (
            f"touchdown at {values['speed']:.4g} m/s, "
            f"{values['height']:.4g} m above the last take-off"
        )
    if event.name is PlantEvent.DRUM_STOP:
        where = "fully reeled in" if values["side"] < 0.0 else "fully paid out"
        return f"the drum is at its stop, {where}; tension {values['tension']:.4g} N"
    if event.name is PlantEvent.ENERGY_DRIFT:
        return (
            f"the energy balance is open by {values['drift']:+.3g} J of {values['turnover']:.3g} J"
            " turned over; take a smaller integration.h"
        )
    if event.name is PlantEvent.TETHER_PUSH:
        return (
            f"the tether pushes with {values['push']:.3g} N and can carry {values['limit']:.3g} N;"
            " set tether.buckling, or take a smaller tether.element_length"
        )
    return _LATCH_WORDS[event.name]
