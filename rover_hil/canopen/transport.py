"""Transports of the link, selected by one text.

socketcan:can0                  a CAN interface of Linux
udp_multicast:239.74.163.2      without CAN: on this computer or network
udp_multicast:239.74.163.2:43200
virtual:bench                   within one process
serial:/dev/ttyUSB0             a serial line or pseudo-terminal
serial:/dev/ttyUSB0:921600
"""

from __future__ import annotations

from collections.abc import Callable

import can

from rover_hil.canopen.devices import DEVICES, SYNC_RATE
from rover_hil.canopen.framing import Frame, encode
from rover_hil.canopen.serial_bus import CobsSerialBus
from rover_hil.canopen.udp_bus import UdpBus

_DEFAULT_PORT, _LARGEST_PORT = 43113, 65535
_BITS_PER_BYTE = 10  # of a serial line, with start and stop bit


class TransportError(ValueError):
    """A link that does not exist or cannot be opened."""


def _socketcan(channel: str, number: int | None) -> can.BusABC:
    if number is not None:
        raise TransportError(
            f"socketcan:{channel}:{number}: the bit rate is set with `ip link`, not here"
        )
    return can.Bus(interface="socketcan", channel=channel)


def _udp_multicast(channel: str, number: int | None) -> can.BusABC:
    port = _DEFAULT_PORT if number is None else number
    if not 1 <= port <= _LARGEST_PORT:
        raise TransportError(f"udp_multicast:{channel}:{port}: the port should be 1 to 65535")
    # One hop: this network only.
    return UdpBus(channel, port, hop_limit=1)


def _virtual(channel: str, number: int | None) -> can.BusABC:
    name = channel if number is None else f"{channel}:{number}"
    return can.Bus(interface="virtual", channel=name)


def _serial(channel: str, number: int | None) -> can.BusABC:
    if number is None:
        return CobsSerialBus(channel)
    if number < (needed := _needed_baud()):
        raise TransportError(
            f"serial:{channel}:{number}: the bit rate should be at least {needed}, which the "
            f"devices' answers to SYNC at {SYNC_RATE:g} Hz need"
        )
    return CobsSerialBus(channel, number)


def _needed_baud() -> int:
    """Bit rate of the answers to SYNC on a serial line."""
    answers = (
        Frame(pdo.can_id(device.node_id), b"\x01" * pdo.layout.size)
        for device in DEVICES
        for pdo in device.tpdos
    )
    return round(sum(len(encode(each)) for each in answers) * _BITS_PER_BYTE * SYNC_RATE)


_OPENERS: dict[str, Callable[[str, int | None], can.BusABC]] = {
    "socketcan": _socketcan,
    "udp_multicast": _udp_multicast,
    "virtual": _virtual,
    "serial": _serial,
}


def open_bus(link: str) -> can.BusABC:
    """Open the bus of a text such as `socketcan:can0`.

    Raises:
        TransportError: the text is invalid, or the bus cannot be opened.
    """
    interface, _, rest = link.partition(":")
    channel, _, last = rest.rpartition(":")
    opener = _OPENERS.get(interface)
    if opener is None or not rest:
        known = ", ".join(_OPENERS)
        raise TransportError(
            f"link = {link!r}: should be INTERFACE:CHANNEL with one of {known}, as "
            "'socketcan:can0' or 'udp_multicast:239.74.163.2'"
        )
    try:
        return opener(channel, int(last)) if channel and last.isdecimal() else opener(rest, None)
    except TransportError:
        raise
    except (can.CanError, OSError, ImportError, ValueError, OverflowError) as error:
        raise TransportError(f"link = {link!r} cannot be opened: {error}") from error
