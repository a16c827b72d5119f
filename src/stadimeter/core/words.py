"""Figures in the words that rules give."""

from __future__ import annotations

import math

FOOT_M = 0.3048
_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")


def metres(value_m: float, sigma_m: float) -> str:
    """Return a distance such as ``2.43 m ± 0.04``, to the centimetre, or to the millimetre if it is that sure.

    What is surer than a millimetre is said to be within one: ``± 0.000`` would claim that there is no error at all.
    """
    digits = 2 if sigma_m >= 0.01 else 3
    return f"{value_m:.{digits}f} m ± {max(sigma_m, 0.001):.{digits}f}"


# Units in which small figures are given, and how many of them are one of the SI unit.
_SMALL_UNITS = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "s": ("ms", 1e3)}


def rounded(value: float, digits: int = 3) -> str:
    """Return a figure with three significant digits and its whole part in full: ``14.7``, ``0.0421``, ``1234``."""
    if not value or not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def short_figure(value: float, unit: str) -> str:
    """Return a figure in its SI unit or a smaller one: ``2.43 m``, ``42.1 mm``, ``0.31 m/s``; angles are in degrees."""
    if unit == "rad":
        value, unit = math.degrees(value), "°"
    is_small = 0 < abs(value) < 0.1
    if unit == "°":
        return f"{rounded(value)}°" if is_small else f"{value:.1f}°"
    if unit == "times" or (is_small and unit not in _SMALL_UNITS):
        return f"{rounded(value)} {unit}"
    smaller, scale = _SMALL_UNITS.get(unit, (unit, 1.0))
    return f"{rounded(value * scale)} {smaller}" if is_small else f"{value:.2f} {unit}"


def uncertain_figure(noun: str, value: float, sigma: float, unit: str) -> str:
    """Return a figure with its standard deviation, such as ``sideways speed 0.31 m/s ± 0.02``."""
    if noun in {"distance", "depth"}:
        return metres(value, sigma)
    sigma = math.degrees(sigma) if unit == "rad" else sigma
    if 0 < abs(value) < 0.1 and unit in _SMALL_UNITS:
        sigma *= _SMALL_UNITS[unit][1]
        return f"{noun} {short_figure(value, unit)} ± {rounded(sigma, 2)}"
    return f"{noun} {short_figure(value, unit)} ± {about(sigma)}"


def about(sigma: float) -> str:
    """Return a standard deviation to the hundredth, or with two significant digits where that is nothing."""
    return rounded(sigma, 2) if 0 < sigma < 0.005 else f"{sigma:.2f}"


def length(value_m: float) -> str:
    """Return a length in metres and in feet, such as ``3.05 m (10.0 ft)``."""
    if 0 < abs(value_m) < 0.1:
        return f"{short_figure(value_m, 'm')} ({rounded(value_m / FOOT_M * 12)} in)"
    return f"{value_m:.2f} m ({value_m / FOOT_M:.1f} ft)"


def figure_in_words(value: float, unit: str) -> str:
    """Return a figure that is in its SI unit, such as ``0.60 m (2.0 ft)``; an angle is in degrees."""
    if unit == "s":
        return _seconds(value)
    return length(value) if unit == "m" else short_figure(value, unit)


_LONG_UNITS = (("h", 3600.0), ("min", 60.0))


def duration(seconds: float) -> str:
    """Return a duration in the largest unit that leaves it whole, such as ``0.2 s``, ``90 s`` or ``8 h``."""
    for unit, unit_s in _LONG_UNITS:
        if seconds >= unit_s and seconds % unit_s == 0:
            return f"{seconds / unit_s:g} {unit}"
    return _seconds(seconds)


def _seconds(seconds: float) -> str:
    """Return seconds as they were written, or rounded if they are no written figure, such as 44/3."""
    exact = f"{seconds:.3f}".rstrip("0").rstrip(".")
    return f"{exact if float(exact) == seconds else rounded(seconds)} s"


def rounded_duration(seconds: float) -> str:
    """Return a measured duration, rounded as people read it: ``0.2 s``, ``12.5 min``, ``8 h``; ``ever`` for infinity.

    Less than nothing counts as nothing: a timer that is due may be looked at a moment later.
    """
    if not math.isfinite(seconds):
        return "ever"
    for unit, unit_s in _LONG_UNITS:
        if seconds >= 2 * unit_s:
            figure = seconds / unit_s
            return f"{figure:.3g} {unit}" if figure < 999.5 else f"{figure:.0f} {unit}"
    return f"{max(0.0, seconds):.1f} s"


def time_of_day(second: float) -> str:
    """Return seconds since midnight as ``22:30``, or as ``22:30:15`` if they are not a whole minute."""
    minutes, seconds = divmod(int(second), 60)
    whole = f"{minutes // 60 % 24:02d}:{minutes % 60:02d}"
    return f"{whole}:{seconds:02d}" if seconds else whole


def day(weekday: int) -> str:
    """Return the name of a weekday, 0 for Monday."""
    return _DAYS[weekday]


def counted(number: int, noun: str) -> str:
    """Return a number of things, such as ``1 test`` or ``2 tests``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def one_line(text: str) -> str:
    """Return a text as a screen can show it: one line, no control characters."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else " " for character in text)
