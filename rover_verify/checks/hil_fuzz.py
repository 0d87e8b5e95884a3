"""Fuzzed messages and frames to bridge and emulated machine: none may have an effect."""

from __future__ import annotations

from collections import deque

import numpy as np

from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample
from msg_schemas.table import TOPICS
from rover_hil.canopen.devices import DRIVES
from rover_runtime.admission import Admission, read_message
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.hil_safety import open_bench, winch
from rover_verify.harness.hil_bench import HilBench
from rover_verify.harness.hil_invalid import COMMANDS, Frame, fuzzed_frame, fuzzed_message

NUMBER = 100_000
_PER_CYCLE = 50
_WATCHDOG_CYCLES = 150  # after which every drive without commands is off
_SEEN = 200  # recorded frames, from which corrupted ones are made


def messages(batch: CheckBatch, number: int = NUMBER) -> Measured:
    """Number of fuzzed messages not refused by admission and bridge, or with an effect."""
    generator = np.random.default_rng(batch.seed)
    codes: dict[str, int] = {}
    bad = 0
    with open_bench() as bench:
        bench.arm()
        # All drives have setpoints, so that an accepted message has an effect.
        good = {topic: JointSample(0, joints) for topic, joints in COMMANDS.items()}
        bench.cycles(0.1, good)
        admission, per_cycle = Admission(), max(min(number // _WATCHDOG_CYCLES, _PER_CYCLE), 1)
        for k in range(number):
            if k % per_cycle == 0:
                bench.cycle()
            now_ns = bench.simulation.stamp_ns
            topic, message = fuzzed_message(generator, now_ns)
            row, before = TOPICS[topic], _bridge_state(bench)
            try:
                sample = admission.admit(row, read_message(row, message), now_ns)
                bench.bridge.on_command(topic, sample, now_ns)
            except Refusal as refusal:
                codes[refusal.code.value] = codes.get(refusal.code.value, 0) + 1
            else:
                bad += 1
            bad += _bridge_state(bench) != before
        executed = len([name for name, drive in bench.machine.drives.items() if drive.setpoint])
    return Measured(float(bad + executed), f"{number} messages", dict(sorted(codes.items())))


def _bridge_state(bench: HilBench) -> list[object]:
    """State that a command would change: setpoint and time of the last command."""
    return [
        part
        for channel in bench.bridge.channels.values()
        for part in (channel.setpoint, channel.topic, channel.commanded_ns)
    ]


def frames(batch: CheckBatch, number: int = NUMBER) -> Measured:
    """Number of fuzzed frames that a drive executed or that fed a watchdog.

    They are put on the bus while the winch is driven, and after its bridge has died.

    Raises:
        RuntimeError: the winch was driven in less than half of the cycles with a bridge.
    """
    generator = np.random.default_rng(batch.seed)
    bad = with_bridge = driven = 0
    with open_bench() as bench:
        bench.arm()
        seen: deque[Frame] = deque(maxlen=_SEEN)
        _record_frames(bench, seen)
        for k in range(number):
            if k % _PER_CYCLE == 0:
                # The first half with a bridge, the second half without.
                bench.bridge_is_on = k < number // 2
                bench.cycles(0.005, winch(0.001 * (1 + k % 7)), [])
                with_bridge += bench.bridge_is_on
                driven += bench.bridge_is_on and "winch" in bench.driven
                if bench.bridge_is_on and not bench.bridge.channels["winch"].armed:
                    _rearm(bench)
            before = _drive_state(bench)
            bench.put_on_bus(*fuzzed_frame(generator, seen))
            after = _drive_state(bench)
            bad += any(
                (new[0] is not old[0] and new[0] is not None) or new[1:] != old[1:]
                for old, new in zip(before, after, strict=True)
            )
        active = sum(drive.setpoint is not None for drive in bench.machine.drives.values())
        channels = bench.machine.channels.values()
        invalid = sum(channel.invalid for channel in channels)
    if 2 * driven < with_bridge:
        raise RuntimeError(f"the winch was driven in {driven} of {with_bridge} cycles only")
    details: dict[str, float | str] = {"not decoded": invalid, "cycles driven": driven}
    return Measured(float(bad + active), f"{number} frames", details)


def _drive_state(bench: HilBench) -> list[tuple[object, ...]]:
    """State that a frame would change: setpoint and watchdogs."""
    return [
        (drive.setpoint, drive._watchdog_fed_ns, drive._bridge_heartbeat_ns)
        for drive in bench.machine.drives.values()
    ]


def _record_frames(bench: HilBench, seen: deque[Frame]) -> None:
    """Record the frames from the bridge to the drives."""
    for device in DRIVES:
        channel = bench.bridge.channels[device.name]
        send = channel._send

        def send_and_record(can_id: int, data: bytes, send: object = send) -> None:
            seen.append((can_id, bytes(data)))
            assert callable(send)
            send(can_id, data)

        channel._send = send_and_record


def _rearm(bench: HilBench) -> None:
    bench.cycles(0.2)
    if not bench.bridge.missing_devices(bench.simulation.stamp_ns):
        bench.bridge.arm(bench.simulation.stamp_ns)
