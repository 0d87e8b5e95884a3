"""The tape holds what the loop host passes to its listeners, as messages of the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue, TextSample
from rover_runtime.loop_host import LoopHost
from rover_verify.harness.tape import Tape


def test_the_tape_holds_each_sent_sample_with_its_sender_and_time(tmp_path: Path):
    tape, host = Tape(tmp_path / "bag"), LoopHost()
    host.exchange.listen(tape.write)
    host.request(topics.WINCH_MODE, TextSample("hold"), "")
    for _ in range(3):
        host.tick()
        value = {machine.JUMP_SCREW: JointValue(0.1, 0.2, 3.0)}
        host.request(topics.JUMP_MOTOR_COMMAND, JointSample(host.now_ns(), value), "tester")
    tape.close()
    with AnyReader([tmp_path / "bag"]) as reader:
        read: list[tuple[str, int, Any]] = [
            (connection.topic, stamp, reader.deserialize(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
        ]
    mode, *commands = read
    assert mode[0] == f"/{topics.WINCH_MODE}"
    assert mode[2].data == "hold"
    assert [name for name, _, _ in commands] == [f"/{topics.JUMP_MOTOR_COMMAND}"] * 3
    assert {message.header.frame_id for _, _, message in commands} == {"tester"}
    assert [message.header.stamp.nanosec for _, _, message in commands] == [
        10_000_000, 20_000_000, 30_000_000,
    ]  # fmt: skip
    assert [stamp - mode[1] for _, stamp, _ in commands] == [10_000_000, 20_000_000, 30_000_000]
    assert list(commands[0][2].effort) == [3.0]
