"""Range check of the parameters of the mechanisms."""

import math
from collections.abc import Iterable


def check_ranges(
    parameters: object,
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
    fraction: Iterable[str] = (),
) -> None:
    """Raise an error for the first field that is not finite or out of its range.

    Args:
        parameters: object whose attributes are checked.
        positive: fields that must be above 0.
        not_negative: fields that must not be below 0.
        fraction: fields that must be above 0 and at most 1.

    Raises:
        ValueError: states the field, its value and the permitted range.
    """
    for name in positive:
        value = getattr(parameters, name)
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value}: must be finite and above 0")
    for name in not_negative:
        value = getattr(parameters, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name} = {value}: must be finite and not below 0")
    for name in fraction:
        value = getattr(parameters, name)
        if not 0.0 < value <= 1.0:
            raise ValueError(f"{name} = {value}: must be above 0 and at most 1")
