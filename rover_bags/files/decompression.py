"""Decompression that unpacks no more than was announced, and no more than a limit."""

from typing import Any, BinaryIO, Final

import zstandard

_BLOCK: Final = 1 << 12
"""Bytes that are unpacked at once: they may become 32 000 times as many."""
_LARGEST_RATIO: Final = 256
"""Largest size of a file's contents, relative to that of the compressed file."""
_SMALL: Final = 1 << 26
"""Contents up to this size are unpacked whatever the ratio [byte]."""


def unpack_zstd(packed: Any, size: int) -> bytes:
    """Unpack one frame.

    Args:
        packed: bytes of the frame.
        size: largest accepted size of its contents [byte].

    Raises:
        zstandard.ZstdError: it is damaged, or announces or has more.
    """
    # The library unpacks whatever the frame itself announces.
    if zstandard.frame_content_size(packed) > size:
        raise zstandard.ZstdError("the frame announces more than accepted")
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)


def unpack_file(packed: BinaryIO, packed_size: int, plain: BinaryIO) -> str:
    """Unpack as much of a compressed file as possible.

    Args:
        packed: the file.
        packed_size: its size [byte].
        plain: receives the contents.

    Returns:
        The reason of an early end, a phrase about the file; empty if there was none.
    """
    unpacker, is_complete = zstandard.ZstdDecompressor().decompressobj(), False
    left = max(_SMALL, _LARGEST_RATIO * packed_size)
    while block := packed.read(_BLOCK):
        while block:
            if is_complete:
                unpacker = zstandard.ZstdDecompressor().decompressobj()
            try:
                contents = unpacker.decompress(block)
            except zstandard.ZstdError as error:
                return f"cannot be decompressed to its end ({error})"
            plain.write(contents[:left])
            left -= len(contents)
            if left < 0:
                return f"has contents more than {_LARGEST_RATIO} times as large as itself"
            is_complete = unpacker.eof
            block = unpacker.unused_data if is_complete else b""
    return "" if is_complete else "is cut: its compressed data are incomplete"
