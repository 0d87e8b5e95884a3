"""One good sample for every topic of the table, and hypothesis strategies for more."""

import json
from typing import Any

import numpy as np
from hypothesis import strategies as st

from msg_schemas.samples import (
    NO_ORIENTATION,
    TETHER_COLUMNS,
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
    Shape,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
    TwistSample,
    WrenchSample,
)
from msg_schemas.specifications import Field, Topic

STAMP_NS = 12_345_678_901


def number(row: Field) -> st.SearchStrategy[float]:
    low, high = max(row.minimum, -1e12), min(row.maximum, 1e12)
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def vector(topic: Topic, prefix: str) -> st.SearchStrategy[Any]:
    return st.tuples(*(number(topic.by_path[f"{prefix}.{axis}"]) for axis in "xyz"))


def unit_quaternion() -> st.SearchStrategy[Any]:
    part = st.floats(-1.0, 1.0).map(lambda x: x if abs(x) > 1e-3 else 0.5)

    def normalise(parts: tuple[float, ...]) -> tuple[float, ...]:
        norm = float(np.linalg.norm(parts))
        return tuple(component / norm for component in parts)

    return st.tuples(part, part, part, part).map(normalise)


def stamps() -> st.SearchStrategy[int]:
    return st.integers(1, 2**31 * 1_000_000_000 - 1)


def joint_names(topic: Topic) -> list[tuple[str, ...]]:
    """Each set of joints that a message of the topic may name."""
    if topic.one_joint:
        return [(name,) for name in topic.joints]
    return list(dict.fromkeys([topic.joints, (*topic.joints, *topic.optional_joints)]))


def joint_samples(topic: Topic, names: tuple[str, ...]) -> st.SearchStrategy[Any]:
    """Good samples of these joints."""
    joints = {
        name: st.builds(
            JointValue,
            *(number(topic.by_path[f"{name}.{p}"]) for p in ("position", "velocity", "effort")),
        )
        for name in names
    }
    return st.builds(JointSample, stamps(), st.fixed_dictionaries(joints))


def poses(topic: Topic) -> st.SearchStrategy[Any]:
    """Good poses, with and without an orientation."""
    turned = st.one_of(unit_quaternion(), st.just(NO_ORIENTATION))
    return st.builds(PoseSample, stamps(), vector(topic, "position"), turned)


def samples_of(topic: Topic) -> st.SearchStrategy[Any]:
    """Good samples of any topic."""
    kind = topic.sample
    if kind is JointSample:
        return st.one_of(*(joint_samples(topic, names) for names in joint_names(topic)))
    if kind is OdometrySample:
        variances = st.lists(st.floats(0.1, 1e3), min_size=36, max_size=36).map(tuple)
        return st.builds(
            OdometrySample,
            stamps(),
            vector(topic, "position"),
            unit_quaternion(),
            vector(topic, "linear"),
            vector(topic, "angular"),
            st.one_of(st.just(()), variances),
        )
    if kind is PoseEstimateSample:
        variances = st.lists(st.floats(0.1, 1e3), min_size=36, max_size=36).map(tuple)
        return st.builds(
            PoseEstimateSample,
            stamps(),
            vector(topic, "position"),
            unit_quaternion(),
            st.one_of(st.just(()), variances),
        )
    if kind is PoseSample:
        return poses(topic)
    if kind is PathSample:
        return st.builds(PathSample, stamps(), st.lists(poses(topic), max_size=3).map(tuple))
    if kind is TwistSample:
        return st.builds(TwistSample, stamps(), vector(topic, "linear"), vector(topic, "angular"))
    if kind is ImuSample:
        return st.builds(
            ImuSample,
            stamps(),
            vector(topic, "angular_velocity"),
            vector(topic, "linear_acceleration"),
        )
    if kind is WrenchSample:
        return st.builds(WrenchSample, stamps(), vector(topic, "force"), vector(topic, "torque"))
    if kind is TetherSample:
        return st.builds(
            lambda stamp, rows: TetherSample(stamp, np.array(rows)),
            stamps(),
            st.lists(
                st.tuples(*(number(topic.by_path[c]) for c in TETHER_COLUMNS)),
                min_size=2,
                max_size=6,
            ),
        )
    if kind is TextSample:
        if topic.is_json:
            contents = st.dictionaries(st.text(max_size=5), st.integers(), max_size=3)
            return contents.map(lambda content: TextSample(json.dumps(content)))
        if topic.words:
            return st.sampled_from(topic.words).map(TextSample)
        return st.text(st.characters(codec="utf-8", exclude_characters="\0")).map(TextSample)
    if kind is ClockSample:
        return st.builds(ClockSample, stamps())
    if kind is StatusSample:
        words = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8)
        values = st.dictionaries(words, words, max_size=3)
        status = st.builds(Status, words, words, st.sampled_from(Level), words, values)
        return st.builds(StatusSample, stamps(), st.lists(status, max_size=3).map(tuple))
    if kind is DrawingSample:
        line = Shape(
            "tether", "line", "map", (1.0, 0.5, 0.0, 1.0), (0.01, 0.0, 0.0),
            ((0.0, 0.0, 0.0), (1.0, 0.0, -2.0)),
        )  # fmt: skip
        box = Shape(
            "body1", "box", "map", (0.0, 0.5, 1.0, 1.0), (0.3, 0.1, 0.15),
            position=(1.0, 0.0, -2.0),
        )  # fmt: skip
        wheel = box._replace(namespace="wheel", kind="cylinder", size=(0.3, 0.3, 0.06))
        coloured = line._replace(colours=((0.0, 0.25, 0.5, 1.0), (1.0, 0.5, 0.25, 0.5)))
        arrow = line._replace(namespace="force", kind="arrow", size=(0.1, 0.2, 0.3))
        boulder = box._replace(namespace="boulders", kind="sphere")
        floor = line._replace(kind="triangles", points=(*line.points, (0.0, 1.0, 0.0)))
        shapes = (line, box, wheel, coloured, arrow, boulder, floor)
        return st.builds(DrawingSample, stamps(), st.just(shapes))
    raise NotImplementedError(kind)
