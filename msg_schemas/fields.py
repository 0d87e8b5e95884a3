"""Validation of one input value by a rule: type, range, words, and the message of an error.

A `FieldRule` is stored in the metadata of a dataclass field. Node parameters
(`msg_schemas.parameters`) and nested configurations (`msg_schemas.configuration`)
share this module.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, dataclass
from numbers import Integral, Real
from typing import Any

INFINITY_WORD = ".inf"
SMALLEST_SIZE, LARGEST_SIZE = 1e-30, 1e30
"""Limits of the size of a number that is not 0; powers of such numbers are still finite."""
RULE = "rule"
"""The key of the field's metadata that holds its rule."""


class FieldError(ValueError):
    """A value that a field does not accept.

    Attributes:
        path: Name or dotted path of the value, e.g. ``start.slack``.
        value: The value that was refused.
        expected: What the field accepts.
    """

    def __init__(self, path: str, value: object, expected: str) -> None:
        super().__init__(f"{named(path)} = {shown(value)}: {expected}")
        self.path = path
        self.value = value
        self.expected = expected


def shown(value: object) -> str:
    """Print a value for a message, shortened where it is long."""
    printed = "null" if value is None else repr(value)
    return printed if len(printed) <= 60 else printed[:57] + "..."


def named(path: str) -> str:
    """Print a path for a message; quoted if it has unprintable characters."""
    return path if path.isprintable() else repr(path)


def known_names_hint(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the nearest known name, and all known names."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{hint}; known here: {', '.join(names)}"


@dataclass(frozen=True)
class FieldRule:
    """What one field accepts.

    Attributes:
        kind: ``float``, ``int``, ``bool``, ``str`` or, for a section, its dataclass.
        unit, about: Unit of the number and meaning of the field.
        minimum, maximum: Range of every number, ends included unless `open_minimum`.
        open_minimum: Whether the minimum itself is refused.
        length: 0 for a single value, otherwise the number of values in a list.
        optional: Whether null is accepted.
        infinite: Whether positive infinity is accepted.
        words: The words of a choice, empty for free text.
        read_only: Whether it cannot change while a node runs.
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
    read_only: bool = False

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

    def accepted(self) -> str:
        """Words for everything but a section that the field accepts."""
        if self.words:
            accepted = "one of " + ", ".join(self.words)
        elif self.kind is str:
            accepted = "text"
        elif self.kind is bool:
            accepted = "true or false"
        elif self.length:
            accepted = f"a list of {self.length}, each {self.range_text()}"
        else:
            accepted = self.range_text()
        return accepted + (", or null" if self.optional else "")

    def metadata(self) -> dict[str, Any]:
        """The metadata of a field with this rule."""
        return {
            RULE: self,
            "unit": self.unit,
            "about": self.about,
            "minimum": self.minimum,
            "maximum": self.maximum,
        }


def is_finite_number(value: object) -> bool:
    """Whether a value is a number, not a truth value, of which a float holds the size."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond every float
        return False


def rule_of(field: Field[Any]) -> FieldRule:
    """Return a field's rule; TypeError if it was made without one."""
    rule = field.metadata.get(RULE)
    if not isinstance(rule, FieldRule):
        msg = f"field {field.name!r} was made without a rule"
        raise TypeError(msg)
    return rule


def read_value(rule: FieldRule, value: object, path: str) -> Any:
    """Return the value as the field holds it: a number of its kind, a tuple of them, a word.

    Raises:
        FieldError: The rule does not accept the value.
    """
    if value is None and rule.optional:
        return None
    if rule.kind is bool:
        _require(isinstance(value, bool), rule, value, path)
        return value
    if rule.kind is str:
        right = isinstance(value, str) and (not rule.words or value in rule.words)
        _require(right, rule, value, path)
        return value
    if not rule.length:
        return _read_number(rule, value, path)
    if isinstance(value, (str, Mapping)) or not isinstance(value, Sequence):
        raise FieldError(path, value, f"should be {rule.accepted()}")
    _require(len(value) == rule.length, rule, value, path)
    return tuple(_read_number(rule, entry, f"{path}[{index}]") for index, entry in enumerate(value))


def read_or_none(rule: FieldRule, value: object) -> Any:
    """Return the value as the field holds it, or None if the rule does not accept it."""
    try:
        return read_value(rule, value, "")
    except FieldError:
        return None


def _require(right: bool, rule: FieldRule, value: object, path: str) -> None:
    if not right:
        raise FieldError(path, value, f"should be {rule.accepted()}")


def _read_number(rule: FieldRule, value: object, path: str) -> float | int:
    number_type = Integral if rule.kind is int else Real
    if value == INFINITY_WORD:
        value = math.inf
    if isinstance(value, bool) or not isinstance(value, number_type):
        raise FieldError(path, value, f"should be {rule.range_text()}")
    try:
        number: float | int = rule.kind(value)
        finite = rule.kind is int or math.isfinite(number)
    except OverflowError:  # a whole number beyond every float
        number, finite = math.inf, False
    if not finite and not (rule.infinite and number > 0 and isinstance(value, float)):
        raise FieldError(path, value, f"should be {rule.range_text()}, and finite")
    too_small = number <= rule.minimum if rule.open_minimum else number < rule.minimum
    if (too_small and rule.minimum > -math.inf) or number > rule.maximum:
        raise FieldError(path, value, f"should be {rule.range_text()}")
    if isinstance(number, float) and not (_is_sized(number) or number in {0.0, math.inf}):
        sizes = f"0 or {SMALLEST_SIZE:g} to {LARGEST_SIZE:g} in size"
        raise FieldError(path, value, f"should be {rule.range_text()}, and {sizes}")
    return number


def _is_sized(number: float) -> bool:
    return SMALLEST_SIZE <= abs(number) <= LARGEST_SIZE
