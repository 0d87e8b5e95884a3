"""Configuration sections that map to parameters of the physics.

The physics defines its parameters as frozen dataclasses with the default values. A `PhysicsSection`
has fields of the same names with units and ranges, and takes its defaults from the dataclass, so
that each value is defined once.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from msg_schemas.configuration import Configuration, ConfigurationError


@dataclass(frozen=True)
class PhysicsSection(Configuration):
    """A section with the fields of the dataclass `KIND`, or some of them."""

    KIND: ClassVar[type]

    @classmethod
    def like(cls, parameters: Any) -> Any:
        """Build the section from parameters of the physics."""
        names = [item.name for item in dataclasses.fields(cls)]
        return cls(**{name: getattr(parameters, name) for name in names})

    def parameters(self, **others: Any) -> Any:
        """Return the parameters of the physics; `others` are those without a field here."""
        values = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return self.KIND(**{name: _unwrapped(value) for name, value in values.items()}, **others)

    def check(self) -> None:
        """Apply the checks of the physics."""
        convert_value_errors(self.parameters)


def convert_value_errors(build: Any) -> None:
    """Call `build`; convert a ValueError ``name = value: expected`` to a ConfigurationError."""
    try:
        build()
    except ConfigurationError:
        raise
    except ValueError as error:
        subject, _, expected = str(error).partition(": ")
        name, _, value = subject.partition(" = ")
        raise ConfigurationError(name, value, expected) from None


def _unwrapped(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_unwrapped, value))
    return value.parameters() if isinstance(value, PhysicsSection) else value
