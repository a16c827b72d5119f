"""The one way to a serial port: opened for us alone, never waiting long, and with errors that say what to do."""

from __future__ import annotations

import errno
import termios
import time

import serial
from serial.tools import list_ports

from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError

WRITE_TIMEOUT_S = 0.05
DRAIN_TIMEOUT_S = 0.1

_MOST_BYTES_A_READ = 4096
_ABSENT = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_TAKEN = {errno.EBUSY, errno.EAGAIN}
_FORBIDDEN = {errno.EACCES, errno.EPERM}


class SerialLink:
    """A serial port that carries bytes.

    Opening it resets most Arduinos, because it raises DTR.

    Args:
        path: The port, best as ``/dev/serial/by-id/…``, which does not change when something else is plugged in.
        baud: The speed of the line in bits per second.
    """

    def __init__(self, path: str, baud: int) -> None:
        self._path = path
        self._baud = baud
        self._port: serial.Serial | None = None

    @property
    def path(self) -> str:
        """The port."""
        return self._path

    def open(self) -> None:
        """Open the port and lock it, so that no second program can mix its bytes with ours.

        Raises:
            DeviceOpenError: It is absent, in use, not ours to open, or no serial port.
        """
        try:
            self._port = serial.Serial(self._path, self._baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise DeviceOpenError(_open_trouble(self._path, error)) from error

    def write(self, frame: bytes) -> None:
        """Hand a frame to the port, in one write.

        Args:
            frame: The bytes.

        Raises:
            DeviceClosedError: The port is not open.
            LinkLostError: The port is gone, or has not taken the frame within `WRITE_TIMEOUT_S`. Part of the frame may
                have been sent.
        """
        port = self._opened()
        try:
            port.write(frame)
        except serial.SerialTimeoutException as error:
            raise LinkLostError(
                f"the serial port {self._path} has taken no bytes for {WRITE_TIMEOUT_S * 1e3:.0f} ms; "
                "the other end does not read: check the base and its cable"
            ) from error
        except OSError as error:
            raise self._lost(error) from error

    def read(self) -> bytes:
        """Return what has arrived, which may be nothing. Never waits.

        Raises:
            DeviceClosedError: The port is not open.
            LinkLostError: The port is gone.
        """
        port = self._opened()
        try:
            return port.read(_MOST_BYTES_A_READ)
        except OSError as error:
            raise self._lost(error) from error

    def drain(self) -> None:
        """Wait until everything written has left the computer, for at most `DRAIN_TIMEOUT_S`.

        Raises:
            DeviceClosedError: The port is not open.
            LinkLostError: The port is gone, or the bytes have not left in time.
        """
        port = self._opened()
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        try:
            while port.out_waiting and time.monotonic() < deadline_s:
                time.sleep(0.001)
            left = port.out_waiting
        except OSError as error:
            raise self._lost(error) from error
        if left:
            raise LinkLostError(f"the last {left} bytes to the serial port {self._path} have not left in time")

    def close(self) -> None:
        """Release the port. May be called any number of times."""
        port, self._port = self._port, None
        if port:
            port.close()

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceClosedError(f"the serial port {self._path} is not open")
        return self._port

    def _lost(self, error: OSError) -> LinkLostError:
        return LinkLostError(f"the serial port {self._path} is gone, was the base unplugged? ({error})")


def _open_trouble(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number in _ABSENT:
        return f"there is no serial port {path}; {_existing_ports()}"
    if number in _TAKEN:
        return f"the serial port {path} is already open in another program, or twice in this one; close the other"
    if number in _FORBIDDEN:
        return (
            f"the serial port {path} is not yours to open; "
            "add yourself to the group dialout (sudo usermod -aG dialout $USER), then log in again"
        )
    return f"the serial port {path} cannot be opened: {error}"


def _existing_ports() -> str:
    found = sorted(port.device for port in list_ports.comports())
    return f"these exist: {', '.join(found)}" if found else "none is plugged in: check the cable"
