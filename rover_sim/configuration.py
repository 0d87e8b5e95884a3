"""Nested, typed, frozen configurations: plain mappings in, dataclasses out.

A configuration is a frozen dataclass whose fields are made with `quantity` (a
number or numbers with a unit and a range), `choice` (one of a few words), `text`
or `section` (another such dataclass). `read` turns a mapping into it and refuses
whatever does not fit with a `ConfigurationError` that names the dotted path, the
value and what would be right; `to_mapping` is its inverse and holds nothing that
JSON could not.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field
from numbers import Integral, Real
from typing import Any, TypeVar

T = TypeVar("T")

INFINITY_WORD = ".inf"


class ConfigurationError(ValueError):
    """A value that a configuration cannot take.

    Attributes:
        path: Dotted path of the value, e.g. ``start.slack``.
        value: The value that was refused.
        expected: What would be right.
    """

    def __init__(self, path: str, value: object, expected: str) -> None:
        super().__init__(f"{path} = {shown(value)}: {expected}")
        self.path = path
        self.value = value
        self.expected = expected


def shown(value: object) -> str:
    """Print a value for a message, shortened where it is long."""
    printed = "null" if value is None else repr(value)
    return printed if len(printed) <= 60 else printed[:57] + "..."


@dataclass(frozen=True)
class Rule:
    """What one field accepts; stands in the field's metadata under ``rule``.

    Attributes:
        kind: ``float``, ``int``, ``str`` or, for a section, its dataclass.
        unit, about: Unit of the number and meaning of the field.
        minimum, maximum: Range of every number, ends included unless `open_minimum`.
        open_minimum: Whether the minimum itself is refused.
        length: 0 for a single value, otherwise the number of values in a list.
        optional: Whether null is accepted.
        infinite: Whether positive infinity is accepted.
        words: The words of a choice, empty for free text.
    """

    kind: type
    unit: str = ""
    about: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    open_minimum: bool = False
    length: int = 0
    optional: bool = False
    infinite: bool = False
    words: tuple[str, ...] = ()

    def range_text(self) -> str:
        """Words for the range and unit, e.g. ``a number above 0 and at most 10 m``."""
        noun = "a whole number" if self.kind is int else "a number"
        bounds = []
        if self.minimum > -math.inf:
            bounds.append(f"{'above' if self.open_minimum else 'at least'} {self.minimum:g}")
        if self.maximum < math.inf:
            bounds.append(f"at most {self.maximum:g}")
        unit = f" {self.unit}" if self.unit not in {"", "-"} else ""
        if not bounds:
            return f"{noun}{' in' + unit if unit else ''}"
        return f"{noun} {' and '.join(bounds)}{unit}"


def quantity(
    unit: str,
    about: str,
    default: Any = MISSING,
    *,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    above: float | None = None,
    kind: type = float,
    length: int = 0,
    optional: bool = False,
    infinite: bool = False,
) -> Any:
    """A field that holds a number (or `length` numbers) with unit and range.

    `above` is a minimum that is itself refused. Without a default the field is
    required.
    """
    rule = Rule(
        kind=kind,
        unit=unit,
        about=about,
        minimum=minimum if above is None else above,
        maximum=maximum,
        open_minimum=above is not None,
        length=length,
        optional=optional,
        infinite=infinite,
    )
    return field(default=default, metadata=_metadata(rule))


def choice(
    words: Sequence[str], about: str, default: Any = MISSING, *, optional: bool = False
) -> Any:
    """A field that holds one of a few words."""
    rule = Rule(kind=str, about=about, words=tuple(words), optional=optional)
    return field(default=default, metadata=_metadata(rule))


def text(about: str, default: Any = MISSING) -> Any:
    """A field that holds free text."""
    return field(default=default, metadata=_metadata(Rule(kind=str, about=about)))


def section(kind: type, about: str, default: Any = MISSING, *, optional: bool = False) -> Any:
    """A field that holds another configuration."""
    rule = Rule(kind=kind, about=about, optional=optional)
    return field(default=default, metadata=_metadata(rule))


def _metadata(rule: Rule) -> dict[str, Any]:
    return {
        "rule": rule,
        "unit": rule.unit,
        "about": rule.about,
        "minimum": rule.minimum,
        "maximum": rule.maximum,
    }


@dataclass(frozen=True)
class Configuration:
    """Base of every configuration: checks its fields however it is built."""

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = _read_value(item.metadata["rule"], getattr(self, item.name), item.name)
            object.__setattr__(self, item.name, value)
        self.check()

    def check(self) -> None:
        """Refuse what no single field can show; for subclasses to extend."""


def read(kind: type[T], mapping: object, path: str = "") -> T:
    """Build the configuration `kind` from a mapping of its field names.

    Raises:
        ConfigurationError: On a key that does not exist, a required one that is missing, a
            wrong type, a number that is not finite or out of range, or whatever
            `kind.check` refuses.
    """
    if not isinstance(mapping, Mapping):
        raise ConfigurationError(
            path or "(top level)", mapping, f"should be a mapping of {_key_list(kind)}"
        )
    known = {item.name: item for item in _fields(kind)}
    for key, value in mapping.items():
        if key not in known:
            raise ConfigurationError(_joined(path, str(key)), value, _unknown(kind, str(key)))
    for name, item in known.items():
        if name not in mapping and item.default is MISSING:
            raise ConfigurationError(
                _joined(path, name), None, f"missing; {_expected(item.metadata['rule'])}"
            )
    try:
        return kind(**mapping)
    except ConfigurationError as error:
        raise ConfigurationError(_joined(path, error.path), error.value, error.expected) from None


def to_mapping(configuration: Any) -> dict[str, Any]:
    """Every field of a configuration as plain, JSON-ready values; `read` inverts it."""
    return {item.name: _plain(getattr(configuration, item.name)) for item in _fields(configuration)}


def with_overrides(mapping: Mapping[str, Any], overrides: Mapping[str, object]) -> dict[str, Any]:
    """Copy a nested mapping with values replaced by dotted path.

    Raises:
        ConfigurationError: If a path leads through something that is not a mapping.
    """
    result = {key: _copied(value) for key, value in mapping.items()}
    for path, value in overrides.items():
        *parents, last = str(path).split(".")
        node: Any = result
        for depth, name in enumerate(parents):
            if name not in node:
                node[name] = {}
            if not isinstance(node[name], dict):
                raise ConfigurationError(
                    str(path),
                    value,
                    f"cannot be set, as {'.'.join(parents[: depth + 1])} is {shown(node[name])}",
                )
            node = node[name]
        node[last] = value
    return result


def _unknown(kind: type, key: str) -> str:
    """Say that a key does not exist and which one was probably meant."""
    names = [item.name for item in _fields(kind)]
    near = difflib.get_close_matches(key, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"no such key{hint}; known here: {', '.join(names)}"


def _fields(kind: Any) -> tuple[Field[Any], ...]:
    return dataclasses.fields(kind)


def _key_list(kind: type) -> str:
    return ", ".join(item.name for item in _fields(kind))


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path and name else path or name


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copied(inner) for key, inner in value.items()}
    return value


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_mapping(value)
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and math.isinf(value):
        return INFINITY_WORD if value > 0 else "-" + INFINITY_WORD
    return value


def _expected(rule: Rule) -> str:
    if rule.words:
        text_of_rule = "should be one of " + ", ".join(rule.words)
    elif rule.kind is str:
        text_of_rule = "should be text"
    elif dataclasses.is_dataclass(rule.kind):
        text_of_rule = f"should be a mapping of {_key_list(rule.kind)}"
    elif rule.length:
        text_of_rule = f"should be a list of {rule.length}, each {rule.range_text()}"
    else:
        text_of_rule = f"should be {rule.range_text()}"
    return text_of_rule + (", or null" if rule.optional else "")


def _read_value(rule: Rule, value: object, path: str) -> Any:
    if value is None and rule.optional:
        return None
    if dataclasses.is_dataclass(rule.kind):
        if isinstance(value, rule.kind):
            return value
        if not isinstance(value, Mapping):
            raise ConfigurationError(path, value, _expected(rule))
        return read(rule.kind, value, path)
    if rule.kind is str:
        if not isinstance(value, str) or (rule.words and value not in rule.words):
            raise ConfigurationError(path, value, _expected(rule))
        return value
    if not rule.length:
        return _read_number(rule, value, path)
    if isinstance(value, (str, Mapping)) or not isinstance(value, Sequence):
        raise ConfigurationError(path, value, _expected(rule))
    if len(value) != rule.length:
        raise ConfigurationError(path, value, _expected(rule))
    return tuple(_read_number(rule, entry, f"{path}[{index}]") for index, entry in enumerate(value))


def _read_number(rule: Rule, value: object, path: str) -> float | int:
    wanted = Integral if rule.kind is int else Real
    if value == INFINITY_WORD:
        value = math.inf
    if isinstance(value, bool) or not isinstance(value, wanted):
        raise ConfigurationError(path, value, f"should be {rule.range_text()}")
    try:
        number: float | int = rule.kind(value)
        finite = rule.kind is int or math.isfinite(number)
    except OverflowError:  # a whole number beyond every float
        number, finite = math.inf, False
    if not finite and not (rule.infinite and number > 0 and isinstance(value, float)):
        raise ConfigurationError(path, value, f"should be {rule.range_text()}, and finite")
    too_small = number <= rule.minimum if rule.open_minimum else number < rule.minimum
    if (too_small and rule.minimum > -math.inf) or number > rule.maximum:
        raise ConfigurationError(path, value, f"should be {rule.range_text()}")
    return number
