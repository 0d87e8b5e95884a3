"""Limits of the texts that come from outside, and how texts are cut where they are repeated."""

from __future__ import annotations

from typing import Final

NAME_BYTES: Final = 512
"""Longest frame, joint, field, sender or other name of a message, in UTF-8."""
STATUS_BYTES: Final = 8192
"""Longest message or value of a status."""
DOCUMENT_BYTES: Final = 1 << 20
"""Longest text of a ``std_msgs/String``: a word, or JSON."""

LONGEST_NAME: Final = 128
"""Characters of a sender or an identifier that are repeated."""
LONGEST_REASON: Final = 400
"""Characters of a reason that are repeated."""
LONGEST_STATUS: Final = STATUS_BYTES // 4
"""Characters of a message or a value of a status that is published: at most 4 bytes each."""
_CUT: Final = " ..."


def cut(text: str, limit: int) -> str:
    """Return a text of at most ``limit`` characters; a longer one ends with an ellipsis."""
    return text if len(text) <= limit else text[: limit - len(_CUT)] + _CUT


def printable(text: str) -> str:
    """Return a text in which characters that cannot be shown are replaced."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)
