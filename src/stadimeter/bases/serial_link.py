"""The one way to a serial port, opened for us alone, and the first exchange with a base that may still be booting."""

from __future__ import annotations

import errno
import itertools
import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import serial
from msgspec import Struct
from serial.tools import list_ports

from stadimeter.bases.serial_codec import Answers, BaseMessage, SerialCodec
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError

# The one way to a serial port: opened for us alone, never waiting long, and with errors that say what to do -----------

# A port that still holds bytes back after this long is a port whose other end does not read.
UNTAKEN_AFTER_S = 0.05

DRAIN_TIMEOUT_S = 0.1

_MAX_BYTES_PER_READ = 4096
_ABSENT = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_TAKEN = {errno.EBUSY, errno.EAGAIN}
_FORBIDDEN = {errno.EACCES, errno.EPERM}


class SerialLink:
    """A serial port, `path`, that carries bytes.

    Opening it resets most Arduinos, because it raises DTR.

    A time-out that is measured with one's own clock blames the other side for one's own delay: this process may wait
    for a processor longer than any limit here, while the port took every byte. So a limit only says when to look once
    more, and what counts is what is left then. pyserial's own write goes wrong both ways: with a ``write_timeout``
    above 0 it reports a frame that was taken whole, but late, and with 0 it never returns from a port that is full.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        self._baud = baud
        self._port: serial.Serial | None = None

    def open(self) -> None:
        """Open the port and lock it, so that no second program can mix its bytes with ours."""
        try:
            self._port = serial.Serial(self.path, self._baud, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise DeviceOpenError(_open_trouble(self.path, error)) from error

    def write(self, frame: bytes) -> None:
        """Hand a frame to the port: at once as a rule, else as the other end makes room.

        Raises:
            LinkLostError: The port is gone, or bytes of the frame remain after `UNTAKEN_AFTER_S`. Part of the frame
                may have been sent. What waited in the port is thrown away: the next frame, mostly a stop, shall neither
                find it full nor come after commands from before.
        """
        deadline_s = time.monotonic() + UNTAKEN_AFTER_S
        left = frame[self._offer(frame) :]
        while left:
            wait_s = deadline_s - time.monotonic()
            if wait_s > 0:
                self._wait_for_room(wait_s)
            left = left[self._offer(left) :]
            if left and wait_s <= 0:
                self.discard()
                raise LinkLostError(
                    f"the serial port {self.path} has not taken {len(left)} bytes in {UNTAKEN_AFTER_S * 1e3:.0f} ms; "
                    "the other end does not read: check the base and its cable"
                )

    def read(self) -> bytes:
        """Read the bytes that have arrived, if any; never waits. Raises `LinkLostError` if the port is gone."""
        port = self._opened()
        try:
            return port.read(_MAX_BYTES_PER_READ)
        except OSError as error:
            raise self._lost(error) from error

    def drain(self) -> None:
        """Wait until everything written has left the computer; raises `LinkLostError` after `DRAIN_TIMEOUT_S`."""
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        while self.waiting() and time.monotonic() < deadline_s:
            time.sleep(0.001)
        if left := self.waiting():
            raise LinkLostError(f"the last {left} bytes to the serial port {self.path} have not left in time")

    def close(self) -> None:
        """Release the port, without what has not left it: the system may wait for that for half a minute.

        May be called any number of times.
        """
        with suppress(LinkLostError):
            if self._port and self.waiting():
                self.discard()
        port, self._port = self._port, None
        if port:
            port.close()

    def _offer(self, data: bytes) -> int:
        """Offer bytes to the port, and return how many it took."""
        descriptor = self._opened().fileno()
        try:
            return os.write(descriptor, data)  # pyserial opens the port so that this never waits
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._lost(error) from error

    def waiting(self) -> int:
        """Return the number of bytes that have not left the port."""
        port = self._opened()
        try:
            return port.out_waiting
        except OSError as error:
            raise self._lost(error) from error

    def discard(self) -> None:
        """Throw away what has not left the port. The other end may have the beginning of a frame."""
        with suppress(OSError, termios.error):
            self._opened().reset_output_buffer()

    def _wait_for_room(self, seconds: float) -> None:
        waiting = select.poll()
        waiting.register(self._opened().fileno(), select.POLLOUT)
        waiting.poll(seconds * 1e3)

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceClosedError(f"the serial port {self.path} is not open")
        return self._port

    def _lost(self, error: OSError) -> LinkLostError:
        return LinkLostError(f"the serial port {self.path} is gone, was the base unplugged? ({error})")


def port_lacks(path: str) -> tuple[str, ...]:
    """Return why a port cannot be opened, as far as that shows without opening it, which would reset an Arduino."""
    if not Path(path).exists():
        return (_open_trouble(path, FileNotFoundError(errno.ENOENT, path)),)
    if not os.access(path, os.R_OK | os.W_OK):
        return (_open_trouble(path, PermissionError(errno.EACCES, path)),)
    return ()


def _open_trouble(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number in _ABSENT:
        return f"there is no serial port {path}; {_existing_ports()}"
    if number in _TAKEN:
        return f"the serial port {path} is already open in another program, or twice in this one; close the other"
    if number in _FORBIDDEN:
        return (
            f"this user may not use the serial port {path}; "
            "add yourself to the group dialout (sudo usermod -aG dialout $USER), then log in again"
        )
    return f"the serial port {path} cannot be opened: {error}"


def _existing_ports() -> str:
    found = sorted(port.device for port in list_ports.comports())
    return f"these exist: {', '.join(found)}" if found else "none is plugged in: check the cable"


# The first exchange with a base on a serial port that was just opened; the base may still be booting ------------------

_ASKED_EVERY_S = 0.2
_READ_EVERY_S = 0.02
_ANSWER_WITHIN_S = 0.5

# What changes the mode of a base has this long to take effect: a Roomba takes nothing for 20 ms meanwhile.
TAKES_EFFECT_S = 0.03


class Greeting(Struct, kw_only=True):
    """Waits for a base, sets its time-out, and leaves it standing.

    Each try begins with the end of a frame and a stop. A base that drove when an earlier program died shall not drive
    on while we ask, and half a command of that program shall not swallow our stop.
    """

    link: SerialLink
    clock: Clock
    codec: SerialCodec
    boot_wait_s: float

    def run(self) -> None:
        """Wait until the base answers, send what opens it, and stop it.

        Raises:
            DeviceOpenError: Nothing answers, or not as this base does.
            ProtocolError: The base refuses to drive.
            LinkLostError: The port is gone.
        """
        if self.codec.answers is Answers.NEVER:
            self._stand_for(self.boot_wait_s)
            self.codec.feed(self.link.read())
        elif self._identify() > 1 and self.codec.answers is Answers.EACH_COMMAND:
            self._let_late_answers_pass()
        self._check_trouble()
        for frame in (*self.codec.opening, self.codec.stop):
            self._send(frame)
            if self.codec.answers is Answers.EACH_COMMAND:
                self._confirm(frame)
            else:
                self._pause(_READ_EVERY_S)

    def _identify(self) -> int:
        """Ask until the base shows what it is, and return how often it was asked."""
        deadline_s = self.clock.now_s() + self.boot_wait_s
        for tries in itertools.count(1):
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            for frame in self.codec.wake:
                self._send(frame)
                self._pause(TAKES_EFFECT_S)
            if self.codec.question:
                self._pause(self.codec.gap_s)
                self._send(self.codec.question)
            is_known = any(message.is_identity for message in self._messages_for(_ASKED_EVERY_S))
            if is_known and (self.codec.answers is Answers.EACH_COMMAND or self._is_awake()):
                return tries
            if self.clock.now_s() >= deadline_s:
                break
        self._check_trouble()
        raise DeviceOpenError(self._no_answer_error())

    def _check_trouble(self) -> None:
        if self.codec.trouble:
            raise ProtocolError(f"no {self.codec.name} that drives is at {self.link.path}: {self.codec.trouble}")

    def _stand_for(self, seconds: float) -> None:
        """Send stops to a base that answers nothing, until it must have booted."""
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            self._pause(min(_ASKED_EVERY_S, end_s - self.clock.now_s()))

    def _let_late_answers_pass(self) -> None:
        """Several tries may have been answered at once, after the boot. None of them shall pass for a later answer."""
        end_s = self.clock.now_s() + self.boot_wait_s  # something that is no base may talk for ever
        while self.clock.now_s() < end_s and any(True for _ in self._messages_for(_ANSWER_WITHIN_S)):
            pass

    def _is_awake(self) -> bool:
        """Check whether a base that has shown what it is will drive; wait for that while it is woken.

        It may have shown it by late reports from before, of a former connection too; what follows says that it does not
        drive, until it does. If it does not, what woke it was lost, and it must be woken again.
        """
        reports = self._messages_for(_ASKED_EVERY_S)
        while self.codec.trouble and next(reports, None) is not None:
            pass
        return not self.codec.trouble

    def _confirm(self, frame: bytes) -> None:
        for message in self._messages_for(_ANSWER_WITHIN_S):
            if message.was_done:
                return
            if message.was_done is False:
                raise ProtocolError(f"the base at {self.link.path} refuses to drive; {self.codec.refusal_hint}")
        raise DeviceOpenError(
            f"the base at {self.link.path} has answered, but does not acknowledge {frame!r}; "
            f"is it one of {self.codec.name}?"
        )

    def _messages_for(self, seconds: float) -> Iterator[BaseMessage]:
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._pause(min(_READ_EVERY_S, end_s - self.clock.now_s()))
            yield from self.codec.feed(self.link.read())

    def _send(self, frame: bytes) -> None:
        self.codec.note_sent(frame)
        self.link.write(frame)

    def _pause(self, seconds: float) -> None:
        self.clock.sleep_until_s(self.clock.now_s() + seconds)

    def _no_answer_error(self) -> str:
        heard = self.codec.dropped_bytes
        what = f"only {heard} bytes without meaning came" if heard else "nothing answers"
        return (
            f"no {self.codec.name} at {self.link.path}: {what} in {self.boot_wait_s:g} s; {self.codec.hint}, "
            "and that this is the right port"
        )
