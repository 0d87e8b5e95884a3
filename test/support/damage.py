"""Damage to bytes and texts, as strategies, and the time in which a reader must refuse it."""

from __future__ import annotations

import copy
import gc
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hypothesis import strategies as st

_COUNTS = (0, 1, 0x7F, 0xFF, 0xFFFF, 2**28, 2**31 - 1, 2**31, 2**32 - 1)
# What a reader of numbers, names, YAML or CSV may stumble over.
_WORDS = (
    "", "-", "~", "nan", "-inf", "1e999", "9" * 400, "0x_", "!!int abc", "&a [*a]", "[" * 40, "{",
    "\x00", "\u202e", "é" * 300, '"', ",", "#", "%", "- ", ": ", "\n", "\r\n", "\t", "true", "[]",
)  # fmt: skip

_VALUES: tuple[Any, ...] = (
    None,
    True,
    "abc",
    "",
    [],
    {},
    [[]],
    [1, "a"],
    {"a": 1},
    -1,
    0,
    1e308,
    10**400,
)


@contextmanager
def little_time(most: float) -> Iterator[None]:
    """What is read within it takes less CPU time than this [s].

    The garbage collector waits meanwhile: it passes over the objects of all tests of the process.
    """
    collects = gc.isenabled()
    gc.disable()
    began = time.thread_time()
    try:
        yield
    finally:
        spent = time.thread_time() - began
        if collects:
            gc.enable()
        assert spent < most


@st.composite
def damaged(draw: st.DrawFn, good: bytes) -> bytes:
    """Some bytes, changed in one to four places."""
    made = bytearray(good)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(made) - 1)))
        kind = draw(st.integers(0, 5))
        if kind == 0:
            made[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif kind == 1:
            made[at : at + 4] = struct.pack("<I", draw(st.sampled_from(_COUNTS)))
        elif kind == 2:
            del made[at:]
        elif kind == 3:
            made[at:at] = draw(st.binary(max_size=12))
        elif kind == 4:
            stop = at + draw(st.integers(0, 64))
            made[at:at] = made[at:stop]
        else:
            del made[at : at + draw(st.integers(1, 32))]
    return bytes(made)


@st.composite
def damaged_text(draw: st.DrawFn, good: str, separators: str = "\n") -> str:
    """A text with one to four of its parts changed, lost, repeated or exchanged.

    Args:
        good: the text.
        separators: characters between its parts.
    """
    lines = good.splitlines(keepends=True)
    for _ in range(draw(st.integers(1, 4))):
        if not lines:
            break
        at = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.integers(0, 4))
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[draw(st.integers(0, len(lines) - 1))])
        elif kind == 2:
            other = draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
        else:
            lines[at] = _changed(draw, lines[at], separators)
    return "".join(lines)


@st.composite
def damaged_tree(draw: st.DrawFn, good: Any) -> Any:
    """Mappings and lists of JSON, of which one part is replaced, lost or added."""
    made = copy.deepcopy(good)
    part: Any = made
    parent: Any = made
    key: Any = None
    while isinstance(part, dict | list) and part:
        parent = part
        key = draw(st.sampled_from(sorted(part) if isinstance(part, dict) else [*range(len(part))]))
        part = part[key]
        if draw(st.booleans()):
            break
    kind = draw(st.integers(0, 3))
    if kind == 0:
        del parent[key]
    else:
        parent[key] = draw(st.sampled_from(_VALUES) | st.integers() | st.floats())
    return made


def _changed(draw: st.DrawFn, line: str, separators: str) -> str:
    """A line of which the part behind a separator, or any stretch, is replaced."""
    word = draw(st.sampled_from(_WORDS) | st.text(max_size=8))
    places = [at + 1 for at, sign in enumerate(line) if sign in separators]
    start = draw(st.sampled_from(places)) if places else draw(st.integers(0, len(line)))
    stop = draw(st.integers(start, len(line)))
    return line[:start] + word + line[stop:]
