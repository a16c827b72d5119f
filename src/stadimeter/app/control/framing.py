"""The form of answers on a control socket and the pipe of the workbench process: a line of JSON, and bytes behind it.

A line says with ``"bytes": N`` that N raw bytes follow it, such as a picture: base64 would cost a third more, and time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

# More bytes than this never follow a line.
BYTES_MAX = 64 * 1024 * 1024


def encode_answer(answer: Mapping[str, Any], attached: bytes = b"") -> bytes:
    """Return an answer as it is sent: one line, in ASCII, and the bytes that belong to it."""
    return encode_line(answer, len(attached)) + attached


def encode_line(answer: Mapping[str, Any], attached_bytes: int = 0, data: str = "") -> bytes:
    """Return the line of an answer alone.

    Args:
        attached_bytes: How many bytes will follow it.
        data: Its data, as JSON in ASCII already; empty if they are in the answer.
    """
    head = {**answer, "bytes": attached_bytes} if attached_bytes else answer
    line = json.dumps(head, separators=(",", ":"), allow_nan=False)
    line = f'{line[:-1]},"data":{data}}}' if data else line
    return line.encode("ascii") + b"\n"


def attached_bytes(answer: Mapping[str, Any]) -> int:
    """Return the number of bytes that follow a line; `ValueError` if that is no number of bytes that may follow."""
    size = answer.get("bytes", 0)
    if not isinstance(size, int) or isinstance(size, bool) or not 0 <= size <= BYTES_MAX:
        raise ValueError(f"{size!r} bytes cannot follow a line")
    return size
