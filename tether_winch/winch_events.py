"""Events of the winch: changes of its mode, and alarms. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from msg_schemas.events import EventReport, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import LoadState, WinchMode

_MODES = {
    WinchMode.HOLD: WinchEvent.HOLD,
    WinchMode.LENGTH: WinchEvent.LENGTH,
    WinchMode.RATE: WinchEvent.RATE,
    WinchMode.TENSION: WinchEvent.TENSION,
    WinchMode.SLACK: WinchEvent.SLACK,
    WinchMode.RELAX: WinchEvent.RELAX,
    WinchMode.STOP: WinchEvent.STOP,
    WinchMode.FAULT: WinchEvent.FAULT,
}
_ALARMS = {  # raised and cleared
    LoadState.TOUCHDOWN: (WinchEvent.TOUCHDOWN, WinchEvent.TOUCHDOWN_CLEARED),
    LoadState.SLACK: (WinchEvent.SLACK_ALARM, WinchEvent.SLACK_CLEARED),
    LoadState.SNAG: (WinchEvent.SNAG, WinchEvent.SNAG_CLEARED),
    LoadState.OVER_TENSION: (WinchEvent.OVER_TENSION, WinchEvent.OVER_TENSION_CLEARED),
}
_ABORTING = (Reason.SNAG, Reason.RENEWAL_TIMEOUT)


def mode_event(
    mode: WinchMode, text: str, reason: Reason, values: Mapping[str, object]
) -> EventReport:
    """Report a change of mode."""
    aborts = mode is WinchMode.HOLD and reason in _ABORTING
    return EventReport(WinchEvent.MOTION_ABORTED if aborts else _MODES[mode], text, values, reason)


def alarm_event(name: str, *, is_on: bool, values: Mapping[str, float]) -> EventReport:
    """Report an alarm that was raised or cleared."""
    raised, cleared = _ALARMS[LoadState(name)]
    text = f"tension {values['tension']:.4g} N"
    if is_on:
        return EventReport(raised, f"{text} at {values['length']:.4g} m", values)
    return EventReport(cleared, text, values)
