"""Opens regular files only: a FIFO would block, a device or an endless file fill the memory.

What a command writes is whole or not there, and its message names the file and the remedy.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TextIO

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


_REMEDIES = {
    errno.EEXIST: "it exists and is never overwritten; choose another name or remove it",
    errno.ENOENT: "its folder does not exist; create it first",
    errno.ENOTDIR: "a part of its path is a file, not a folder; choose another place",
    errno.EISDIR: "it is a folder; give the name of a file",
    errno.ENOTEMPTY: "it holds files; give a new or empty folder",
    errno.ENOSPC: "the disk is full; free space or choose another disk",
    errno.EDQUOT: "the disk's quota is used up; free space or choose another disk",
    errno.EROFS: "the disk is read-only; choose a writable place",
    errno.EACCES: "permission is denied; choose a writable place",
    errno.EPERM: "permission is denied; choose a writable place",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.ELOOP: "its links lead in a circle; choose another place",
}


def writing_problem(error: OSError, path: Path) -> str:
    """Return what a message states of a file or folder that cannot be written, and what to do.

    Args:
        error: that writing raised.
        path: that was to be written.
    """
    reason = _REMEDIES.get(error.errno or 0) or error.strerror or str(error)
    return f"cannot write {printable(cut(str(path), LONGEST_REASON))}: {reason}"


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[TextIO]:
    """Open a new file to write text; where the block raises, nothing of it is left.

    Raises:
        OSError: it exists, or cannot be written.
    """
    with path.open("x", encoding="utf-8", newline="") as stream:
        try:
            yield stream
            stream.flush()
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def file_problem(error: OSError) -> str:
    """Return what a message states of a file that cannot be used: its name and the reason."""
    reason = error.strerror or str(error)
    if error.filename is None:
        return reason
    return f"{printable(cut(os.fsdecode(error.filename), LONGEST_REASON))}: {reason}"
