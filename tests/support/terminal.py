"""A pseudo-terminal with a program of ours in it, for what a person types and sees."""

from __future__ import annotations

import codecs
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from fcntl import ioctl
from pathlib import Path

PATIENCE_S = 120.0

IN_ITS_TERMINAL = """
import fcntl, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
from stadimeter.__main__ import main
main()
"""
_CODES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Terminal:
    """A terminal in which `stadimeter` runs, whose controlling terminal it is.

    Attributes:
        raw: All that was shown, with the codes that place and colour it.
    """

    def __init__(self, *words: str, columns: int = 80, rows: int = 24, folder: Path | None = None) -> None:
        self._ours, self._theirs = pty.openpty()
        ioctl(self._theirs, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self._before = termios.tcgetattr(self._theirs)
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._heard = 0
        self.raw = ""
        self.program = subprocess.Popen(
            [sys.executable, "-c", IN_ITS_TERMINAL, *words],
            stdin=self._theirs,
            stdout=self._theirs,
            stderr=self._theirs,
            start_new_session=True,
            cwd=folder,
            env={**os.environ, "TERM": "xterm-256color", "PYTHONIOENCODING": "utf-8"},
        )

    @property
    def shown(self) -> str:
        """All that was shown, as text."""
        return _CODES.sub("", self.raw)

    def wait_for(self, words: str) -> str:
        """Return what was shown until these words came, from those on that were waited for before."""
        until_s = time.monotonic() + PATIENCE_S
        while (at := self.shown.find(words, self._heard)) < 0:
            assert time.monotonic() < until_s, f"{words!r} never came; the last was: {self.shown[-3000:]}"
            self.look()
        said, self._heard = self.shown[self._heard : at + len(words)], at + len(words)
        return said

    def look(self, wait_s: float = 0.1) -> bool:
        """Take what is shown next; return False if nothing is within that time."""
        is_shown = bool(select.select([self._ours], [], [], wait_s)[0])
        if is_shown:
            self.raw += self._decoder.decode(os.read(self._ours, 65536))
        return is_shown

    def press(self, keys: str) -> None:
        """Type."""
        os.write(self._ours, keys.encode())

    def ended(self, number: signal.Signals | None = None) -> int:
        """Send a signal if one is given, let the program end, and return its exit code."""
        if number is not None:
            self.program.send_signal(number)
        until_s = time.monotonic() + PATIENCE_S
        while self.program.poll() is None and time.monotonic() < until_s:
            self.look()
        while self.look(0.0):
            pass
        return self.program.wait(1)

    def is_as_before(self) -> bool:
        """Return whether the program has left the terminal's settings as they were."""
        return termios.tcgetattr(self._theirs) == self._before

    def close(self) -> None:
        """Kill the program if it still runs, and close the terminal."""
        self.program.kill()
        self.program.wait()
        os.close(self._ours)
        os.close(self._theirs)
