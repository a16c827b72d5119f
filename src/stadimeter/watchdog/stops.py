"""Makes every output of a plan safe: pins, ports and buses beside each other, so that none keeps another waiting."""

from __future__ import annotations

import _thread
import fcntl
import os
import select
import termios
import time

from stadimeter.watchdog.gpio import drive_pins
from stadimeter.watchdog.plan import FRAME_BYTES_MAX, SafePlan, read_hex

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# systemd gives what runs after a service 2 s (TimeoutStopSec).
WITHIN_S = 1.5

# A port that takes no byte for this long is one whose other end does not read.
TAKEN_WITHIN_S = 0.3

# A bus may be held, or a cable out, for a moment; and a motor chip goes on as before until it is written to.
TRIED_FOR_S, TRIED_EVERY_S = 1.0, 0.05

# linux/i2c-dev.h: which device on the bus is written to, and after how many times 10 ms a transfer has failed. Without
# it a bus that is held keeps each write waiting for a second.
I2C_SLAVE, I2C_TIMEOUT = 0x0703, 0x0702


def make_safe(plan: SafePlan, within_s: float = WITHIN_S) -> list[str]:
    """Make every output safe; return what could not be, in words. A part that hangs is left behind after the time."""
    complaints: list[str] = []
    parts: dict[str, tuple[Callable[..., object], tuple[object, ...]]] = {}
    if plan.pins:
        parts["pins"] = (drive_pins, (plan.pins,))
    for port, stops in plan.serial.items():
        parts[f"serial {port}"] = (stop_port, (port, stops))
    for bus in sorted({bus for bus, _, _ in plan.i2c}):  # devices of one bus one after the other
        parts[f"i2c {bus}"] = (stop_bus, (plan, bus))
    waiting = set(parts)
    for name, (stop, what) in parts.items():
        _thread.start_new_thread(_do, (name, stop, (*what, complaints), waiting))
    until_s = time.monotonic() + within_s
    while waiting and time.monotonic() < until_s:
        time.sleep(0.001)
    return [*complaints, *(f"{name}: hangs" for name in sorted(waiting))]


def _do(name: str, stop: Callable[..., object], what: tuple[Any, ...], waiting: set[str]) -> None:
    try:
        stop(*what)
    except Exception as error:  # noqa: BLE001 - whatever it is, the other parts must be made safe and this one named
        what[-1].append(f"{name}: {type(error).__name__}: {error}")
    waiting.discard(name)


def stop_port(port: str, stops: list[tuple[str, str]], complaints: list[str]) -> None:
    """Send a port what stops the device on it, one frame after the other.

    Opening it raises DTR, which resets most Arduinos: that stops their motors too.
    """
    place = os.path.realpath(port)
    # A terminal line, whatever links lead there, and not a disk or /dev/mem. Only root can make files there.
    if not (place[:8] == "/dev/tty" and place[8:9].isupper()) and not place.removeprefix("/dev/pts/").isdigit():
        complaints.append(f"serial {port}: there is no such port")
        return
    for baud, hex_digits in stops:
        frame = read_hex(hex_digits, FRAME_BYTES_MAX)
        speed = getattr(termios, f"B{baud}", None) if baud.isdigit() else None
        if speed is None:
            complaints.append(f"serial {port}: '{baud}' is not a number of baud")
        elif frame is None:
            said = f"'{hex_digits}' is not 1 to {FRAME_BYTES_MAX} bytes in small hexadecimal digits"
            complaints.append(f"serial {port}: {said}")
        else:
            _send_to_port(port, place, speed, frame, complaints)


def _send_to_port(port: str, place: str, speed: int, frame: bytes, complaints: list[str]) -> None:
    try:
        line = os.open(place, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        is_absent = isinstance(error, FileNotFoundError)
        complaints.append(f"serial {port}: {'there is no such port' if is_absent else error.strerror}")
        return
    try:
        # Raw, 8 bits, and neither modem lines nor flow control are waited for.
        control = termios.tcgetattr(line)[6]
        raw = termios.CS8 | termios.CREAD | termios.CLOCAL
        termios.tcsetattr(line, termios.TCSANOW, [0, 0, raw, 0, speed, speed, control])
        if left := _write(line, frame):
            termios.tcflush(line, termios.TCOFLUSH)  # or closing would wait for it
            complaints.append(f"serial {port}: the stop was not sent, {left} bytes were not taken")
    except (OSError, termios.error) as error:
        complaints.append(f"serial {port}: the stop was not sent: {error.args[-1]}")
    finally:
        os.close(line)


def _write(line: int, frame: bytes) -> int:
    """Write a frame; return how many bytes were not taken.

    A port that is full holds commands of the program that is gone. They are thrown away: the stop comes first.
    """
    until_s = time.monotonic() + TAKEN_WITHIN_S
    while frame and time.monotonic() < until_s:
        try:
            frame = frame[os.write(line, frame) :]
        except BlockingIOError:
            termios.tcflush(line, termios.TCOFLUSH)
            select.select([], [line], [], 0.01)
    return len(frame)


def stop_bus(plan: SafePlan, at_bus: int, complaints: list[str]) -> None:
    """Write to each device on an I2C bus what stops it, whatever became of the others; try again those that failed."""
    until_s = time.monotonic() + TRIED_FOR_S
    left = [(address, writes) for bus, address, writes in plan.i2c if bus == at_bus]
    while True:
        failed = {}
        for address, writes in left:
            try:
                _write_to_device(f"/dev/i2c-{at_bus}", address, writes)
            except OSError as trouble:
                failed[address] = trouble
        left = [(address, writes) for address, writes in left if address in failed]
        is_absent = any(isinstance(error, FileNotFoundError) for error in failed.values())
        if not left or is_absent or time.monotonic() >= until_s:
            break
        time.sleep(TRIED_EVERY_S)
    for address, error in failed.items():
        complaints.append(f"i2c {at_bus} {address:#04x}: not stopped: {error.strerror}")


def _write_to_device(bus: str, address: int, writes: list[bytes]) -> None:
    device = os.open(bus, os.O_RDWR | os.O_CLOEXEC)
    try:
        fcntl.ioctl(device, I2C_SLAVE, address)
        fcntl.ioctl(device, I2C_TIMEOUT, 3)
        for each in writes:
            os.write(device, each)
    finally:
        os.close(device)
