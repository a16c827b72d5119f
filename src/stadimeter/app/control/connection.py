"""One connection to the control socket: whole lines in, answers out, and never a wait."""

from __future__ import annotations

import selectors
import socket
import time
from contextlib import suppress

from stadimeter.app.control.messages import LINE_MAX_BYTES, Reply
from stadimeter.errors import ControlError

UNREAD_MAX_BYTES = 1024 * 1024
"""Whoever leaves more than this unread is not worth waiting for."""


class Connection:
    """One who asks. Its methods never wait.

    Args:
        accepted: The connected socket.

    Attributes:
        socket: That socket.
        heard_s: When something came last, on the computer's monotonic clock.
        unanswered: How many requests the loop has not answered yet.
    """

    def __init__(self, accepted: socket.socket) -> None:
        accepted.setblocking(False)
        self.socket = accepted
        self.heard_s = time.monotonic()
        self.unanswered = 0
        self._read = bytearray()
        self._unsent = bytearray()
        self._is_ending = False

    @property
    def is_done(self) -> bool:
        """Whether nothing more comes of it: all was said, or nobody reads it."""
        is_over = self._is_ending and not self._unsent and self.unanswered == 0
        return is_over or len(self._unsent) > UNREAD_MAX_BYTES

    @property
    def events(self) -> int:
        """What to wait for; 0 for nothing, while only the loop's answer is missing."""
        reading = 0 if self._is_ending else selectors.EVENT_READ
        return reading | (selectors.EVENT_WRITE if self._unsent else 0)

    def lines(self) -> list[bytes]:
        """Return the whole lines that have come.

        Returns:
            The lines, without their ends.

        Raises:
            OSError: The other end is gone.
            ControlError: A line is too long. No more is read.
        """
        try:
            data = self.socket.recv(LINE_MAX_BYTES)
        except BlockingIOError:
            return []
        self.heard_s = time.monotonic()
        if not data:  # what was asked before is answered all the same
            self._is_ending = True
            return []
        *lines, rest = (self._read + data).split(b"\n")
        self._read = rest
        if len(rest) > LINE_MAX_BYTES:
            raise ControlError(f"a line of more than {LINE_MAX_BYTES} bytes is no request")
        return [bytes(line) for line in lines if line.strip()]

    def say(self, line: bytes) -> None:
        """Send a line, as soon as the other end takes it.

        Args:
            line: The line.

        Raises:
            OSError: The other end is gone.
        """
        self._unsent += line
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as the other end takes it.

        Raises:
            OSError: The other end is gone.
        """
        with suppress(BlockingIOError):
            while self._unsent:
                sent = self.socket.send(self._unsent)
                del self._unsent[:sent]

    def refuse(self, why: str) -> None:
        """Say why nothing more is read, and read nothing more.

        Args:
            why: In words.

        Raises:
            OSError: The other end is gone.
        """
        self._is_ending = True
        self._read.clear()
        self.say(Reply(error=why).line(None))
