"""Drives pins by the kernel's GPIO character device: ``python3 drive_pins.py [--check] low=18,27 high=5``.

`safe-outputs` calls it where neither pinctrl nor raspi-gpio is there. It needs the standard library only. The kernel of
Raspberry Pi OS keeps a pin at its level when the process has ended; other kernels, and one with ``strict_gpiod``, make
it an input, and the resistor that every output has takes it to its off side.

With ``--check`` nothing is driven. The exit code is 1 where a pin could not be, or cannot be driven.
"""

from __future__ import annotations

import fcntl
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

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


def header_chip(folder: Path) -> int:
    """Open the chip of the header, and return its descriptor."""
    for path in sorted(folder.glob("gpiochip*")):
        chip = os.open(path, os.O_RDWR | os.O_CLOEXEC)
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
            struct.pack("I", pin), b"stadimeter safe-outputs", FLAG_OUTPUT, 1, OUTPUT_VALUES, 0, int(high), 1, 1, 0, 0
        )
    )
    fcntl.ioctl(chip, GET_LINE, request)
    os.close(LINE_REQUEST.unpack(request)[-1])


def look(chip: int, pin: int) -> None:
    """Ask for a pin without touching it."""
    fcntl.ioctl(chip, GET_LINE_INFO, bytearray(LINE_INFO.pack(b"", b"", pin, 0, 0)))


def wanted(words: list[str]) -> Iterator[tuple[int, str]]:
    """Yield each pin with its level, of words such as ``low=18,27``."""
    for word in words:
        level, _, pins = word.partition("=")
        yield from ((int(pin), level) for pin in pins.split(",") if pin)


def main(words: list[str], folder: Path = Path("/dev")) -> int:
    """Drive or check each pin, whatever happened to the others."""
    is_check = words[:1] == ["--check"]
    failed = 0
    try:
        chip = header_chip(folder)
    except OSError as error:
        print(f"safe-outputs: {error.strerror}", file=sys.stderr)
        return 1
    for pin, level in wanted(words[is_check:]):
        try:
            look(chip, pin) if is_check else drive(chip, pin, high=level == "high")
        except OSError as error:
            failed += 1
            print(f"safe-outputs: pin {pin}: not driven {level}: {error.strerror}", file=sys.stderr)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
