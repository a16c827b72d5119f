"""Quantities with units, as people write them: ``"10 ft"``, ``"24in"``, ``"35 cm"``, ``"250 ms"``.

A small table of our own: the smallest unit libraries cost 300 ms at start-up, and people use these few units.
"""

from __future__ import annotations

import difflib
import math
import re
from typing import Annotated

from pydantic import BeforeValidator

INCH_M = 0.0254
FOOT_M = 0.3048

LENGTHS_M = {
    "mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3,
    "in": INCH_M, "inch": INCH_M, "inches": INCH_M, '"': INCH_M,
    "ft": FOOT_M, "foot": FOOT_M, "feet": FOOT_M, "'": FOOT_M,
    "yd": 0.9144,
}  # fmt: skip
DURATIONS_S = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "h": 3600.0}
SPEEDS_MPS = {"mm/s": 1e-3, "cm/s": 1e-2, "m/s": 1.0, "km/h": 1 / 3.6, "in/s": INCH_M, "ft/s": FOOT_M, "mph": 0.44704}
ACCELERATIONS_MPS2 = {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "cm/s2": 1e-2, "ft/s2": FOOT_M}
ANGLES_RAD = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}
TURN_RATES_RADPS = {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180}
TURN_ACCELERATIONS_RADPS2 = {
    f"{turn}/{time}": size
    for turn, size in (("rad", 1.0), ("deg", math.pi / 180), ("°", math.pi / 180))
    for time in ("s2", "s^2", "s²")
}
FREQUENCIES_HZ = {"Hz": 1.0, "hz": 1.0, "kHz": 1e3}

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


def parse_quantity(text: object, units: dict[str, float], example: str) -> float:
    """Read a number with its unit.

    Args:
        text: What was written.
        units: The units that are meant, each with its size in the SI unit.
        example: How such a quantity may look, for error messages.

    Returns:
        The quantity in the SI unit, finite.

    Raises:
        ValueError: It is not a number with one of the units.
    """
    if isinstance(text, int | float) and not isinstance(text, bool):
        raise ValueError(f"{text} has no unit; write it with one, such as {example!r}")
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a quantity; write it as text, such as {example!r}")
    match = _QUANTITY.fullmatch(text)
    if not match:
        raise ValueError(f"{text!r} is not a number with a unit; write it such as {example!r}")
    number, unit = float(match[1]), match[2]
    if unit not in units:
        raise ValueError(_unit_trouble(text, unit, units, example))
    value = number * units[unit]
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is too large a number")
    return value


def _unit_trouble(text: str, unit: str, units: dict[str, float], example: str) -> str:
    if not unit:
        return f"{text!r} has no unit; write it with one, such as {example!r}"
    close = difflib.get_close_matches(unit, units, n=1, cutoff=0.5)
    guess = f"; did you mean {close[0]!r}?" if close else "."
    return f"{text!r}: unknown unit {unit!r}{guess} Known units: {', '.join(units)}"


def parse_length(text: object) -> float:
    """Read a length such as ``"10 ft"`` and return it in metres; raises ValueError if it is none, or not above 0."""
    value = parse_quantity(text, LENGTHS_M, "35 cm")
    if value <= 0:
        raise ValueError(f"{text!r} is not a length above zero")
    return value


def parse_length_or_zero(text: object) -> float:
    """Read a length that may be zero and return it in metres; raises ValueError if it is none, or below 0."""
    return _not_negative(text, LENGTHS_M, "5 cm")


def parse_duration(text: object) -> float:
    """Read a duration such as ``"250 ms"`` and return it in seconds; raises ValueError if it is none, or below 0."""
    return _not_negative(text, DURATIONS_S, "250 ms")


def parse_speed(text: object) -> float:
    """Read a speed such as ``"0.4 m/s"`` and return it in m/s; raises ValueError if it is none, or below 0."""
    return _not_negative(text, SPEEDS_MPS, "0.4 m/s")


def parse_acceleration(text: object) -> float:
    """Read an acceleration such as ``"0.5 m/s2"``, return it in m/s²; raises ValueError if it is none, or below 0."""
    return _not_negative(text, ACCELERATIONS_MPS2, "0.5 m/s2")


def parse_angle(text: object) -> float:
    """Read an angle such as ``"30 deg"`` and return it in radians; raises ValueError if it is none."""
    return parse_quantity(text, ANGLES_RAD, "30 deg")


def parse_turn_rate(text: object) -> float:
    """Read a rate of turn such as ``"60 deg/s"``, return it in rad/s; raises ValueError if it is none, or below 0."""
    return _not_negative(text, TURN_RATES_RADPS, "60 deg/s")


def parse_turn_acceleration(text: object) -> float:
    """Read a change of the rate of turn such as ``"200 deg/s2"``, return it in rad/s²; ValueError if it is below 0."""
    return _not_negative(text, TURN_ACCELERATIONS_RADPS2, "200 deg/s2")


def parse_frequency(text: object) -> float:
    """Read a frequency such as ``"100 Hz"``, return it in hertz; raises ValueError if it is none, or below 0."""
    return _not_negative(text, FREQUENCIES_HZ, "100 Hz")


def _not_negative(text: object, units: dict[str, float], example: str) -> float:
    value = parse_quantity(text, units, example)
    if value < 0:
        raise ValueError(f"{text!r} is below zero")
    return value


class PinMark:
    """Marks an option that holds the BCM number of a GPIO pin, so that a pin used twice is noticed."""


class PortMark:
    """Marks an option that holds a serial port, so that a port used twice is noticed."""


def _parse_pin(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 27:
        raise ValueError(f"{value!r} is not a pin; write the BCM number of a GPIO, 0 to 27")
    return value


Length = Annotated[float, BeforeValidator(parse_length)]
LengthOrZero = Annotated[float, BeforeValidator(parse_length_or_zero)]
Duration = Annotated[float, BeforeValidator(parse_duration)]
Speed = Annotated[float, BeforeValidator(parse_speed)]
Acceleration = Annotated[float, BeforeValidator(parse_acceleration)]
Angle = Annotated[float, BeforeValidator(parse_angle)]
TurnRate = Annotated[float, BeforeValidator(parse_turn_rate)]
TurnAcceleration = Annotated[float, BeforeValidator(parse_turn_acceleration)]
Frequency = Annotated[float, BeforeValidator(parse_frequency)]
Pin = Annotated[int, BeforeValidator(_parse_pin), PinMark()]
SerialPort = Annotated[str, PortMark()]
