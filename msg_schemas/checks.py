"""Checks of the contract's table on the content of messages; each raises a `Refusal`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import (
    JointSample,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Quaternion,
    Sample,
    TwistSample,
)
from msg_schemas.specifications import Topic, Unstamped

_NANO = 1_000_000_000
_QUATERNION_TOLERANCE = 1e-3


def check_numbers(topic: Topic, numbers: Iterable[tuple[str, float]]) -> None:
    """Refuse numbers that are not finite or not within the limits of their field path."""
    fields = topic.by_path
    for path, value in numbers:
        if not math.isfinite(value):
            reason = f"{path} is {value!r}, it must be a finite number"
            raise Refusal(topic.name, RefusalCode.NOT_FINITE, reason)
        row = fields.get(path)
        if row is not None and not row.minimum <= value <= row.maximum:
            raise Refusal(
                topic.name,
                RefusalCode.OUT_OF_LIMITS,
                f"{path} is {value!r} {row.unit}, it must lie in "
                f"{row.minimum:g} .. {row.maximum:g} {row.unit}",
            )


def check_orientation(topic: Topic, given: Quaternion, *, may_be_open: bool = False) -> None:
    """Refuse what is no unit quaternion."""
    norm = math.hypot(*given)
    if abs(norm - 1.0) <= _QUATERNION_TOLERANCE or (may_be_open and norm == 0.0):
        return
    expected = "a unit quaternion" + (", or all zeros to leave it open" if may_be_open else "")
    raise Refusal(
        topic.name,
        RefusalCode.OUT_OF_LIMITS,
        f"orientation has norm {norm!r}, it must be {expected}",
    )


def check_joint_names(topic: Topic, names: Sequence[str]) -> None:
    """Refuse unknown, missing and repeated names of joints."""
    given = set(names)
    if topic.one_joint:
        if len(names) == 1 and given <= set(topic.joints):
            return
        expected = f"exactly one of {sorted(topic.joints)}"
    else:
        allowed = {*topic.joints, *topic.optional_joints}
        if len(given) == len(names) and set(topic.joints) <= given <= allowed:
            return
        expected = f"{sorted(topic.joints)}, each once"
        if topic.optional_joints:
            expected += f", and may further be {sorted(topic.optional_joints)}"
    raise Refusal(
        topic.name, RefusalCode.WRONG_NAME, f"joints are {list(names)}, they must be {expected}"
    )


def check_frame(topic: Topic, got: str, expected: str, which: str = "header.frame_id") -> None:
    """Refuse a frame that is given and is not the expected one."""
    if expected and got not in {"", expected}:
        raise Refusal(
            topic.name, RefusalCode.WRONG_FRAME, f"{which} is {got!r}, it must be {expected!r}"
        )


def check_text(topic: Topic, text: str) -> None:
    """Refuse a word that the topic does not define, or a text that is no JSON object."""
    if topic.words and text not in topic.words:
        raise Refusal(
            topic.name,
            RefusalCode.BAD_TEXT,
            f"text is {text!r}, it must be one of {', '.join(topic.words)}",
        )
    if topic.is_json:
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise Refusal(topic.name, RefusalCode.BAD_TEXT, f"not JSON: {error}") from error
        if not isinstance(content, dict):
            raise Refusal(
                topic.name,
                RefusalCode.BAD_TEXT,
                f"JSON holds a {type(content).__name__}, it must hold an object",
            )


def check_age(topic: Topic, sample: Sample, now_ns: int) -> Sample:
    """Refuse a sample that is too old or from the future; stamp an unstamped one if allowed."""
    stamp = getattr(sample, "stamp_ns", None)
    if stamp is None:
        return sample
    policy = topic.stale
    if stamp == 0 and (math.isfinite(policy.max_age) or policy.unstamped is Unstamped.REFUSE):
        if policy.unstamped is Unstamped.REFUSE:
            raise Refusal(
                topic.name,
                RefusalCode.UNSTAMPED,
                "the stamp is zero, it must be the sender's time (header.stamp)",
            )
        return _restamped(sample, now_ns)
    age = (now_ns - stamp) / _NANO
    if age > policy.max_age:
        raise Refusal(
            topic.name,
            RefusalCode.STALE,
            f"stamped {age:.3f} s ago, it must be at most {policy.max_age:g} s old "
            "(do sender and receiver follow the same clock?)",
        )
    if -age > policy.max_lead:
        raise Refusal(
            topic.name,
            RefusalCode.FROM_THE_FUTURE,
            f"stamped {-age:.3f} s ahead, it may be at most {policy.max_lead:g} s ahead "
            "(do sender and receiver follow the same clock?)",
        )
    return sample


def _restamped(sample: Sample, now_ns: int) -> Sample:
    if isinstance(sample, JointSample | TwistSample | PoseEstimateSample | PoseSample | PathSample):
        return replace(sample, stamp_ns=now_ns)
    return sample
