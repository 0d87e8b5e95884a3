"""Fuzzed messages and frames against bridge and emulated machine: none may do anything."""

from __future__ import annotations

from collections import deque

import numpy as np

from msg_schemas.admission import Admission
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample
from msg_schemas.table import TOPICS
from rover_hil.devices import DRIVES
from rover_verify.checks import Batch, Measured
from rover_verify.checks.hil_safety import open_bench, winch
from rover_verify.hil_bench import HilBench
from rover_verify.hil_fuzz import COMMANDS, Frame, fuzzed_frame, fuzzed_message

NUMBER = 100_000
_PER_CYCLE = 50
_SILENT_CYCLES = 150  # by then every drive whose watchdog is not fed is off
_SEEN = 200  # frames that damaged ones are made of


def messages(batch: Batch) -> Measured:
    """Of 100 000 fuzzed messages, those that were not refused or changed anything."""
    return fuzz_messages(batch.seed, NUMBER)


def frames(batch: Batch) -> Measured:
    """Of 100 000 fuzzed frames, those that a drive obeyed or that fed a watchdog."""
    return fuzz_frames(batch.seed, NUMBER)


def fuzz_messages(seed: int, number: int) -> Measured:
    """Fuzz as a node would receive it: the contract's admission, then the bridge."""
    generator = np.random.default_rng(seed)
    codes: dict[str, int] = {}
    bad = 0
    with open_bench() as bench:
        bench.arm()
        # All drives at work, so that what is accepted would show; one of them owned.
        good = {topic: JointSample(0, joints) for topic, joints in COMMANDS.items()}
        bench.cycles(0.1, good)
        admission, per_cycle = Admission(), max(min(number // _SILENT_CYCLES, _PER_CYCLE), 1)
        for k in range(number):
            if k % per_cycle == 0:
                bench.cycle()
            now_ns = bench.simulation.stamp_ns
            topic, message = fuzzed_message(generator, now_ns)
            before = _of_bridge(bench)
            try:
                sample = admission.admit(TOPICS[topic], message, now_ns)
                bench.bridge.on_command(topic, sample, now_ns)
            except Refusal as refusal:
                codes[refusal.code.value] = codes.get(refusal.code.value, 0) + 1
            else:
                bad += 1
            bad += _of_bridge(bench) != before
        executed = len([name for name, drive in bench.machine.drives.items() if drive.setpoint])
    return Measured(float(bad + executed), f"{number} messages", dict(sorted(codes.items())))


def _of_bridge(bench: HilBench) -> list[object]:
    """What a command would change: each drive's set-point, and what feeds its watchdog."""
    return [
        part
        for channel in bench.bridge.channels.values()
        for part in (channel.setpoint, channel.topic, channel.commanded_ns)
    ]


def fuzz_frames(seed: int, number: int) -> Measured:
    """Fuzz on the bus while a winch is driven, and a while after its bridge has died."""
    generator = np.random.default_rng(seed)
    bad = 0
    with open_bench() as bench:
        bench.arm()
        seen: deque[Frame] = deque(maxlen=_SEEN)
        _listen(bench, seen)
        for k in range(number):
            if k % _PER_CYCLE == 0:
                # The first half with a bridge at work, the second one without any.
                bench.bridge_is_on = k < number // 2
                bench.cycles(0.005, winch(0.001 * (1 + k % 7)), [])
                if bench.bridge_is_on and not any(
                    channel.armed for channel in bench.bridge.channels.values()
                ):
                    _rearm(bench)
            before = _of_drives(bench)
            bench.put_on_bus(*fuzzed_frame(generator, seen))
            after = _of_drives(bench)
            bad += any(
                (new[0] is not old[0] and new[0] is not None) or new[1:] != old[1:]
                for old, new in zip(before, after, strict=True)
            )
        at_work = sum(drive.setpoint is not None for drive in bench.machine.drives.values())
        lines = bench.machine.channels.values()
        strange = sum(line.invalid for line in lines)
    details: dict[str, float | str] = {"not understood": strange}
    return Measured(float(bad + at_work), f"{number} frames", details)


def _of_drives(bench: HilBench) -> list[tuple[object, ...]]:
    """What a frame would change: the set-point, and what feeds the watchdogs."""
    return [
        (drive.setpoint, drive._watchdog_fed_ns, drive._bridge_heartbeat_ns)
        for drive in bench.machine.drives.values()
    ]


def _listen(bench: HilBench, seen: deque[Frame]) -> None:
    """Note what the bridge sends to the drives."""
    for device in DRIVES:
        channel = bench.bridge.channels[device.name]
        send = channel._send

        def noted(can_id: int, data: bytes, send: object = send) -> None:
            seen.append((can_id, bytes(data)))
            assert callable(send)
            send(can_id, data)

        channel._send = noted


def _rearm(bench: HilBench) -> None:
    bench.cycles(0.2)
    if not bench.bridge.missing_devices(bench.simulation.stamp_ns):
        bench.bridge.arm(bench.simulation.stamp_ns)
