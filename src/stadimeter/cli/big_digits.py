"""Digits three rows high, to be read from across a room."""

from __future__ import annotations

_DIGITS = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": ("▀█ ", " █ ", "▀▀▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    ".": (" ", " ", "▀"),
    "-": ("  ", "▀▀", "  "),
    "—": ("   ", "▀▀▀", "   "),
}


def big_digits(number: str) -> tuple[str, str, str]:
    """Write a number large.

    Args:
        number: Made of digits, a point and a minus sign, or the dash that stands for no number.

    Returns:
        Three rows of the same width.

    Raises:
        KeyError: There is something else in it.
    """
    rows = [" ".join(_DIGITS[character][row] for character in number) for row in range(3)]
    return rows[0], rows[1], rows[2]
