"""SDOs on the emulated devices: resets, malformed requests and responses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import canopen
import pytest

from rover_hil.bridge.commissioning import mismatch
from rover_hil.canopen.devices import SYNC_PERIOD, WINCH
from rover_hil.canopen.dictionary import object_dictionary
from rover_sim import Simulation, build_interface, build_plant, load_spatial
from rover_verify.harness.hil_bench import HilBench


@pytest.fixture
def bench(compiled_in_space: None) -> Iterator[HilBench]:
    plant = build_plant(load_spatial("free_hang", {"sensors.error_model": "ideal"}))
    made = HilBench(Simulation[Any](build_interface(plant, 1), SYNC_PERIOD))
    yield made
    made.close()


def deliver(bench: HilBench, frames: list[tuple[int, bytes]]) -> None:
    for can_id, data in frames:
        bench._bridge_link.send(can_id, data)
    bench.settle()


def responses(bench: HilBench, *requests: bytes) -> list[bytes]:
    """Responses of the winch drive to SDO requests."""
    answers: list[bytes] = []
    bench._bridge_link.network.subscribe(0x583, lambda _id, data, _t: answers.append(bytes(data)))
    for request in requests:
        deliver(bench, [(0x603, request)])
    return answers


READ_OPTION = bytes.fromhex("40 5a 60 00 00 00 00 00")
WRITE_OPTION = bytes.fromhex("2b 5a 60 00 06 00 00 00")


@pytest.mark.parametrize(
    ("command", "left"), [(129, 2), (130, 6)], ids=["reset node", "reset communication"]
)
def test_a_reset_restores_what_was_written_by_sdo(bench: HilBench, command: int, left: int):
    """CiA 301: a reset of the node restores all objects, one of the communication its own."""
    written = responses(bench, WRITE_OPTION, READ_OPTION)
    assert [answer[0] for answer in written] == [0x60, 0x4B]
    assert int.from_bytes(written[1][4:6], "little", signed=True) == 6
    deliver(bench, [(0, bytes([command, 3]))])
    bench.cycles(0.1)
    (answer,) = responses(bench, READ_OPTION)
    assert int.from_bytes(answer[4:6], "little", signed=True) == left


ABORT = 0x80
MALFORMED = {
    "a segment of no download": ("00 00 00 00 00 00 00 00", 0x0504_0001),
    "a segment of no upload": ("60 00 00 00 00 00 00 00", 0x0504_0001),
    "a block download": ("c0 5a 60 00 00 00 00 00", 0x0504_0001),
    "an unknown specifier": ("e0 5a 60 00 00 00 00 00", 0x0504_0001),
    "no object": ("40 ff ff 00 00 00 00 00", 0x0602_0000),
    "no subindex": ("40 5a 60 07 00 00 00 00", 0x0609_0011),
    "a value of the wrong length": ("2f 5a 60 00 06 00 00 00", 0x0607_0010),
    "a read-only object": ("23 00 10 00 00 00 00 00", 0x0601_0002),
}


@pytest.mark.parametrize(("request_hex", "code"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_sdo_is_aborted_without_a_traceback(
    bench: HilBench, caplog: pytest.LogCaptureFixture, request_hex: str, code: int
):
    (answer,) = responses(bench, bytes.fromhex(request_hex))
    assert answer[0] == ABORT
    assert int.from_bytes(answer[4:8], "little") == code
    assert not caplog.records


@pytest.mark.parametrize("length", [0, 1, 3, 7])
def test_an_sdo_of_another_length_is_counted(
    bench: HilBench, caplog: pytest.LogCaptureFixture, length: int
):
    before = bench.machine.channels["winch"].invalid
    assert not responses(bench, bytes(range(0x40, 0x40 + length)))
    assert bench.machine.channels["winch"].invalid == before + 1
    assert not caplog.records


def test_a_download_without_an_end_is_aborted(bench: HilBench):
    begin = bytes.fromhex("21 5a 60 00 ff ff ff 7f")
    segments = [bytes([0x10 * (number % 2), *b"1234567"]) for number in range(100)]
    answers = responses(bench, begin, *segments)
    assert ABORT in [answer[0] for answer in answers]
    assert answers[-1][0] == ABORT


@pytest.mark.parametrize("answer", [b"", b"\x40", b"\x80\0", b"\x4b\x5a\x60", bytes(3), bytes(8)])
def test_a_malformed_response_counts_as_none(answer: bytes):
    class Server:
        """Sends the same response whatever is requested."""

        def __init__(self, node: canopen.RemoteNode) -> None:
            self._node = node

        def send_message(self, _can_id: int, _data: bytes, _remote: bool = False) -> None:
            self._node.sdo.on_response(0x583, bytearray(answer), 0.0)

    node = canopen.RemoteNode(3, object_dictionary(WINCH))
    node.sdo.network = Server(node)
    with pytest.raises(canopen.SdoCommunicationError):
        mismatch(node, WINCH)


class Wire:
    """Network of one end that delivers to the other."""

    def __init__(self, deliver_frame: Any) -> None:
        self._deliver = deliver_frame

    def send_message(self, can_id: int, data: bytes, _remote: bool = False) -> None:
        self._deliver(can_id, bytearray(data), 0.0)


@pytest.mark.parametrize(
    ("index", "subindex", "value", "found"),
    [
        (0x1005, 0, 0x81, "1005h:00"),
        (0x1014, 0, 0x8000_0083, "1014h:00"),  # without emergencies
        (0x1016, 1, 0, "1016h:01"),  # does not watch the bridge's heartbeat
        (0x1019, 0, 0, "1019h:00"),
        (0x605A, 0, 6, "605Ah:00"),
        (0x1600, 0, 2, "1600h:00"),  # a mapping
        (0x1018, 0, 4, ""),  # with a serial number
        (0x1400, 0, 5, ""),  # with an inhibit time
        (0x1800, 0, 6, ""),
    ],
)
def test_what_a_device_must_have_in_common_with_its_dictionary(
    index: int, subindex: int, value: int, found: str
):
    far = canopen.LocalNode(3, object_dictionary(WINCH))
    node = canopen.RemoteNode(3, object_dictionary(WINCH))
    node.sdo.network = Wire(far.sdo.on_request)
    far.sdo.network = Wire(node.sdo.on_response)  # type: ignore[assignment]
    variable = far.object_dictionary.get_variable(index, subindex)
    assert variable is not None
    far.data_store.setdefault(index, {})[subindex] = variable.encode_raw(value)
    assert mismatch(node, WINCH).partition(" ")[0] == found
