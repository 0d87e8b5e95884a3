"""Typed parameters on a ROS 2 node: declared with descriptors and ranges, checked when changed."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

from msg_schemas.parameters import ParameterError, ParameterInfo, from_mapping, info_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from rclpy.node import Node
    from rclpy.parameter import Parameter

Groups = dict[type[Any], Any]

_QOS_OVERRIDES = "qos_overrides."


def declare_parameters(node: Node, classes: Iterable[type[DataclassInstance]]) -> Groups:
    """Declare parameter classes on a node; returns their values, by class.

    Raises:
        ParameterError: a value given from outside is wrong, or has a name that nobody declares.
    """
    groups: Groups = {}
    for cls in classes:
        values = {}
        for field in dataclasses.fields(cls):
            try:
                declared = node.declare_parameter(
                    field.name, field.default, _descriptor(field.default, info_of(field))
                )
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                msg = f"{field.name}: {error}"
                raise ParameterError(msg) from error
            values[field.name] = declared.value
        groups[cls] = from_mapping(cls, values)
    _refuse_undeclared(node, groups)
    return groups


def changed_groups(groups: Mapping[type[Any], Any], changes: Iterable[Parameter]) -> Groups:
    """Return the parameter objects that the changes renew.

    Raises:
        ParameterError: a new value is wrong.
    """
    wanted = {change.name: change.value for change in changes}
    renewed: Groups = {}
    for cls, present in groups.items():
        names = {field.name for field in dataclasses.fields(cls)}
        mine = {name: value for name, value in wanted.items() if name in names}
        if mine:
            renewed[cls] = from_mapping(cls, {**dataclasses.asdict(present), **mine})
    return renewed


def described_parameters(classes: Iterable[type[DataclassInstance]]) -> list[str]:
    """Return lines for ``--help``: each parameter with default, unit, range and meaning."""
    lines = []
    for cls in classes:
        for field in dataclasses.fields(cls):
            info = info_of(field)
            limits = ""
            if math.isfinite(info.minimum) and math.isfinite(info.maximum):
                limits = f", {info.minimum:g} .. {info.maximum:g}"
            if info.choices:
                limits = f", one of {', '.join(info.choices)}"
            unit = "" if info.unit == "-" else f" {info.unit}"
            lines.append(f"  {field.name} (default {field.default!r}{unit}{limits})")
            lines.append(f"      {info.about}")
    return lines


def _refuse_undeclared(node: Node, groups: Groups) -> None:
    """Refuse what nobody declares: ROS itself would pass over a misspelt name in silence."""
    # rclpy offers no public way to see them.
    for name in node._parameter_overrides:
        if node.has_parameter(name) or name.startswith(_QOS_OVERRIDES):
            continue
        known = [field.name for cls in groups for field in dataclasses.fields(cls)]
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        msg = f"unknown parameter {name}{hint}; known are {', '.join(known)}"
        raise ParameterError(msg)


def _descriptor(default: Any, info: ParameterInfo) -> ParameterDescriptor:
    unit = "" if info.unit == "-" else f" [{info.unit}]"
    described = ParameterDescriptor(
        description=info.about + unit,
        read_only=info.read_only,
        additional_constraints=f"one of {', '.join(info.choices)}" if info.choices else "",
        # A float parameter must accept "rate:=100": rclpy would refuse the integer.
        dynamic_typing=isinstance(default, float),
    )
    if math.isfinite(info.minimum) and math.isfinite(info.maximum):
        if isinstance(default, float):
            described.floating_point_range = [
                FloatingPointRange(from_value=float(info.minimum), to_value=float(info.maximum))
            ]
        elif isinstance(default, int) and not isinstance(default, bool):
            described.integer_range = [
                IntegerRange(from_value=int(info.minimum), to_value=int(info.maximum), step=1)
            ]
    return described
