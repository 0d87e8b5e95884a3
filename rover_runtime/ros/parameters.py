"""Typed parameters on a ROS 2 node: declared with descriptors and ranges, checked when changed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

from msg_schemas.fields import Rule, known_names_hint, rule_of
from msg_schemas.parameters import ParameterError, from_mapping, rules_of
from rover_runtime.component import Groups

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from rclpy.node import Node

_QOS_OVERRIDES = "qos_overrides."


def declare_parameters(node: Node, classes: Iterable[type[DataclassInstance]]) -> Groups:
    """Declare parameter classes on a node; returns their values, by class.

    Raises:
        ParameterError: an override is wrong, or has a name that is not declared.
    """
    groups: Groups = {}
    for cls in classes:
        values = {}
        for field in dataclasses.fields(cls):
            try:
                declared = node.declare_parameter(
                    field.name, field.default, _descriptor(rule_of(field))
                )
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                msg = f"{field.name}: {error}"
                raise ParameterError(msg) from error
            values[field.name] = declared.value
        groups[cls] = from_mapping(cls, values)
    _refuse_undeclared(node, groups)
    return groups


def parameter_help(classes: Iterable[type[DataclassInstance]]) -> list[str]:
    """Return lines for ``--help``: each parameter with default, unit, range and meaning."""
    lines = []
    for cls in classes:
        for field in dataclasses.fields(cls):
            rule = rule_of(field)
            unit = "" if rule.unit == "-" else f" {rule.unit}"
            lines.append(f"  {field.name} (default {field.default!r}{unit}): {rule.accepted()}")
            lines.append(f"      {rule.about}")
    return lines


def _refuse_undeclared(node: Node, groups: Groups) -> None:
    """Refuse overrides of undeclared parameters; ROS ignores a misspelt name."""
    # rclpy has no public access to the overrides.
    for name in node._parameter_overrides:
        if node.has_parameter(name) or name.startswith(_QOS_OVERRIDES):
            continue
        known = [each for cls in groups for each in rules_of(cls)]
        msg = f"unknown parameter {name}{known_names_hint(name, known)}"
        raise ParameterError(msg)


def _descriptor(rule: Rule) -> ParameterDescriptor:
    unit = "" if rule.unit == "-" else f" [{rule.unit}]"
    described = ParameterDescriptor(
        description=rule.about + unit,
        read_only=rule.read_only,
        additional_constraints=rule.accepted() if rule.words else "",
        # A float parameter must accept "rate:=100": rclpy would refuse the integer.
        dynamic_typing=rule.kind is float,
    )
    if math.isfinite(rule.minimum) and math.isfinite(rule.maximum):
        if rule.kind is float:
            described.floating_point_range = [
                FloatingPointRange(from_value=float(rule.minimum), to_value=float(rule.maximum))
            ]
        elif rule.kind is int:
            described.integer_range = [
                IntegerRange(from_value=int(rule.minimum), to_value=int(rule.maximum), step=1)
            ]
    return described
