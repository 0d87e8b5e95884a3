"""python-can's bus over UDP multicast, without reception of own frames.

python-can sends from the socket that it receives with, so that each end receives its own frames,
which costs a tenth of a core at 200 cycles per second. This bus sends from another port, whose
datagrams the kernel filters out (Linux' classic BPF; elsewhere it receives its own frames, too).
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
import sys
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message

_SO_ATTACH_FILTER = 26  # of Linux, which Python's `socket` does not name
_LOAD_HALF, _LOAD_WORD, _IF_EQUAL, _RETURN = 0x28, 0x20, 0x15, 0x06
_SOURCE_PORT = 0  # in the UDP header, at which the filter's view of a datagram begins
_SOURCE_ADDRESS = 0xFFF0_0000 + 12  # in the IPv4 header (SKF_NET_OFF)
_WHOLE = 0xFFFF


class UdpBus(UdpMulticastBus):
    """A bus over UDP multicast that does not receive its own frames.

    Args:
        channel: IPv4 address of the group.
        port: of the group.
        hop_limit: largest number of network hops.

    Raises:
        can.CanInitializationError: there is no network for that group.
    """

    def __init__(self, channel: str, port: int, hop_limit: int = 1, **kwargs: Any) -> None:
        super().__init__(channel, port, hop_limit, fd=False, **kwargs)
        self._group = channel, port
        try:
            self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hop_limit)
            self._out.bind(("", 0))
            if sys.platform == "linux":
                with socket.socket(fileno=os.dup(self.fileno())) as receiving:
                    _filter_out(receiving, self._own_address(), self._out.getsockname()[1])
        except OSError as error:
            self.shutdown()
            raise can.CanInitializationError(
                f"{channel}:{port}: {error.strerror or error}"
            ) from error

    def _own_address(self) -> str:
        """Source address of frames to the group."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(self._group)
            return str(probe.getsockname()[0])

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to all in the group.

        Raises:
            can.CanOperationError: not a classic CAN frame, or a network error.
        """
        del timeout  # a datagram is sent at once, or not at all
        if msg.is_fd:
            raise can.CanOperationError("a CAN FD frame: this bus carries classic CAN only")
        try:
            self._out.sendto(pack_message(msg), self._group)
        except OSError as error:
            raise can.CanOperationError(f"{self._group}: {error.strerror or error}") from error

    def shutdown(self) -> None:
        """Close the sockets."""
        super().shutdown()
        self._out.close()


def _filter_out(receiving: socket.socket, address: str, port: int) -> None:
    """Filter datagrams from an IPv4 address and port out of a UDP socket."""
    (number,) = struct.unpack("!I", socket.inet_aton(address))
    program = b"".join(
        struct.pack("HBBI", code, if_true, if_false, operand)
        for code, if_true, if_false, operand in (
            (_LOAD_HALF, 0, 0, _SOURCE_PORT),
            (_IF_EQUAL, 0, 3, port),
            (_LOAD_WORD, 0, 0, _SOURCE_ADDRESS),
            (_IF_EQUAL, 0, 1, number),
            (_RETURN, 0, 0, 0),
            (_RETURN, 0, 0, _WHOLE),
        )
    )
    code = ctypes.create_string_buffer(program, len(program))
    # A struct sock_fprog: number and address of the instructions.
    where = struct.pack("HP", len(program) // 8, ctypes.addressof(code))
    receiving.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, where)
