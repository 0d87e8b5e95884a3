"""Codecs: conversion between typed samples and the bytes of messages, with the table's checks.

``pack`` and ``unpack`` are pure, and need neither rclpy nor the message packages. Both check every
number for finiteness and against its limits, so that a bad value is neither sent nor accepted.

The values of a message are those of its layout's parts (`msg_schemas.layouts`): all checks apply to
them, whether they come from a sample or from bytes.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.checks import (
    check_age,
    check_frame,
    check_joint_names,
    check_numbers,
    check_orientation,
    check_text,
)
from msg_schemas.layouts import HEADER, LAYOUTS, CdrError, Template
from msg_schemas.machine import WORLD_FRAME
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    IDENTITY,
    TETHER_COLUMNS,
    ZERO,
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    Level,
    OdometrySample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Sample,
    Shape,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
    TwistSample,
    WrenchSample,
)
from msg_schemas.specifications import Topic
from msg_schemas.table import find_topic
from msg_schemas.text_limits import LONGEST_STATUS, cut

_PARTS: Final = JointValue._fields
_FLOAT64: Final = 8  # of sensor_msgs/PointField
_NODE: Final = 8 * len(TETHER_COLUMNS)  # bytes
_AXES: Final = 6  # of a pose
_COVARIANCE: Final = _AXES**2
_MAX_TEMPLATES: Final = 64

Values = Sequence[Any]


def pack(name: str, sample: Sample, frame_id: str = "") -> bytes:
    """Turn a sample into the topic's serialized message.

    Args:
        name: topic name, relative, as in the table.
        sample: of the topic's type.
        frame_id: of the message's header; empty = the topic's frame.

    Raises:
        Refusal: a value is not finite, out of limits, or not of this topic.
    """
    return _codec(name).pack(sample, frame_id)


def unpack(name: str, data: bytes, now_ns: int | None = None) -> Any:
    """Turn a serialized message into the topic's sample.

    Args:
        name: topic name, relative, as in the table.
        data: the message in little-endian CDR, with its header of 4 bytes.
        now_ns: receiver's clock [ns]; if given, the message's age is checked too.

    Raises:
        Refusal: bytes that are no such message, bad number, wrong joint, bad text, too old ...
    """
    codec = _codec(name)
    sample = codec.unpack(data)
    return sample if now_ns is None else check_age(codec.topic, sample, now_ns)


def check(name: str, sample: Sample) -> None:
    """Refuse a sample that ``pack`` refuses.

    Raises:
        Refusal: as ``pack``.
    """
    _codec(name).pack(sample, "")


class Header(NamedTuple):
    """Header of a message: stamp of the publisher's clock [ns] and frame."""

    stamp_ns: int
    frame_id: str


def header(name: str, data: bytes) -> Header:
    """Return the header of a serialized message, of a type that begins with one.

    Raises:
        Refusal: the bytes are no such message.
    """
    try:
        return Header(*HEADER.parse(data, whole=False))
    except CdrError as error:
        raise _malformed(find_topic(name), error) from None


def template(name: str, data: bytes) -> Template | None:
    """Return the template by which messages like a valid one are read; None: they have none.

    Raises:
        Refusal: as `unpack`.
    """
    return _codec(name).template(data)


def _malformed(topic: Topic, error: CdrError) -> Refusal:
    return Refusal(topic.name, RefusalCode.MALFORMED, f"no {topic.message}: {error}")


class _Codec:
    """Conversion between one topic's samples and messages.

    This base class serves messages with a header whose named parts are the sample's attributes.
    """

    repeats = True  # most messages differ in their numbers only

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self._layout = LAYOUTS[topic.message]
        self._written: dict[Hashable, Template] = {}
        self._read: dict[int, Template] = {}  # by the length of the messages
        places = {part.name: at for at, part in enumerate(self._layout.parts) if part.name}
        sample_type: Any = topic.sample
        attributes = [each.name for each in dataclasses.fields(sample_type)]
        self._attributes = [(name, places[name]) for name in attributes if name in places]
        self._blank = self._layout.blank.copy()

    def pack(self, sample: Any, frame_id: str) -> bytes:
        """Serialize a sample."""
        topic = self.topic
        if not isinstance(sample, topic.sample):
            raise Refusal(
                topic.name,
                RefusalCode.WRONG_TYPE,
                f"got a {type(sample).__name__}, this topic carries {topic.sample.__name__}",
            )
        values = self.values(sample, frame_id or topic.frame)
        key = (frame_id, self.constants(sample))
        known = self._written.get(key)
        if known is not None:
            data = known.serialize(values)
            if data is not None:
                self.check_together(values)
                return data
        self._check(values)
        try:
            data = self._layout.serialize(values)
        except CdrError as error:
            raise _malformed(topic, error) from None
        if self.repeats:
            self._remember(self._written, key, self._template(data, values, reads=False))
        return data

    def unpack(self, data: bytes) -> Any:
        """Read a message."""
        known = self._read.get(len(data))
        values = None if known is None else known.parse(data)
        if values is not None:
            self.check_together(values)
            return self.sample(values)
        try:
            values = self._layout.parse(data)
        except CdrError as error:
            raise _malformed(self.topic, error) from None
        self._check(values)
        if self.repeats:
            self._remember(self._read, len(data), self._template(data, values, reads=True))
        return self.sample(values)

    def template(self, data: bytes) -> Template | None:
        """Return the template of a valid message."""
        self.unpack(data)
        return self._read.get(len(data))

    def _check(self, values: Values) -> None:
        self.check_constants(values)
        check_numbers(self.topic, self.numbers(values))
        self.check_together(values)

    def _template(self, data: bytes, values: Values, *, reads: bool) -> Template:
        paths = [path for path, _ in self.numbers(values)]
        return Template(self._layout, data, paths, self.topic.by_path, reads=reads)

    @staticmethod
    def _remember(known: dict[Any, Template], key: Hashable, made: Template) -> None:
        if len(known) >= _MAX_TEMPLATES:
            known.clear()
        known[key] = made

    # --- what sample types override --------------------------------------------------------------

    def values(self, sample: Any, frame_id: str, /) -> list[Any]:
        """Turn a sample into the values of its message."""
        values = self._blank.copy()
        values[1] = frame_id
        for name, at in self._attributes:
            values[at] = getattr(sample, name)
        return values

    def sample(self, values: Values) -> Any:
        """Turn the values of a message into its sample."""
        return self.topic.sample(*[values[at] for _, at in self._attributes])

    def constants(self, sample: Any) -> Hashable:
        """Return what the messages of a template have in common besides the frame."""

    def check_constants(self, values: Values) -> None:
        """Refuse frames, names and lengths that are not those of the topic."""
        check_frame(self.topic, values[1], self.topic.frame)

    def numbers(self, values: Values) -> Iterable[tuple[str, float]]:
        """Field path and value of each number of the sample, in the message's order."""
        return self._layout.numbers(values)

    def check_together(self, values: Values) -> None:
        """Refuse what the limits of single numbers do not."""


class _Clocks(_Codec):
    def values(self, sample: ClockSample, _frame_id: str) -> list[Any]:
        return [sample.stamp_ns]

    def check_constants(self, values: Values) -> None:
        pass

    def check_together(self, values: Values) -> None:
        check_numbers(self.topic, (("clock", values[0] * 1e-9),))


class _Joints(_Codec):
    def values(self, sample: JointSample, frame_id: str) -> list[Any]:
        joints = sample.joints
        columns = zip(*joints.values(), strict=True) if joints else ((), (), ())
        return [sample.stamp_ns, frame_id, tuple(joints), *columns]

    def sample(self, values: Values) -> JointSample:
        stamp_ns, _, names, *columns = values
        if not all(columns):
            columns = [
                column or [self._default(name, part) for name in names]
                for column, part in zip(columns, _PARTS, strict=True)
            ]
        return JointSample(stamp_ns, dict(zip(names, map(JointValue, *columns), strict=True)))

    def constants(self, sample: JointSample) -> Hashable:
        return tuple(sample.joints)

    def check_constants(self, values: Values) -> None:
        names = values[2]
        check_joint_names(self.topic, names)
        for part, column in zip(_PARTS, values[3:], strict=True):
            optional = all(self._default(name, part) is not None for name in names)
            if len(column) != len(names) and (column or not optional):
                raise Refusal(
                    self.topic.name,
                    RefusalCode.WRONG_LENGTH,
                    f"{part} has {len(column)} values for {len(names)} joints, "
                    f"it must have {len(names)}",
                )

    def numbers(self, values: Values) -> Iterable[tuple[str, float]]:
        for part, column in zip(_PARTS, values[3:], strict=True):
            yield from ((f"{n}.{part}", v) for n, v in zip(values[2], column, strict=False))

    def _default(self, name: str, part: str) -> float | None:
        return self.topic.by_path[f"{name}.{part}"].default


class _Poses(_Codec):
    may_be_open = True
    orientation_at = 3

    def check_together(self, values: Values) -> None:
        orientation = values[self.orientation_at]
        check_orientation(self.topic, orientation, may_be_open=self.may_be_open)


class _PoseEstimates(_Poses):
    covariance_at = 4

    def values(self, sample: PoseEstimateSample | OdometrySample, frame_id: str) -> list[Any]:
        values = super().values(sample, frame_id)
        given = sample.pose_covariance
        if given and len(given) != _COVARIANCE:
            raise Refusal(
                self.topic.name,
                RefusalCode.WRONG_LENGTH,
                f"pose_covariance has {len(given)} values, it must have {_COVARIANCE} or none",
            )
        values[self.covariance_at] = given or self._blank[self.covariance_at]
        return values

    def sample(self, values: Values) -> Any:
        values = list(values)
        if not any(values[self.covariance_at]):
            values[self.covariance_at] = ()
        return super().sample(values)

    def check_together(self, values: Values) -> None:
        super().check_together(values)
        variances = values[self.covariance_at][:: _AXES + 1]
        if any(value < 0.0 for value in variances):
            raise Refusal(
                self.topic.name,
                RefusalCode.OUT_OF_LIMITS,
                f"pose_covariance has the variances {variances}, they must be at least 0",
            )


class _Odometry(_PoseEstimates):
    may_be_open = False
    orientation_at = 4
    covariance_at = 5

    def values(self, sample: PoseEstimateSample | OdometrySample, frame_id: str) -> list[Any]:
        values = super().values(sample, frame_id)
        values[2] = self.topic.child_frame
        return values

    def check_constants(self, values: Values) -> None:
        super().check_constants(values)
        check_frame(self.topic, values[2], self.topic.child_frame, "child_frame_id")


class _Imus(_Codec):
    def __init__(self, topic: Topic) -> None:
        super().__init__(topic)
        # sensor_msgs/Imu: -1 in the orientation's covariance means that there is none.
        self._blank[2:4] = IDENTITY, (-1.0, *self._blank[3][1:])


class _Tethers(_Codec):
    fields = tuple((name, (8 * at,), (_FLOAT64,), (1,)) for at, name in enumerate(TETHER_COLUMNS))

    def values(self, sample: TetherSample, frame_id: str) -> list[Any]:
        nodes = sample.nodes
        if nodes.ndim != 2 or nodes.shape[1] != len(TETHER_COLUMNS):
            raise Refusal(
                self.topic.name,
                RefusalCode.WRONG_LENGTH,
                f"nodes have shape {nodes.shape}, it must be (n + 1, {len(TETHER_COLUMNS)})",
            )
        count, data = len(nodes), np.ascontiguousarray(nodes, dtype="<f8").tobytes()
        steps = (_NODE, _NODE * count)
        return [
            sample.stamp_ns, frame_id, (1, count), self.fields, (False,), steps, (data,), (True,),
        ]  # fmt: skip

    def sample(self, values: Values) -> TetherSample:
        return TetherSample(values[0], _nodes(values))

    def constants(self, sample: TetherSample) -> Hashable:
        return len(sample.nodes)

    def check_constants(self, values: Values) -> None:
        super().check_constants(values)
        _, _, (height, width), fields, (is_big,), (point_step, _), (data,), _ = values
        names = tuple(name for name, *_ in fields)
        plain = all(kind == (_FLOAT64,) and count == (1,) for _, _, kind, count in fields)
        if names != TETHER_COLUMNS or not plain or is_big:
            raise Refusal(
                self.topic.name,
                RefusalCode.WRONG_NAME,
                f"fields are {names}, they must be {TETHER_COLUMNS}, little-endian FLOAT64",
            )
        expected = width * height * _NODE
        if point_step != _NODE or len(data) != expected or not expected:
            raise Refusal(
                self.topic.name,
                RefusalCode.WRONG_LENGTH,
                f"data has {len(data)} bytes at point step {point_step}, it must have "
                f"{expected} at {_NODE}",
            )

    def check_together(self, values: Values) -> None:
        nodes = _nodes(values)
        for extremes in (nodes.min(axis=0), nodes.max(axis=0)):
            check_numbers(self.topic, zip(TETHER_COLUMNS, extremes.tolist(), strict=True))


def _nodes(values: Values) -> NDArray[np.float64]:
    return np.frombuffer(values[6][0], dtype="<f8").reshape(-1, len(TETHER_COLUMNS))


class _Paths(_Codec):
    repeats = False

    def values(self, sample: PathSample, frame_id: str) -> list[Any]:
        poses = [(p.stamp_ns, frame_id, p.position, p.orientation) for p in sample.poses]
        return [sample.stamp_ns, frame_id, poses]

    def sample(self, values: Values) -> PathSample:
        return PathSample(values[0], tuple(PoseSample(ns, p, q) for ns, _, p, q in values[2]))

    def check_constants(self, values: Values) -> None:
        super().check_constants(values)
        for _, frame, _, _ in values[2]:
            check_frame(self.topic, frame, self.topic.frame)

    def numbers(self, values: Values) -> Iterable[tuple[str, float]]:
        for _, _, position, orientation in values[2]:
            yield from PoseSample(0, position, orientation).scalars()

    def check_together(self, values: Values) -> None:
        for *_, orientation in values[2]:
            check_orientation(self.topic, orientation, may_be_open=True)


class _Texts(_Codec):
    repeats = False

    def values(self, sample: TextSample, _frame_id: str) -> list[Any]:
        return [sample.text]

    def sample(self, values: Values) -> TextSample:
        return TextSample(*values)

    def check_constants(self, values: Values) -> None:
        check_text(self.topic, values[0])


class _Statuses(_Codec):
    repeats = False

    def values(self, sample: StatusSample, frame_id: str) -> list[Any]:
        statuses = [
            (
                (each.level,), each.name, cut(each.message, LONGEST_STATUS), each.hardware_id,
                [(key, cut(value, LONGEST_STATUS)) for key, value in each.values.items()],
            )
            for each in sample.statuses
        ]  # fmt: skip
        return [sample.stamp_ns, frame_id, statuses]

    def sample(self, values: Values) -> StatusSample:
        statuses = tuple(
            Status(name, message, Level(level), hardware_id, dict(pairs))
            for (level,), name, message, hardware_id, pairs in values[2]
        )
        return StatusSample(values[0], statuses)

    def check_constants(self, values: Values) -> None:
        super().check_constants(values)
        for (level,), *_ in values[2]:
            if level > max(Level):
                reason = f"level is {level}, it must be 0 .. {max(Level)}"
                raise Refusal(self.topic.name, RefusalCode.OUT_OF_LIMITS, reason)


# visualization_msgs/Marker: ARROW, CUBE, SPHERE, CYLINDER, LINE_STRIP, TRIANGLE_LIST.
_MARKER_TYPES = {"arrow": 0, "box": 1, "sphere": 2, "cylinder": 3, "line": 4, "triangles": 11}
_MARKER_KINDS = {number: kind for kind, number in _MARKER_TYPES.items()}
_ADD, _DELETE_ALL = 0, 3
# Texture, text and mesh of a marker, which no shape has.
_NO_TEXTURE = ("", (0, "", "", (b"",)), (), "", "", ("", (b"",)), (False,))
_CLEARING = (
    WORLD_FRAME, "", (0, 0, _DELETE_ALL), ZERO, IDENTITY, ZERO, (0.0, 0.0, 0.0, 0.0), (0, 0),
    (False,), (), (), *_NO_TEXTURE,
)  # fmt: skip


class _Drawings(_Codec):
    """A drawing replaces the one before: viewers keep each marker until it is deleted."""

    repeats = False

    def values(self, sample: DrawingSample, _frame_id: str) -> list[Any]:
        shapes = [
            (
                sample.stamp_ns, shape.frame, shape.namespace,
                (number, _MARKER_TYPES[shape.kind], _ADD), shape.position, shape.orientation,
                shape.size, shape.colour, (0, 0), (False,), shape.points, shape.colours,
                *_NO_TEXTURE,
            )
            for number, shape in enumerate(sample.shapes)
        ]  # fmt: skip
        return [[(sample.stamp_ns, *_CLEARING), *shapes]]

    def sample(self, values: Values) -> DrawingSample:
        (markers,) = values
        shapes = tuple(
            Shape(
                namespace, _MARKER_KINDS[kind], frame, colour, size, points, position, orientation,
                colours,
            )
            for (
                _, frame, namespace, (_, kind, action), position, orientation, size, colour, _, _,
                points, colours, *_,
            ) in markers
            if action == _ADD
        )  # fmt: skip
        return DrawingSample(markers[0][0] if markers else 0, shapes)

    def check_constants(self, values: Values) -> None:
        for marker in values[0]:
            kind = marker[3][1]
            if kind not in _MARKER_KINDS:
                reason = f"marker type is {kind}, it must be one of {sorted(_MARKER_KINDS)}"
                raise Refusal(self.topic.name, RefusalCode.WRONG_TYPE, reason)
            if _MARKER_KINDS[kind] == "triangles" and len(marker[10]) % 3:
                reason = f"triangles have {len(marker[10])} points, it must be 3 for each"
                raise Refusal(self.topic.name, RefusalCode.WRONG_LENGTH, reason)

    def numbers(self, values: Values) -> Iterable[tuple[str, float]]:
        for marker in values[0]:
            for point in (marker[4], marker[6], *marker[10]):
                for value in point:
                    yield "drawing", value


_CODECS: Final[Mapping[type[Any], type[_Codec]]] = MappingProxyType(
    {
        ClockSample: _Clocks,
        DrawingSample: _Drawings,
        ImuSample: _Imus,
        JointSample: _Joints,
        OdometrySample: _Odometry,
        PathSample: _Paths,
        PoseEstimateSample: _PoseEstimates,
        PoseSample: _Poses,
        StatusSample: _Statuses,
        TetherSample: _Tethers,
        TextSample: _Texts,
        TwistSample: _Codec,
        WrenchSample: _Codec,
    }
)


@functools.cache
def _codec(name: str) -> _Codec:
    topic = find_topic(name)
    return _CODECS[topic.sample](topic)
