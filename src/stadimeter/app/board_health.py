"""The temperature and the supply of a board, as its kernel and its firmware report them.

Sources: ``/sys/class/thermal`` and the kernel's hwmon driver ``rpi_volt`` (Linux documentation); the bits of
``vcgencmd get_throttled`` are those of Raspberry Pi's documentation, "Raspberry Pi OS", section ``get_throttled``. The
kernel of Raspberry Pi OS gives the same number, in hexadecimal, in a file of its firmware driver.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

# From here on a Raspberry Pi slows its processor; a 3B+ from 60 °C.
THERMAL = "sys/class/thermal/thermal_zone0/temp"
THROTTLED = "sys/bus/platform/drivers/raspberrypi-firmware/*/get_throttled"
HOT_C = 70.0
THROTTLED_C = 80.0

# The same bits, this much higher, stay set from their first time until the next start.
SUPPLY_BITS = {0: "under-voltage"}
HEAT_BITS = {1: "its clock is capped", 2: "throttled", 3: "slowed by heat"}
SINCE_START = 16


class Throttling(NamedTuple):
    """What the firmware says of supply and heat, in words: at this moment, and at any time since the start."""

    now: tuple[str, ...]
    before: tuple[str, ...]


def throttling(bits: int) -> Throttling:
    """Return what the number of ``vcgencmd get_throttled`` means."""
    meanings = {**SUPPLY_BITS, **HEAT_BITS}
    return Throttling(
        now=tuple(words for bit, words in meanings.items() if bits >> bit & 1),
        before=tuple(words for bit, words in meanings.items() if bits >> (bit + SINCE_START) & 1),
    )


def throttled_now(root: Path = Path("/")) -> tuple[str, ...]:
    """Return what is wrong with supply and heat at this moment, as far as the kernel says; starts no program."""
    for file in sorted(root.glob(THROTTLED)):
        try:
            return throttling(int(file.read_text("ascii"), 16)).now
        except (OSError, ValueError):
            continue
    return (SUPPLY_BITS[0],) if is_under_voltage(root) else ()


def temperature_c(root: Path = Path("/")) -> float | None:
    """Return the temperature of the processor; None where the kernel does not say."""
    try:
        return int((root / THERMAL).read_text("ascii")) / 1000
    except (OSError, ValueError):
        return None


def is_under_voltage(root: Path = Path("/")) -> bool | None:
    """Return whether a Raspberry Pi's supply is too low at this moment; None where the kernel does not say."""
    for folder in sorted((root / "sys/class/hwmon").glob("hwmon*")):
        try:
            if (folder / "name").read_text("ascii").strip() == "rpi_volt":
                return (folder / "in0_lcrit_alarm").read_text("ascii").strip() == "1"
        except (OSError, ValueError):
            continue
    return None
