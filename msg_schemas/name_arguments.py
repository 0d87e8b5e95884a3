"""Names of ROS on command lines, refused in one line where ROS would raise."""

from __future__ import annotations

import argparse
import re
from typing import Final

_NAMESPACE: Final = re.compile(r"/?|/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
_TOPIC: Final = re.compile(r"(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")


def topic_name(text: str) -> str:
    """Read the name of a topic, as a `type` for argparse.

    Raises:
        argparse.ArgumentTypeError: it is no such name.
    """
    if not _TOPIC.fullmatch(text):
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} should be one topic, of letters, digits, _ and /, such as /winch/state"
        )
    return text


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
