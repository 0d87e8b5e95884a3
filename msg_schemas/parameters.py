"""Typed parameters: frozen dataclasses whose fields have unit, meaning and range.

A parameter class is an ordinary frozen dataclass whose fields are made with ``parameter``.
``from_mapping`` builds a validated instance; ``rover_runtime.ros`` declares its fields to ROS 2.
This module needs no ROS.

Example:
    >>> @dataclass(frozen=True)
    ... class Rates:
    ...     state: float = parameter(100.0, "Hz", "state publishing rate", 1.0, 1000.0)
    >>> from_mapping(Rates, {"state": 50}).state
    50.0
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from msg_schemas.fields import FieldError, FieldRule, known_names_hint, read_value, rule_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound="DataclassInstance")


class ParameterError(ValueError):
    """A parameter is missing, unknown, of the wrong type or out of range."""


def parameter(
    default: Any,
    unit: str,
    about: str,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
) -> Any:
    """Make a dataclass field that is a validated parameter.

    Args:
        default: value when none is given; its type must fit the annotation.
        unit: SI unit, or ``-``.
        about: one line of what it does.
        minimum: smallest allowed number.
        maximum: largest allowed number.
        choices: allowed words of a text.
        read_only: cannot be changed while a node runs.
    """
    rule = FieldRule(
        type(default), unit, about, minimum, maximum, words=choices, read_only=read_only
    )
    return dataclasses.field(default=default, metadata=rule.metadata())


def rules_of(cls: type[DataclassInstance]) -> dict[str, FieldRule]:
    """Return the rule of each parameter of a class, by name."""
    types = typing.get_type_hints(cls)
    rules = {field.name: rule_of(field) for field in dataclasses.fields(cls)}
    for name, rule in rules.items():
        if types[name] is not rule.kind:
            msg = f"the default of {cls.__name__}.{name} is no {types[name].__name__}"
            raise TypeError(msg)
    return rules


def from_mapping(cls: type[P], mapping: Mapping[str, Any], where: str = "") -> P:
    """Build a parameter object from names and values; absent names keep their defaults.

    Raises:
        ParameterError: unknown name, wrong type, not finite, out of range; the
            message names the parameter, its value and what is accepted.
    """
    rules = rules_of(cls)
    values = {}
    for name, value in mapping.items():
        if name not in rules:
            msg = f"{where}unknown parameter {name}{known_names_hint(str(name), rules)}"
            raise ParameterError(msg)
        try:
            values[name] = read_value(rules[name], value, name)
        except FieldError as error:
            msg = f"{where}{error}"
            raise ParameterError(msg) from None
    return cls(**values)
