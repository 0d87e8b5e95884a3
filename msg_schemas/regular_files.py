"""Opens regular files only: a FIFO would block, a device or an endless file fill the memory."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from msg_schemas.text_limits import LONGEST_REASON, cut, printable

LARGEST_TEXT = 1 << 20
"""Size of the largest file that is read as one text [byte]."""


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file, or a link to one, to read its bytes.

    Raises:
        OSError: it cannot be opened, or is something else.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError:  # a null character
        raise OSError(errno.EINVAL, "no file can have this name", str(path)) from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return os.fdopen(descriptor, "rb")


def read_text(path: Path, largest: int = LARGEST_TEXT) -> str:
    """Read a regular file as UTF-8 text.

    Args:
        path: of the file.
        largest: size of the largest accepted file [byte].

    Raises:
        OSError: it cannot be read, is no regular file, or is larger.
        UnicodeDecodeError: it is not UTF-8 text.
    """
    with open_regular(path) as stream:
        content = stream.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"it has more than {largest} bytes", str(path))
    return content.decode("utf-8")


def file_problem(error: OSError) -> str:
    """Return what a message states of a file that cannot be used: its name and the reason."""
    reason = error.strerror or str(error)
    if error.filename is None:
        return reason
    return f"{printable(cut(os.fsdecode(error.filename), LONGEST_REASON))}: {reason}"
