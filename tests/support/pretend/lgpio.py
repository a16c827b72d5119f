"""Stands in for lgpio where there are no pins: what gpiozero calls of it, and what it does to the process on import.

As measured with lgpio 0.2.2: it changes the working directory to LG_WD, and makes its named pipe there.
"""

from __future__ import annotations

import os

SET_PULL_NONE, SET_PULL_UP, SET_PULL_DOWN = 128, 32, 64
RISING_EDGE, FALLING_EDGE, BOTH_EDGES = 1, 2, 3
OUTPUT_MODE = 2

os.chdir(os.environ.get("LG_WD", "."))
os.mkfifo(".lgd-nfy0")

chips = {0}
busy: set[int] = set()
broken: set[int] = set()
opened: list[int] = []
modes: dict[int, str] = {}
levels: dict[int, int] = {}
pulses: dict[int, tuple[float, float]] = {}


class error(Exception):  # noqa: N801, N818 - lgpio's name
    """As lgpio has it: its text is in quotes."""

    def __str__(self) -> str:
        return repr(self.args[0])


def gpiochip_open(chip: int) -> int:
    if chip not in chips:
        raise error("can not open gpiochip")
    opened.append(chip)
    return chip


def gpiochip_close(handle: int) -> None:
    opened.remove(handle)


def gpio_claim_input(handle: int, gpio: int, flags: int = 0) -> None:
    _claim(gpio, "input")


def gpio_claim_output(handle: int, gpio: int, level: int = 0) -> None:
    _claim(gpio, "output")
    levels[gpio] = level


def _claim(gpio: int, mode: str) -> None:
    if gpio in busy:
        raise error("GPIO busy")
    modes[gpio] = mode
    pulses.pop(gpio, None)


def gpio_get_mode(handle: int, gpio: int) -> int:
    return OUTPUT_MODE if modes.get(gpio) == "output" else 0


def gpio_write(handle: int, gpio: int, level: int) -> None:
    if gpio in broken:
        raise error("GPIO not allocated")
    levels[gpio] = int(level)


def gpio_read(handle: int, gpio: int) -> int:
    return levels.get(gpio, 0)


def tx_pwm(handle: int, gpio: int, frequency: float, duty: float) -> None:
    if gpio in broken:
        raise error("GPIO not allocated")
    if frequency == 0:
        pulses.pop(gpio, None)
    else:
        pulses[gpio] = (frequency, duty)
