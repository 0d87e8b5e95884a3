"""Parameters as named tuples, for compiled functions."""

from typing import Any, TypeVar

T = TypeVar("T")


def from_parameters(kind: type[T], parameters: object, **derived: Any) -> T:
    """Return the named tuple `kind` with the parameters of the same names.

    Args:
        kind: a named tuple.
        parameters: a configuration, whose numbers are plain ones.
        derived: values of the fields that are no parameters.
    """
    names: tuple[str, ...] = kind._fields  # type: ignore[attr-defined]
    same = {name: getattr(parameters, name) for name in names if name not in derived}
    return kind(**same, **derived)
