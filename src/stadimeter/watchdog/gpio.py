"""Drives pins from outside the program: by `pinctrl`, by `raspi-gpio`, or by the kernel's GPIO character device.

The kernel of Raspberry Pi OS keeps a pin at its level when the process has ended; other kernels, and one with
``strict_gpiod``, make it an input, and the resistor that every output has takes it to its off side.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct

# linux/gpio.h, version 2 of the interface (Linux 5.10).
CHIP_INFO = struct.Struct("32s32sI")
LINE_INFO = struct.Struct("32s32sIIQ160x16x")
LINE_REQUEST = struct.Struct("256s32sQI20xIIQQ216xII20xi")
"""Offsets, consumer; flags, number of attributes, the first attribute (id, padding, values, mask), room for nine more;
number of lines, size of the event buffer, descriptor."""
GET_CHIP_INFO = 0x8044B401
GET_LINE_INFO = 0xC100B405
GET_LINE = 0xC250B407
FLAG_OUTPUT = 1 << 3
OUTPUT_VALUES = 2

HEADERS = (b"pinctrl-bcm2835", b"pinctrl-bcm2711", b"pinctrl-rp1")
"""The labels of the chips whose lines 0 to 27 are the header's pins: of a Pi up to 3 and Zero 2, 4, and 5. Their number
depends on the kernel."""

# pinctrl since Raspberry Pi OS 12, raspi-gpio before.
TOOLS = ("pinctrl", "raspi-gpio")
TOOL_WITHIN_S = 0.4

KERNEL = "/dev/gpiochip"
NOTHING = "nothing"


def drive_pins(pins: dict[int, bool], complaints: list[str], *, is_check: bool = False, folder: str = "/dev") -> str:
    """Drive pins to their levels by the first way that works, or only see which way would.

    Args:
        pins: By number, whether the level is high.
        complaints: Gets what could not be driven, in words.
        folder: Where the chips are.

    Returns:
        The way: a tool's name, `KERNEL` or `NOTHING`.
    """
    levels = {"dl": _numbers(pins, is_high=False), "dh": _numbers(pins, is_high=True)}
    for tool in TOOLS:
        sets = [(tool, "set", numbers, "op", level) for level, numbers in levels.items() if numbers]
        asks = [(tool, "get", next(filter(None, levels.values())))]
        if all(_run(command) for command in (asks if is_check else sets)):
            return tool
    failed: list[str] = []
    if _drive_by_kernel(pins, failed, is_check=is_check, folder=folder):
        return KERNEL
    complaints += failed
    words = "".join(f"{name}: {levels[level]} " for level, name in (("dl", "low"), ("dh", "high")) if levels[level])
    if not is_check:
        complaints.append(f"pins {words}are NOT driven: neither {', '.join(TOOLS)} nor the kernel could do it")
    return NOTHING


def _numbers(pins: dict[int, bool], *, is_high: bool) -> str:
    return ",".join(str(pin) for pin in sorted(pins) if pins[pin] is is_high)


def _run(command: tuple[str, ...]) -> bool:
    """Run a program for a moment; return whether it succeeded. `subprocess` would cost as much memory as all this."""
    nowhere = [(os.POSIX_SPAWN_OPEN, each, "/dev/null", os.O_RDWR, 0) for each in (0, 1)]
    try:
        pid = os.posix_spawnp(command[0], command, os.environ, file_actions=nowhere)
    except OSError:
        return False
    ended = os.pidfd_open(pid)
    try:
        if not select.select([ended], [], [], TOOL_WITHIN_S)[0]:
            os.kill(pid, 9)
    finally:
        os.close(ended)
    return os.waitpid(pid, 0)[1] == 0


def _drive_by_kernel(pins: dict[int, bool], failed: list[str], *, is_check: bool, folder: str) -> bool:
    """Drive each pin, whatever happened to the others; return whether all could be."""
    try:
        chip = header_chip(folder)
    except OSError as error:
        failed.append(str(error.strerror))
        return False
    try:
        for pin, high in sorted(pins.items()):
            try:
                look(chip, pin) if is_check else drive(chip, pin, high=high)
            except OSError as error:
                failed.append(f"pin {pin}: not driven {'high' if high else 'low'}: {error.strerror}")
    finally:
        os.close(chip)
    return not failed


def header_chip(folder: str) -> int:
    """Open the chip of the header, and return its descriptor."""
    for name in sorted(each for each in os.listdir(folder) if each.startswith("gpiochip")):  # noqa: PTH208 - as above
        chip = os.open(f"{folder}/{name}", os.O_RDWR | os.O_CLOEXEC)
        info = bytearray(CHIP_INFO.size)
        fcntl.ioctl(chip, GET_CHIP_INFO, info)
        if CHIP_INFO.unpack(info)[1].rstrip(b"\0") in HEADERS:
            return chip
        os.close(chip)
    raise OSError(0, f"no {folder}/gpiochip* is a Raspberry Pi's header")


def drive(chip: int, pin: int, *, high: bool) -> None:
    """Make a pin an output with this level."""
    request = bytearray(
        LINE_REQUEST.pack(
            struct.pack("I", pin), b"stadimeter watchdog", FLAG_OUTPUT, 1, OUTPUT_VALUES, 0, int(high), 1, 1, 0, 0
        )
    )
    fcntl.ioctl(chip, GET_LINE, request)
    os.close(LINE_REQUEST.unpack(request)[-1])


def look(chip: int, pin: int) -> None:
    """Ask for a pin without touching it."""
    fcntl.ioctl(chip, GET_LINE_INFO, bytearray(LINE_INFO.pack(b"", b"", pin, 0, 0)))
