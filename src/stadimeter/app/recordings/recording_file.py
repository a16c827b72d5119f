"""What an MCAP file begins with."""

from __future__ import annotations

import struct

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file, and its last ones if it was finished."""

LIBRARY = "stadimeter"
"""How the name of the program begins that recordings say they were written by."""

_HEADER = 1
"""The opcode of the first record of an MCAP file."""


def writer_of(head: bytes) -> str | None:
    """Return what program an MCAP file says that it was written by.

    Returns:
        The program; None if this is no beginning of an MCAP file.
    """
    if not head.startswith(MAGIC):
        return None
    try:
        opcode, _ = struct.unpack_from("<BQ", head, len(MAGIC))
        (profile_length,) = struct.unpack_from("<I", head, len(MAGIC) + 9)
        begin = len(MAGIC) + 13 + profile_length
        (length,) = struct.unpack_from("<I", head, begin)
    except struct.error:
        return None
    return head[begin + 4 : begin + 4 + length].decode(errors="replace") if opcode == _HEADER else None


def is_ours(head: bytes) -> bool:
    """Return whether a file is a recording of ours."""
    return (writer_of(head) or "").startswith(LIBRARY)
