"""Carries impairments out: when each begins and ends, on which lines and devices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from msg_schemas.samples import Level
from msg_schemas.transition import Transition
from rover_hil.emulator.device import EmulatedDevice
from rover_hil.emulator.line import ChannelImpairment, Line, Way
from rover_hil.impairment import Impairment, Place


@dataclass
class _Standing:
    """An impairment that was asked for, and is not over."""

    impairment: Impairment
    begins_ns: int
    begun: bool = False
    works: list[tuple[Way, ChannelImpairment]] = field(default_factory=list)

    @property
    def ends_ns(self) -> int | None:
        duration = self.impairment.duration
        return self.begins_ns + round(duration * 1e9) if duration else None


class Impairer:
    """What is wrong with the lines and devices of a machine.

    Args:
        lines: of each device, by its name.
        devices: the same.
    """

    def __init__(self, lines: Mapping[str, Line], devices: Mapping[str, EmulatedDevice]) -> None:
        self._lines = lines
        self._devices = devices
        self._wanted: tuple[Impairment, ...] = ()
        self._standing: list[_Standing] = []
        self._transitions: list[Transition] = []
        self._kills: list[str] = []

    def want(self, wanted: Sequence[Impairment], now_ns: int) -> None:
        """Have these stand and no others; what stands already, and is not over, goes on.

        Args:
            wanted: which.
            now_ns: plant's time, from which they count.
        """
        self._wanted = tuple(wanted)
        before, self._standing = self._standing, []
        for impairment in wanted:
            known = next((each for each in before if each.impairment == impairment), None)
            if known is not None:
                before.remove(known)
            else:
                known = _Standing(impairment, now_ns + round(impairment.at * 1e9))
            self._standing.append(known)
        for gone in before:
            self._end(gone)
        self.step(now_ns)

    def restart(self, now_ns: int) -> None:
        """Time begins anew: so does all that is wanted."""
        wanted = self._wanted
        self.want((), now_ns)
        self.want(wanted, now_ns)

    def step(self, now_ns: int) -> None:
        """Begin and end what is due."""
        for standing in list(self._standing):
            ends_ns, kind = standing.ends_ns, standing.impairment.kind
            if not standing.begun and now_ns >= standing.begins_ns:
                self._begin(standing)
                if kind.place is Place.PROCESS:
                    self._standing.remove(standing)  # done
                    continue
            if ends_ns is not None and now_ns >= ends_ns:
                self._standing.remove(standing)
                self._end(standing)

    @property
    def at_work(self) -> tuple[Impairment, ...]:
        """What has begun and is not over."""
        return tuple(each.impairment for each in self._standing if each.begun)

    def take_transitions(self) -> tuple[Transition, ...]:
        """What has begun and ended since the last call."""
        taken = tuple(self._transitions)
        self._transitions.clear()
        return taken

    def take_kills(self) -> tuple[str, ...]:
        """Kinds of processes to kill, asked for since the last call; who has processes does it."""
        taken = tuple(self._kills)
        self._kills.clear()
        return taken

    # --- beginning and ending --------------------------------------------------------------------

    def _begin(self, standing: _Standing) -> None:
        impairment, standing.begun = standing.impairment, True
        kind = impairment.kind
        self._transitions.append(
            Transition("impairment_began", str(impairment), Level.WARN, _values(impairment))
        )
        if kind.place is Place.PROCESS:
            self._kills.append(impairment.what)
        for device in impairment.devices:
            if kind.place is Place.LINE or impairment.what in _CUT_OFF:
                for way in self._lines[device.name].ways(impairment.way):
                    standing.works.append((way, way.begin(impairment)))
            if kind.place is Place.DEVICE:
                self._devices[device.name].suffer(impairment)

    def _end(self, standing: _Standing) -> None:
        if not standing.begun:
            return
        impairment = standing.impairment
        frames = sum(suffering.frames for _, suffering in standing.works)
        hit = sum(suffering.hit for _, suffering in standing.works)
        for way, suffering in standing.works:
            way.end(suffering)
        for device in impairment.devices:
            if impairment.kind.place is Place.DEVICE:
                self._devices[device.name].recover(impairment)
        values = _values(impairment)
        if standing.works:
            values |= {"frames": frames, "frames_hit": hit}
        self._transitions.append(Transition("impairment_ended", str(impairment), Level.OK, values))


_CUT_OFF = ("brown_out", "bus_off")


def _values(impairment: Impairment) -> dict[str, object]:
    values = impairment.said()
    if impairment.kind.strength:
        values["unit"] = impairment.kind.unit
    return values
