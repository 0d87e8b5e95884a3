"""Typed parameters: frozen dataclasses whose fields know unit, meaning and range.

A parameter class is an ordinary frozen dataclass whose fields are made with
``parameter``. It validates itself when constructed through ``build`` or
``from_mapping``, loads from YAML, and is declared to ROS 2 by
``msg_schemas.node``. This module needs no ROS.

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
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound="DataclassInstance")

_KEY = "parameter"


class ParameterError(ValueError):
    """A parameter is missing, unknown, of the wrong type or out of range."""


@dataclass(frozen=True)
class ParameterInfo:
    """What a parameter field carries besides its value."""

    unit: str
    about: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False


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
    info = ParameterInfo(unit, about, minimum, maximum, choices, read_only)
    return dataclasses.field(default=default, metadata={_KEY: info})


def info_of(field: dataclasses.Field[Any]) -> ParameterInfo:
    """Return the information that ``parameter`` attached to a field."""
    info = field.metadata.get(_KEY)
    if not isinstance(info, ParameterInfo):
        msg = f"field {field.name!r} was not made with parameter(...)"
        raise TypeError(msg)
    return info


def from_mapping(cls: type[P], mapping: Mapping[str, Any], where: str = "") -> P:
    """Build a parameter object from names and values; absent names keep their defaults.

    Raises:
        ParameterError: unknown name, wrong type, not finite, out of range; the
            message says which, the value and what would be right.
    """
    types = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}
    unknown = sorted(str(name) for name in set(mapping) - set(fields))
    if unknown:
        msg = f"{where}unknown parameter {', '.join(unknown)}; known are {', '.join(fields)}"
        raise ParameterError(msg)
    values = {
        name: _coerce(f"{where}{name}", types[name], info_of(fields[name]), value)
        for name, value in mapping.items()
    }
    return cls(**values)


def load_yaml(cls: type[P], path: Path) -> P:
    """Read a parameter object from a YAML file of names and values.

    Raises:
        ParameterError: the file cannot be read, is not YAML, or holds bad values.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}"
        raise ParameterError(msg) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        msg = f"{path} is not YAML: {error}"
        raise ParameterError(msg) from error
    if content is None:
        content = {}
    if not isinstance(content, Mapping):
        msg = f"{path} holds a {type(content).__name__}, it must hold names and values"
        raise ParameterError(msg)
    return from_mapping(cls, content, f"{path}: ")


def _coerce(name: str, wanted: Any, info: ParameterInfo, value: Any) -> Any:
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not wanted:
        msg = f"{name} is {value!r} ({type(value).__name__}), it must be of type {wanted.__name__}"
        raise ParameterError(msg)
    if isinstance(value, float) and not math.isfinite(value):
        msg = f"{name} is {value!r}, it must be a finite number"
        raise ParameterError(msg)
    if isinstance(value, (int, float)) and not info.minimum <= value <= info.maximum:
        msg = (
            f"{name} is {value!r} {info.unit}, it must lie in "
            f"{info.minimum:g} .. {info.maximum:g} {info.unit}"
        )
        raise ParameterError(msg)
    if info.choices and value not in info.choices:
        msg = f"{name} is {value!r}, it must be one of {', '.join(info.choices)}"
        raise ParameterError(msg)
    return value
