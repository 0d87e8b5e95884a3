"""Random invalid messages and frames, which must have no effect.

A fuzzed message is a valid command with errors. A fuzzed frame is noise, or a frame recorded on the
link with a corruption that its checksum would not detect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.layouts import LAYOUTS
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.specifications import Topic
from msg_schemas.table import TOPICS
from rover_hil.canopen.devices import BRIDGE_NODE, DRIVES
from rover_hil.canopen.link import HEARTBEAT_ID, SYNC_ID

_LAYOUT = LAYOUTS["sensor_msgs/msg/JointState"]
PARTS = ("position", "velocity", "effort")
Generator = np.random.Generator
Frame = tuple[int, bytes]

COMMANDS: dict[str, dict[str, JointValue]] = {
    topics.WINCH_COMMAND: {
        machine.WINCH_DRUM: JointValue(20.0, 0.3, 16.2),
        machine.WINCH_BRAKE: JointValue(1.0),
        machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
    },
    topics.WHEEL_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 2.0, 1.0)},
    topics.WHEEL_TORQUE_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, 0.2)},
    topics.FLYWHEEL_COMMAND: {machine.FLYWHEEL: JointValue(0.0, 0.0, 0.05)},
    topics.JUMP_MOTOR_COMMAND: {machine.JUMP_SCREW: JointValue(-0.01, 0.02, 100.0)},
}
"""A valid command of each drive, by topic."""

_NAMES = ("", "winch_drum ", "WINCH_DRUM", "drum", "jump_screw\n", "\u202e", "x" * 300, "ÿ")
_NANO = 1_000_000_000


@dataclass
class JointMessage:
    """Content of a JointState message.

    Attributes:
        stamp_ns, frame_id: its header.
        name, position, velocity, effort: its arrays.
    """

    stamp_ns: int
    frame_id: str
    name: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]

    @classmethod
    def of(cls, sample: JointSample, frame_id: str = "") -> JointMessage:
        """Return the message of a sample."""
        columns = ([getattr(v, part) for v in sample.joints.values()] for part in PARTS)
        return cls(sample.stamp_ns, frame_id, list(sample.joints), *columns)

    def serialized(self) -> bytes:
        """Return its bytes."""
        return _LAYOUT.serialize(list(vars(self).values()))


# ----------------------------------------------------------------------------------------- messages


def fuzzed_message(generator: Generator, now_ns: int) -> tuple[str, bytes]:
    """Topic and serialized message of a command with one to three errors.

    Args:
        generator: random number generator.
        now_ns: stamp of a valid command.
    """
    topic = str(generator.choice(list(COMMANDS)))
    sender = str(generator.choice(["", "/winch_node#1", "/stranger#2"]))
    message = JointMessage.of(JointSample(now_ns, COMMANDS[topic]), sender)
    # Each error at most once: a second one could undo the first.
    errors = (*ERRORS.values(), _joint_twice, _no_joint, _unstamped)
    for kind in generator.permutation(len(errors))[: int(generator.integers(1, 4))]:
        errors[int(kind)](generator, TOPICS[topic], message, now_ns)
    return topic, message.serialized()


def _not_finite(generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    part = PARTS[int(generator.integers(3))]
    numbers = list(getattr(message, part)) or [0.0]
    numbers[0] = float(generator.choice([math.nan, math.inf, -math.inf]))
    setattr(message, part, numbers)
    return f"{message.name[0]}.{part}" if message.name else ""


def _out_of_limits(generator: Generator, row: Topic, message: JointMessage, _now_ns: int) -> str:
    limited = [
        (index, part, field)
        for index, joint in enumerate(message.name)
        for part in PARTS
        if (field := row.by_path.get(f"{joint}.{part}")) is not None
        and math.isfinite(field.minimum)
        and math.isfinite(field.maximum)
        and index < len(getattr(message, part))
    ]
    if not limited:  # by an error before
        return ""
    index, part, field = limited[int(generator.integers(len(limited)))]
    beyond = float(10.0 ** generator.uniform(-3.0, 6.0))
    is_above = generator.random() < 0.5
    numbers = list(getattr(message, part))
    numbers[index] = field.maximum + beyond if is_above else field.minimum - beyond
    setattr(message, part, numbers)
    return f"{message.name[index]}.{part}"


def _wrong_name(generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    letters = "".join(generator.choice(list("abcdefgh"), 6))
    is_plain = bool(generator.random() < 0.5)
    names = list(message.name) or [""]
    wrong = letters if is_plain else _NAMES[int(generator.integers(len(_NAMES)))]
    names[int(generator.integers(len(names)))] = wrong
    message.name = names
    return letters if is_plain else ""


def _wrong_length(generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    part = PARTS[int(generator.integers(3))]
    numbers = list(getattr(message, part))
    longer = [*numbers, *generator.normal(size=int(generator.integers(1, 50))).tolist()]
    # An empty array is valid: all its numbers are zero.
    is_longer = len(numbers) < 2 or generator.random() < 0.5
    setattr(message, part, longer if is_longer else numbers[:-1])
    return part


def _stale(generator: Generator, row: Topic, message: JointMessage, now_ns: int) -> str:
    age = row.stale.max_age + 10.0 ** float(generator.uniform(-3.0, 9.0))
    message.stamp_ns = max(now_ns - round(age * _NANO), -(2**31) * _NANO)
    return "ago"


def _from_the_future(generator: Generator, row: Topic, message: JointMessage, now_ns: int) -> str:
    lead = row.stale.max_lead + 10.0 ** float(generator.uniform(-3.0, 8.0))
    message.stamp_ns = now_ns + round(lead * _NANO)
    return "ahead"


Error = Callable[[Generator, Topic, JointMessage, int], str]
"""Makes a message invalid; returns a word that the refusal must contain."""
ERRORS: Mapping[RefusalCode, Error] = {
    RefusalCode.NOT_FINITE: _not_finite,
    RefusalCode.OUT_OF_LIMITS: _out_of_limits,
    RefusalCode.WRONG_NAME: _wrong_name,
    RefusalCode.WRONG_LENGTH: _wrong_length,
    RefusalCode.STALE: _stale,
    RefusalCode.FROM_THE_FUTURE: _from_the_future,
}
"""An error for each code with which it is refused."""


def _joint_twice(generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    message.name = [*message.name, *list(message.name)[:1]] or ["", ""]
    if generator.random() < 0.5:
        for part in PARTS:
            setattr(message, part, [*getattr(message, part), 0.0])
    return ""


def _no_joint(_generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    message.name = []
    for part in PARTS:
        setattr(message, part, [])
    return ""


def _unstamped(_generator: Generator, _row: Topic, message: JointMessage, _now_ns: int) -> str:
    message.stamp_ns = 0
    return ""


# ------------------------------------------------------------------------------------------- frames


def fuzzed_frame(generator: Generator, seen: Sequence[Frame]) -> Frame:
    """A random or corrupted frame; never a valid heartbeat of the bridge.

    Args:
        generator: random number generator.
        seen: frames recorded on the link.
    """
    while True:
        frame = _fuzzed_frame(generator, seen)
        if frame not in seen and frame != (HEARTBEAT_ID + BRIDGE_NODE, b"\x05"):
            return frame


def _fuzzed_frame(generator: Generator, seen: Sequence[Frame]) -> Frame:
    kind = generator.random()
    if seen and kind < 0.4:
        can_id, data = seen[int(generator.integers(len(seen)))]
        return _damaged(generator, can_id, bytearray(data))
    data = generator.bytes(int(generator.integers(0, 9)))
    if kind < 0.7:
        drive = DRIVES[int(generator.integers(len(DRIVES)))]
        pdo = drive.rpdos[int(generator.integers(len(drive.rpdos)))]
        return pdo.can_id(drive.node_id), data if generator.random() < 0.3 else generator.bytes(8)
    if kind < 0.8:
        drive = DRIVES[int(generator.integers(len(DRIVES)))]
        return 0x600 + drive.node_id, generator.bytes(8)
    if kind < 0.85:
        control = (0, SYNC_ID, HEARTBEAT_ID + BRIDGE_NODE)
        return control[int(generator.integers(len(control)))], data
    return int(generator.integers(0x800)), data


def _damaged(generator: Generator, can_id: int, data: bytearray) -> Frame:
    how = generator.random()
    if how < 0.15:
        return can_id, bytes(data[: int(generator.integers(len(data) + 1))])
    if how < 0.3:
        return int(generator.integers(0x800)), bytes(data)
    for _ in range(int(generator.integers(1, 6))):
        if data:
            data[int(generator.integers(len(data)))] ^= 1 << int(generator.integers(8))
    return can_id, bytes(data)
