"""A load cell on the link, with the `canopen` library and the EDS file only.

python3 own_load_cell.py INTERFACE CHANNEL      example: socketcan can0
"""

import struct
import sys
import threading
import time
from collections.abc import Callable

import canopen

SYNC_ID, TPDO1_ID = 0x080, 0x180


class OwnLoadCell:
    """Answers each SYNC with the measured tension."""

    def __init__(self, network: canopen.Network, eds: str, read: Callable[[], float]) -> None:
        """Boot; ``read`` returns the tension [N]."""
        self._network, self._read = network, read
        self._dictionary = canopen.import_od(eds)
        self.node = network.create_node(5, self._dictionary)
        self._scale = self._dictionary[0x7130][1].factor  # of one count [N]
        network.subscribe(SYNC_ID, self._on_sync)
        self.node.nmt.send_command(129)  # boot-up message
        self.node.nmt.send_command(128)  # pre-operational, starts the heartbeat

    def _on_sync(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        sampled = time.monotonic_ns()
        if self.node.nmt.state != "OPERATIONAL":
            return
        counts = max(-0x8000, min(round(self._read() / self._scale), 0x7FFF))
        sample_time = sampled // 1000 & 0xFFFFFFFF  # [us]
        reply_delay = min((time.monotonic_ns() - sampled) // 20_000, 0xFF)  # [20 us]
        answer = struct.pack("<IBBh", sample_time, reply_delay, data[0], counts)
        self._network.send_message(TPDO1_ID + self.node.id, answer)


def main() -> None:
    """Run until Ctrl-C, with a constant 12.5 N in place of an amplifier."""
    interface, channel = sys.argv[1:]
    network = canopen.Network()
    network.connect(interface=interface, channel=channel)
    OwnLoadCell(network, "rover_hil/canopen/eds/load_cell.eds", read=lambda: 12.5)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        network.disconnect()


if __name__ == "__main__":
    main()
