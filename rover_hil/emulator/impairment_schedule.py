"""Starts and ends impairments of channels, devices and processes when they are due."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from msg_schemas.events import EmulatorEvent, EventReport
from rover_hil.canopen.impairment import Impairment, Scope
from rover_hil.emulator.channel import ChannelImpairment, DeviceChannel, Direction
from rover_hil.emulator.device import EmulatedDevice


@dataclass
class _Scheduled:
    """An impairment that has been requested and is not over."""

    impairment: Impairment
    start_ns: int
    started: bool = False
    effects: list[tuple[Direction, ChannelImpairment]] = field(default_factory=list)

    @property
    def end_ns(self) -> int | None:
        duration = self.impairment.duration
        return self.start_ns + round(duration * 1e9) if duration else None


class ImpairmentSchedule:
    """The impairments of an emulated machine.

    Args:
        channels: of each device, by its name.
        devices: by name.
    """

    def __init__(
        self, channels: Mapping[str, DeviceChannel], devices: Mapping[str, EmulatedDevice]
    ) -> None:
        self._channels = channels
        self._devices = devices
        self._requested: tuple[Impairment, ...] = ()
        self._scheduled: list[_Scheduled] = []
        self._transitions: list[EventReport] = []
        self._kills: list[str] = []

    def set(self, requested: Sequence[Impairment], now_ns: int) -> None:
        """Replace the impairments; one that is in the list already continues.

        Args:
            requested: the whole list.
            now_ns: plant's time, from which their start counts.
        """
        self._requested = tuple(requested)
        before, self._scheduled = self._scheduled, []
        for impairment in requested:
            known = next((each for each in before if each.impairment == impairment), None)
            if known is not None:
                before.remove(known)
            else:
                known = _Scheduled(impairment, now_ns + round(impairment.start * 1e9))
            self._scheduled.append(known)
        for removed in before:
            self._end(removed)
        self.step(now_ns)

    def restart(self, now_ns: int) -> None:
        """Restart all requested impairments after a reset of the time."""
        requested = self._requested
        self.set((), now_ns)
        self.set(requested, now_ns)

    def step(self, now_ns: int) -> None:
        """Start and end impairments that are due."""
        for scheduled in list(self._scheduled):
            end_ns, definition = scheduled.end_ns, scheduled.impairment.definition
            if not scheduled.started and now_ns >= scheduled.start_ns:
                self._begin(scheduled)
                if definition.scope is Scope.PROCESS:
                    self._scheduled.remove(scheduled)  # done
                    continue
            if end_ns is not None and now_ns >= end_ns:
                self._scheduled.remove(scheduled)
                self._end(scheduled)

    def take_transitions(self) -> tuple[EventReport, ...]:
        """Starts and ends since the last call."""
        taken = tuple(self._transitions)
        self._transitions.clear()
        return taken

    def take_kills(self) -> tuple[str, ...]:
        """Process kills requested since the last call; the caller carries them out."""
        taken = tuple(self._kills)
        self._kills.clear()
        return taken

    def _begin(self, scheduled: _Scheduled) -> None:
        impairment, scheduled.started = scheduled.impairment, True
        scope = impairment.definition.scope
        self._transitions.append(
            EventReport(EmulatorEvent.IMPAIRMENT_STARTED, str(impairment), _values(impairment))
        )
        if scope is Scope.PROCESS:
            self._kills.append(impairment.kind)
        for device in impairment.devices:
            if scope is Scope.CHANNEL or impairment.kind in _CUT_OFF:
                for direction in self._channels[device.name].directions(impairment.direction):
                    scheduled.effects.append((direction, direction.begin(impairment)))
            if scope is Scope.DEVICE:
                self._devices[device.name].begin_impairment(impairment)

    def _end(self, scheduled: _Scheduled) -> None:
        if not scheduled.started:
            return
        impairment = scheduled.impairment
        frames = sum(effect.frames for _, effect in scheduled.effects)
        affected = sum(effect.affected for _, effect in scheduled.effects)
        for direction, effect in scheduled.effects:
            direction.end(effect)
        for device in impairment.devices:
            if impairment.definition.scope is Scope.DEVICE:
                self._devices[device.name].end_impairment(impairment)
        values = _values(impairment)
        if scheduled.effects:
            values |= {"frames": frames, "frames_affected": affected}
        event = EventReport(EmulatorEvent.IMPAIRMENT_ENDED, str(impairment), values)
        self._transitions.append(event)


_CUT_OFF = ("brown_out", "bus_off")


def _values(impairment: Impairment) -> dict[str, object]:
    values = impairment.as_mapping()
    if impairment.definition.magnitude:
        values["unit"] = impairment.definition.unit
    return values
