"""Base of the contract's enumerations: every member has a description."""

from __future__ import annotations

from enum import StrEnum
from typing import Self


class Described(StrEnum):
    """A word of the contract; a member is declared as ``NAME = "word", "description"``."""

    about: str

    def __new__(cls, value: str, about: str = "") -> Self:
        """Make a member from its word and its description."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.about = about
        return member
