"""The 40-pin header of a Raspberry Pi (every board since the B+ of 2014), as its documentation has it."""

from __future__ import annotations

POWER_3V3, POWER_5V, GROUND = "3.3 V", "5 V", "ground"

# What each pin is, from pin 1 on: the BCM number of its GPIO, or its supply.
HEADER: tuple[str | int, ...] = (
    POWER_3V3, POWER_5V, 2, POWER_5V, 3, GROUND, 4, 14, GROUND, 15, 17, 18, 27, GROUND, 22, 23, POWER_3V3, 24, 10,
    GROUND, 9, 25, 11, 8, GROUND, 7, 0, 1, 5, GROUND, 6, 12, 13, GROUND, 19, 16, 26, 20, GROUND, 21,
)  # fmt: skip

# GPIOs that are free only where what else uses them is switched off, or never.
TAKEN = {
    0: "the identification of add-on boards (HATs)",
    1: "the identification of add-on boards (HATs)",
    2: "I2C, with a resistor on the board that pulls it up to 3.3 V",
    3: "I2C, with a resistor on the board that pulls it up to 3.3 V",
    14: "the serial console, which drives it high while the Pi boots",
    15: "the serial console, which listens there",
}

# GPIO 0 to 8 are weakly pulled up to 3.3 V from power-up until a program takes them, the others down to ground.
PULLED_UP_MAX = 8


def header_pin(gpio: int) -> int:
    """Return the number of the pin, 1 to 40, of a GPIO by its BCM number, 0 to 27."""
    return HEADER.index(gpio) + 1
