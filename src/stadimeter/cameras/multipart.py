"""Multipart streams of pictures (``multipart/x-mixed-replace``), taken apart as their bytes come."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from stadimeter.errors import LinkLostError

PART_MAX_BYTES = 20_000_000
"""A larger picture is none: a JPEG of 60 megapixels at high quality is smaller."""

HEAD_MAX_BYTES = 16_384

_JPEG_END = re.compile(rb"\xff\xd9[\r\n]*\Z")
_END_OF_HEAD = re.compile(rb"\n\r?\n")
_LENGTH = re.compile(rb"^content-length[ \t]*:[ \t]*(\d{1,9})[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_STAMP = re.compile(rb"^x-timestamp[ \t]*:[ \t]*(\d{1,12}(?:\.\d{1,9})?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the stream.

    Attributes:
        body: Its bytes, as they came.
        stamp_s: Its ``X-Timestamp`` in seconds of the sender's clock, NaN if it has none.
    """

    body: bytes
    stamp_s: float


class Multipart:
    """Takes a stream apart. It reads nothing itself: `feed` gives it bytes, `next_part` takes out what is whole.

    Senders differ, so much is accepted: a boundary that is stated with or without its leading dashes or not at all,
    lines that end in LF or CRLF, a ``Content-Length`` or none. A part ends at its length or at the next boundary,
    whichever comes first, so one that was cut short swallows no part after it. Without a length it also ends where
    what came so far ends like a JPEG, since many senders write the boundary only when the next picture is there.

    Args:
        boundary: What the ``Content-Type`` states; empty for any line that begins with two dashes.
    """

    def __init__(self, boundary: str) -> None:
        name = boundary.strip().lstrip("-").encode("latin-1", "replace")
        line = rb"-*" + re.escape(name) if name else rb"--[^\r\n]{0,70}"
        self._delimiter = re.compile(rb"\n" + line + rb"(?:--)?[ \t]*\r?\n")
        self._longest_delimiter = len(name) + 80
        self._data = bytearray(b"\n")
        self._body_at: int | None = None
        self._length: int | None = None
        self._stamp_s = math.nan
        self._searched = 0

    def feed(self, data: bytes) -> None:
        """Take the next bytes of the stream."""
        self._data += data

    def next_part(self) -> Part | None:
        """Take out the next part; None if it is not whole yet.

        Raises:
            LinkLostError: What comes is no such stream: a part or its header lines do not end.
        """
        if self._body_at is None and not self._read_head():
            return None
        end = self._end_of_body()
        if end is None:
            if len(self._data) > PART_MAX_BYTES:
                raise LinkLostError(f"a part of the stream is larger than {PART_MAX_BYTES / 1e6:.0f} MB")
            return None
        part = Part(bytes(self._data[self._body_at : end]), self._stamp_s)
        del self._data[:end]
        self._body_at, self._searched = None, 0
        return part

    def _read_head(self) -> bool:
        delimiter = self._delimiter.search(self._data)
        if delimiter is None:
            del self._data[: -self._longest_delimiter]
            return False
        begin = delimiter.end() - 1  # with the end of the boundary's line, which a blank line may follow at once
        head = _END_OF_HEAD.search(self._data, begin, begin + HEAD_MAX_BYTES)
        if head is None:
            if len(self._data) - begin > HEAD_MAX_BYTES:
                raise LinkLostError("the header lines of a part of the stream do not end")
            return False
        lines = bytes(self._data[begin : head.end()])
        length, stamp = _LENGTH.search(lines), _STAMP.search(lines)
        self._length = int(length[1]) if length else None
        self._stamp_s = float(stamp[1]) if stamp else math.nan
        self._body_at = self._searched = head.end()
        return True

    def _end_of_body(self) -> int | None:
        begin = self._body_at or 0
        whole = None if self._length is None else begin + self._length
        limit = len(self._data) if whole is None else min(len(self._data), whole)
        found = self._delimiter.search(self._data, max(begin, self._searched - self._longest_delimiter), limit)
        self._searched = limit
        if found is not None:
            return found.start()
        if whole is not None:
            return whole if len(self._data) >= whole else None
        end = _JPEG_END.search(self._data, max(begin, limit - 8))
        return end.start() + 2 if end else None
