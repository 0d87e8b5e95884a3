"""Serialise samples as a recorder does, to write synthetic bags."""

from __future__ import annotations

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from msg_schemas.codecs import encode
from msg_schemas.samples import Sample
from msg_schemas.table import TOPICS

STORE = get_typestore(Stores.ROS2_JAZZY)


def cdr(name: str, sample: Sample) -> bytes:
    """Return a sample of a contract topic, serialised in CDR."""
    return serialised(TOPICS[name].message, encode(name, sample))


def serialised(kind: str, message: Any) -> bytes:
    """Return a ROS message in CDR, without the padding that rclpy may add."""
    return bytes(STORE.serialize_cdr(_converted(message, kind), kind))


def _converted(message: Any, kind: str) -> Any:
    values = {}
    for field, field_type in message.get_fields_and_field_types().items():
        values[field] = _value(getattr(message, field), field_type)
    return STORE.types[kind](**values)


def _value(value: Any, field_type: str) -> Any:
    base = field_type.removeprefix("sequence<").split("[")[0].removesuffix(">").split(",")[0]
    if "/" in base:
        package, name = base.split("/")
        kind = f"{package}/msg/{name}"
        if base != field_type:
            return [_converted(item, kind) for item in value]
        return _converted(value, kind)
    if base == "octet":
        return value[0]
    if base in {field_type, "string"}:
        return value
    return np.asarray(value)
