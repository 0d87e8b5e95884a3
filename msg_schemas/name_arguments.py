"""Names of ROS on command lines, refused in one line where ROS would raise."""

from __future__ import annotations

import argparse
import re
from typing import Final

_NAMESPACE: Final = re.compile(r"/?|/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")


def namespace(text: str) -> str:
    """Read a namespace of ROS, as a `type` for argparse; it may lack the first slash.

    Raises:
        argparse.ArgumentTypeError: it is no namespace.
    """
    if not _NAMESPACE.fullmatch(text):
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} should be names of letters, digits and _, such as /mother1"
        )
    return text
