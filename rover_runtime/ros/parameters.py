"""Typed parameters on a ROS 2 node: declared with descriptors and ranges, checked when changed."""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

from msg_schemas.fields import FieldError, FieldRule, known_names_hint, rule_of
from msg_schemas.parameters import ParameterError, from_mapping, rules_of
from msg_schemas.yaml_reader import read_yaml
from rover_runtime.component import Groups

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from rclpy.node import Node

_QOS_OVERRIDES = "qos_overrides."
_FILE, _ASSIGNMENTS = "--params-file", frozenset({"-p", "--param"})
_FILE_OF_A_LAUNCH = "launch_params_"  # a node's own values, which launch_ros writes for all nodes
_ALL, _PARAMETERS = "/**", "ros__parameters"


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
    """Refuse overrides of undeclared parameters; ROS ignores a misspelt name.

    What a file gives to all nodes may be meant for others.
    """
    # rclpy has no public access to the overrides.
    undeclared = [
        name
        for name in node._parameter_overrides
        if not node.has_parameter(name) and not name.startswith(_QOS_OVERRIDES)
    ]
    for_all = _given_to_all(sys.argv, node.get_name()) if undeclared else set()
    for name in undeclared:
        if name in for_all:
            continue
        known = [each for cls in groups for each in rules_of(cls)]
        msg = f"unknown parameter {name}{known_names_hint(name, known)}"
        raise ParameterError(msg)


def _given_to_all(arguments: Sequence[str], node: str) -> set[str]:
    """Names that stand in sections for all nodes of parameter files, and nowhere for this one."""
    for_all: set[str] = set()
    own: set[str] = set()
    for flag, value in itertools.pairwise(arguments):
        if flag in _ASSIGNMENTS:
            own.add(value.partition(":=")[0])
        elif flag == _FILE and not Path(value).name.startswith(_FILE_OF_A_LAUNCH):
            with suppress(FieldError):  # ROS has read it, so that it may be refused as ever
                for key, names in _sections(read_yaml(Path(value))):
                    if key == _ALL:
                        for_all |= names
                    elif key.rpartition("/")[2] in {node, "*"}:
                        own |= names
    return for_all - own


def _sections(content: object) -> Iterator[tuple[str, set[str]]]:
    """Key and names of the parameters of each section of a parameter file."""
    for key, section in content.items() if isinstance(content, Mapping) else ():
        if isinstance(section, Mapping) and isinstance(section.get(_PARAMETERS), Mapping):
            yield key, set(_names(section[_PARAMETERS]))


def _names(values: Mapping[str, object], prefix: str = "") -> Iterator[str]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _names(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def _descriptor(rule: FieldRule) -> ParameterDescriptor:
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
