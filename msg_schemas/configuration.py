"""Nested, typed, frozen configurations: plain mappings in, dataclasses out.

A configuration is a frozen dataclass whose fields are made with `quantity` (a
number or numbers with a unit and a range), `choice` (one of a few words), `flag`, `text`,
`section` (another such dataclass), `sections` (several of them) or `read_by` (a function reads
the value). `read` builds it from a mapping; a `ConfigurationError` names the dotted path, the
value and what is accepted. What a mapping does not name of a section keeps the value that it has
in the section's default. `to_mapping` is the inverse; its result is JSON-ready.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

from msg_schemas.fields import (
    INFINITY_WORD,
    FieldRule,
    known_names_hint,
    named,
    read_value,
    rule_of,
    shown,
)
from msg_schemas.fields import FieldError as ConfigurationError

__all__ = [
    "Configuration",
    "ConfigurationError",
    "FieldRule",
    "choice",
    "flag",
    "merged",
    "quantity",
    "read",
    "read_by",
    "section",
    "sections",
    "shown",
    "text",
    "to_mapping",
    "with_overrides",
]

T = TypeVar("T")


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
    rule = FieldRule(
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
    return field(default=default, metadata=rule.metadata())


def choice(
    words: Sequence[str], about: str, default: Any = MISSING, *, optional: bool = False
) -> Any:
    """A field that holds one of a few words."""
    rule = FieldRule(kind=str, about=about, words=tuple(words), optional=optional)
    return field(default=default, metadata=rule.metadata())


def text(about: str, default: Any = MISSING) -> Any:
    """A field that holds free text."""
    return field(default=default, metadata=FieldRule(kind=str, about=about).metadata())


def flag(about: str, default: Any = False) -> Any:
    """A field that is true or false."""
    return field(default=default, metadata=FieldRule(kind=bool, about=about).metadata())


def section(kind: type, about: str, default: Any = MISSING, *, optional: bool = False) -> Any:
    """A field that holds another configuration."""
    rule = FieldRule(kind=kind, about=about, optional=optional)
    return field(default=default, metadata=rule.metadata())


Reader = Callable[[object, str], Any]
"""Converts the value given at a path to the field's value, or raises ConfigurationError."""


@dataclass(frozen=True)
class _ReadBy(FieldRule):
    """A rule whose reader converts and checks the value; its own results pass unchanged."""

    reader: Reader = dataclasses.field(default=lambda value, _: value)
    makes: tuple[type, ...] = ()


def read_by(reader: Reader, makes: tuple[type, ...], about: str, default: Any = MISSING) -> Any:
    """A field that a function reads; `makes` are the types that it returns."""
    rule = _ReadBy(kind=object, about=about, reader=reader, makes=makes)
    return field(default=default, metadata=rule.metadata())


def sections(
    kind: type | Mapping[str, type], about: str, default: Any = MISSING, *, keyed: bool = False
) -> Any:
    """A field that holds several configurations: a list, or a mapping by free names if `keyed`.

    If `kind` maps words to classes, each entry maps one of the words to its configuration.
    """

    def read_one(value: object, path: str) -> Any:
        if not isinstance(kind, Mapping):
            return read(kind, value, path)
        words = ", ".join(kind)
        if not isinstance(value, Mapping) or len(value) != 1:
            raise ConfigurationError(path, value, f"should be a mapping of one of {words}")
        ((word, inner),) = value.items()
        if word not in kind:
            expected = f"no such key{known_names_hint(str(word), kind)}"
            raise ConfigurationError(_joined(path, str(word)), inner, expected)
        return read(kind[word], {} if inner is None else inner, _joined(path, word))

    def read_list(value: object, path: str) -> tuple[Any, ...]:
        if isinstance(value, (str, Mapping)) or not isinstance(value, Sequence):
            raise ConfigurationError(path, value, "should be a list")
        return tuple(read_one(each, f"{path}[{index}]") for index, each in enumerate(value))

    def read_mapping(value: object, path: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            raise ConfigurationError(path, value, "should be a mapping of names")
        return MappingProxyType(
            {name: read_one(each, _joined(path, str(name))) for name, each in value.items()}
        )

    if keyed:
        return read_by(read_mapping, (MappingProxyType,), about, default)
    return read_by(read_list, (tuple,), about, default)


@dataclass(frozen=True)
class Configuration:
    """Base of every configuration: checks its fields however it is built."""

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = _read_field(rule_of(item), getattr(self, item.name), item.name, item.default)
            object.__setattr__(self, item.name, value)
        self.check()

    def check(self) -> None:
        """Check several fields together; subclasses override it."""


def read(kind: type[T], mapping: object, path: str = "", default: T | None = None) -> T:
    """Build the configuration `kind` from a mapping of its field names.

    Args:
        kind: a configuration.
        mapping: of its field names to values.
        path: of the mapping, for messages.
        default: has the values that the mapping does not name; None: those of the fields.

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
            expected = f"no such key{known_names_hint(str(key), known)}"
            raise ConfigurationError(_joined(path, str(key)), value, expected)
    if default is not None:
        mapping = merged(to_mapping(default), mapping)
    for name, item in known.items():
        if name not in mapping and item.default is MISSING:
            raise ConfigurationError(
                _joined(path, name), None, f"missing; {_expected(rule_of(item))}"
            )
    try:
        return kind(**mapping)
    except ConfigurationError as error:
        raise ConfigurationError(_joined(path, error.path), error.value, error.expected) from None


def to_mapping(configuration: Any) -> dict[str, Any]:
    """Every field of a configuration as plain, JSON-ready values; `read` inverts it."""
    return {item.name: _plain(getattr(configuration, item.name)) for item in _fields(configuration)}


def merged(defaults: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `defaults`, overridden by `values`, section by section."""
    result = dict(defaults)
    for key, value in values.items():
        default = result.get(key)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            result[key] = merged(default, value)
        else:
            result[key] = value
    return result


def with_overrides(mapping: Mapping[str, Any], overrides: Mapping[str, object]) -> dict[str, Any]:
    """Copy a nested mapping with values replaced by dotted path.

    A number in a path is the index of a list's entry, from 0: ``start.position.1``. A path that
    leads into another one's value, as ``start.position`` into ``start``, is set after it.

    Raises:
        ConfigurationError: If a path leads through something that is neither mapping nor list, or
            to an entry that a list does not have.
    """
    result = {key: _copied(value) for key, value in mapping.items()}
    for path, value in sorted(overrides.items(), key=lambda item: str(item[0]).count(".")):
        *parents, last = str(path).split(".")
        node: Any = result
        for depth, name in enumerate(parents):
            if isinstance(node, dict):
                node.setdefault(name, {})
            at = _place_in(node, name)
            if at is None or not isinstance(node[at], dict | list):
                raise ConfigurationError(
                    str(path),
                    value,
                    f"cannot be set, as {named('.'.join(parents[: depth + 1]))} is "
                    f"{shown(None if at is None else node[at])}",
                )
            node = node[at]
        at = _place_in(node, last)
        if at is None:
            raise ConfigurationError(
                str(path),
                value,
                f"cannot be set, as {named('.'.join(parents))} is a list of {len(node)}, whose"
                " entries have numbers from 0",
            )
        node[at] = _copied(value) if isinstance(value, dict | list) else value
    return result


def overridden(configuration: T, overrides: Mapping[str, object]) -> T:
    """Copy a configuration with values replaced by dotted path, as `with_overrides`.

    The copy shares the sections that no path leads into: they are not read again.

    Raises:
        ConfigurationError: as `with_overrides` and `read`.
    """
    changed = {str(path).partition(".")[0] for path in overrides}
    mapping: dict[str, Any] = {}
    for item in _fields(configuration):
        value = getattr(configuration, item.name)
        mapping[item.name] = _plain(value) if item.name in changed else value
    return read(type(configuration), with_overrides(mapping, overrides))


def _place_in(node: dict[str, Any] | list[Any], name: str) -> Any:
    """Return the key of a mapping's value or the index of a list's entry; None: no such entry."""
    if isinstance(node, dict):
        return name
    index = int(name) if name.isdecimal() else len(node)
    return index if index < len(node) else None


def _fields(kind: Any) -> tuple[Field[Any], ...]:
    return dataclasses.fields(kind)


def _key_list(kind: type) -> str:
    return ", ".join(item.name for item in _fields(kind))


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path and name else path or name


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copied(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_copied(inner) for inner in value]
    return value


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_mapping(value)
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and math.isinf(value):
        return INFINITY_WORD if value > 0 else "-" + INFINITY_WORD
    return value


def _expected(rule: FieldRule) -> str:
    if isinstance(rule, _ReadBy):
        return f"should be {rule.about}"
    if not dataclasses.is_dataclass(rule.kind):
        return f"should be {rule.accepted()}"
    null = ", or null" if rule.optional else ""
    return f"should be a mapping of {_key_list(rule.kind)}{null}"


def _read_field(rule: FieldRule, value: object, path: str, default: object) -> Any:
    if isinstance(rule, _ReadBy):
        return value if isinstance(value, rule.makes) else rule.reader(value, path)
    if not dataclasses.is_dataclass(rule.kind):
        return read_value(rule, value, path)
    if isinstance(value, rule.kind) or (value is None and rule.optional):
        return value
    if not isinstance(value, Mapping):
        raise ConfigurationError(path, value, _expected(rule))
    return read(rule.kind, value, path, default if isinstance(default, rule.kind) else None)
