"""A serial port with an emulated microcontroller behind it.

The port is a pseudo-terminal, so the driver under it opens, locks and reads it as it would a real one. A
pseudo-terminal has no baud rate, no DTR that resets a board, and no bit errors: only bytes can be tried on it.
"""

from __future__ import annotations

import contextlib
import math
import os
import pty
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from stadimeter.core.clock import Clock

SERVED_EVERY_S = 0.01
_MAX_BYTES_PER_READ = 4096


class Firmware(Protocol):
    """A microcontroller's program, as far as its serial line shows it."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host and return the answer, both at that time."""
        ...

    def step(self, now_s: float) -> None:
        """Live until that time."""
        ...


class EmulatedPort:
    """A pseudo-terminal whose other end an emulated firmware serves, each ``every_s`` of the run's clock.

    Its path stays the same when the cable is pulled and plugged in again, as below ``/dev/serial/by-id``. It may be
    used from several threads: a real clock serves it from one of its own.

    Args:
        firmware: The program behind the port. Its board has its own power and lives on without the cable.
        is_plugged: Asked at each service whether the cable is in.
        after_step: Called after each service; moves what the firmware drives.
        every_s: The time between two services.

    Raises:
        OSError: The system has no pseudo-terminal left.
    """

    def __init__(
        self,
        firmware: Firmware,
        clock: Clock,
        is_plugged: Callable[[], bool] = lambda: True,
        after_step: Callable[[], None] = lambda: None,
        *,
        every_s: float = SERVED_EVERY_S,
    ) -> None:
        # Fault if False: nothing is read at the board's end, so that the port fills up and takes no more bytes.
        self.is_read = True
        self.is_full = False  # fault: so it is at once, and whatever room comes is filled
        self.is_heard = True  # fault if False: what the board answers is lost on the way
        self.spoil: Callable[[bytes], bytes] = bytes  # fault: what the board gets instead of what was sent
        # Fault: how fast an adapter or a radio carries bytes to the board. It takes and keeps all that comes meanwhile.
        self.bytes_a_second = math.inf
        self.waiting = b""
        self._carried_at_s = 0.0
        self._firmware = firmware
        self._is_plugged = is_plugged
        self._after_step = after_step
        self._lock = threading.Lock()
        self._cable: _Cable | None = None
        self._folder = TemporaryDirectory(prefix="stadimeter-port-")
        self._link = Path(self._folder.name) / "emulated"
        self._plug_in()
        self._cancel = clock.call_every(every_s, self.serve)

    @property
    def path(self) -> str:
        """The path that a host opens. There is nothing there while the cable is out."""
        return str(self._link)

    def serve(self, now_s: float) -> None:
        """Let the firmware live until now, carry bytes both ways, and move what it drives."""
        with self._lock:
            self._firmware.step(now_s)
            self._follow_the_cable()
            if self._cable and self.is_full:
                self._cable.fill()
            elif self._cable and self.is_read:
                answer = self._firmware.receive(self.spoil(self._carried(self._cable.read(), now_s)), now_s)
                if answer and self.is_heard:
                    self._cable.write(answer)
            self._after_step()

    def say(self, data: bytes) -> None:
        """Send bytes to the host that it did not ask for: a boot loader's, or noise; lost while the cable is out."""
        with self._lock:
            if self._cable:
                self._cable.write(data)

    def close(self) -> None:
        """End the service and give the pseudo-terminal back. May be called any number of times."""
        self._cancel()
        with self._lock:
            self._pull_out()
            self._folder.cleanup()

    def _carried(self, data: bytes, now_s: float) -> bytes:
        """Return the bytes that have come through to the board by now."""
        self.waiting += data
        count = len(self.waiting)
        if self.bytes_a_second < math.inf:
            count = min(count, int((now_s - self._carried_at_s) * self.bytes_a_second + 1e-6))
        # A line that has nothing to carry saves no time up.
        is_idle = count == len(self.waiting)
        self._carried_at_s = now_s if is_idle else self._carried_at_s + count / self.bytes_a_second
        carried, self.waiting = self.waiting[:count], self.waiting[count:]
        return carried

    def _follow_the_cable(self) -> None:
        if self._is_plugged() and not self._cable:
            self._plug_in()
        elif self._cable and not self._is_plugged():
            self._pull_out()

    def _plug_in(self) -> None:
        self._cable = _Cable()
        self._link.symlink_to(self._cable.host_path)

    def _pull_out(self) -> None:
        if self._cable:
            self._link.unlink()
            self._cable.close()
            self._cable = None


class _Cable:
    """A pseudo-terminal: one end for the board, one for the host. Closing it hangs up on the host."""

    def __init__(self) -> None:
        # The host's end stays open here too: without any opener the system would forget that it is raw, and echo.
        self._board_fd, self._host_fd = pty.openpty()
        tty.setraw(self._host_fd)
        os.set_blocking(self._board_fd, False)
        os.set_blocking(self._host_fd, False)
        self.host_path = os.ttyname(self._host_fd)

    def read(self) -> bytes:
        """Read the bytes that the host has sent, which may be none."""
        try:
            return os.read(self._board_fd, _MAX_BYTES_PER_READ)
        except BlockingIOError:
            return b""

    def fill(self) -> None:
        """Fill the way from the host to the board with empty lines, which firmware passes over."""
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(self._host_fd, b"\n" * 64)

    def write(self, data: bytes) -> None:
        """Send what fits. As on a wire, what a host does not read in time is lost."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._board_fd, data)

    def close(self) -> None:
        """Give both ends back."""
        os.close(self._board_fd)
        os.close(self._host_fd)
