"""Sections of a configuration that become parameters of the physics.

The physics states its parameters as plain frozen dataclasses, which hold the default values. A
`PhysicsSection` has fields of the same names, adds units and ranges, and takes its defaults from
there, so no number stands twice.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from msg_schemas.configuration import Configuration, ConfigurationError


@dataclass(frozen=True)
class PhysicsSection(Configuration):
    """A section whose fields are those of the dataclass `KIND`, or some of them."""

    KIND: ClassVar[type]

    @classmethod
    def like(cls, parameters: Any) -> Any:
        """The section that holds the given parameters."""
        names = [item.name for item in dataclasses.fields(cls)]
        return cls(**{name: getattr(parameters, name) for name in names})

    def parameters(self, **others: Any) -> Any:
        """The parameters of the physics; `others` are those that are no fields here."""
        values = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return self.KIND(**{name: _unwrapped(value) for name, value in values.items()}, **others)

    def check(self) -> None:
        """Refuse what the physics refuses."""
        refuse_what_is_refused_by(self.parameters)


def refuse_what_is_refused_by(build: Any) -> None:
    """Call `build`; its ValueErrors, ``name = value: what is right``, become refusals."""
    try:
        build()
    except ConfigurationError:
        raise
    except ValueError as error:
        what, _, expected = str(error).partition(": ")
        name, _, value = what.partition(" = ")
        raise ConfigurationError(name, value, expected) from None


def _unwrapped(value: Any) -> Any:
    return value.parameters() if isinstance(value, PhysicsSection) else value
