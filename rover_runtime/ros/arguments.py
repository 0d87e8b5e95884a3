"""Splits a command line into a program's own arguments and those of ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

_BEGIN, _END = "--ros-args", "--"


def split_ros_arguments(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the words outside ``--ros-args ... --``, and those inside, led by ``--ros-args``."""
    plain: list[str] = []
    ros: list[str] = []
    is_ros = False
    for word in words:
        if word == _BEGIN:
            is_ros = True
        elif is_ros and word == _END:
            is_ros = False
        else:
            (ros if is_ros else plain).append(word)
    return plain, [_BEGIN, *ros] if ros else []


def parse_node_arguments(
    program: str, add_arguments: Callable[[argparse.ArgumentParser], None]
) -> argparse.Namespace:
    """Parse ``sys.argv`` of a node that has arguments of its own.

    Returns:
        The node's own arguments, and ``ros_arguments``.
    """
    plain, ros = split_ros_arguments(sys.argv[1:])
    parser = argparse.ArgumentParser(prog=program, allow_abbrev=False)
    add_arguments(parser)
    return parser.parse_args(plain, argparse.Namespace(ros_arguments=ros))
