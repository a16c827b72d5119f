"""Figures for people: distances with as many digits as their standard deviation supports, in the unit they chose."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from msgspec import Struct

from stadimeter.config.units import FOOT_M, INCH_M
from stadimeter.core.detection import RejectedCandidate

# Stands where there is no figure.
UNKNOWN = "—"

# Nothing is as much as this, whatever the unit; a little more cannot even be rounded.
NO_FIGURE = 1e300


class LengthUnit(Struct, frozen=True, kw_only=True):
    """A unit of length to show distances in: its size in metres, and the most decimals that a figure is shown with."""

    symbol: str
    size_m: float
    decimals_max: int


METRE = LengthUnit(symbol="m", size_m=1.0, decimals_max=3)
CENTIMETRE = LengthUnit(symbol="cm", size_m=0.01, decimals_max=1)
FOOT = LengthUnit(symbol="ft", size_m=FOOT_M, decimals_max=2)
INCH = LengthUnit(symbol="in", size_m=INCH_M, decimals_max=1)

LENGTH_UNITS = {unit.symbol: unit for unit in (METRE, CENTIMETRE, FOOT, INCH)}


def format_distance(distance_m: float | None, sigma_m: float | None = None, unit: LengthUnit = METRE) -> str:
    """Write a distance with its standard deviation, such as ``2.43 m ± 0.04``, both up to the latter's first digit.

    A standard deviation of None or 0 leaves the ``±`` away. Without a distance, or with one that is no number, or
    without an end to its standard deviation, a dash.
    """
    number, plus_minus = distance_figures(distance_m, sigma_m, unit)
    if number == UNKNOWN:
        return UNKNOWN
    return f"{number} {unit.symbol} ± {plus_minus}" if plus_minus else f"{number} {unit.symbol}"


def distance_figures(distance_m: float | None, sigma_m: float | None, unit: LengthUnit) -> tuple[str, str]:
    """Return the two figures of `format_distance` without the unit: a dash and an empty text where there is none."""
    if distance_m is None:
        return UNKNOWN, ""
    value, sigma = distance_m / unit.size_m, (sigma_m or 0.0) / unit.size_m
    if not (abs(value) < NO_FIGURE and 0 <= sigma < NO_FIGURE):
        return UNKNOWN, ""
    decimals = _decimals_of(sigma, unit.decimals_max)
    shown_sigma = max(sigma, 10.0**-unit.decimals_max)  # a tiny one is rounded up: nothing is shown as ± 0
    return _fixed(value, decimals), _fixed(shown_sigma, decimals) if sigma else ""


def format_position(
    position_m: tuple[float, float, float] | None, sigma_m: float | None, unit: LengthUnit = METRE
) -> str:
    """Write a position with the decimals that a standard deviation supports, such as ``(0.12, -0.05, 2.43) m``."""
    if position_m is None:
        return UNKNOWN
    figures = [distance_figures(each, sigma_m, unit)[0] for each in position_m]
    return UNKNOWN if UNKNOWN in figures else f"({', '.join(figures)}) {unit.symbol}"


def format_speed(speed_mps: float | None, sigma_mps: float | None = None, unit: LengthUnit = METRE) -> str:
    """Write a speed such as ``0.21 m/s`` with the digits that its standard deviation supports, two decimals at most.

    A dash if there is none.
    """
    if speed_mps is None:
        return UNKNOWN
    value, sigma = speed_mps / unit.size_m, (sigma_mps or 0.0) / unit.size_m
    if not (abs(value) < NO_FIGURE and 0 <= sigma < NO_FIGURE):
        return UNKNOWN
    return f"{_fixed(value, _decimals_of(sigma, min(2, unit.decimals_max)))} {unit.symbol}/s"


def format_closing(closing_mps: float | None, sigma_mps: float | None = None, unit: LengthUnit = METRE) -> str:
    """Write the speed of approach, such as ``closing 0.21 m/s``, ``leaving 0.21 m/s`` or ``steady``; empty if unknown.

    Args:
        closing_mps: Positive when the distance shrinks.
        sigma_mps: Its standard deviation; a speed that is not twice as large counts as none.
    """
    speed = format_speed(None if closing_mps is None else abs(closing_mps), sigma_mps, unit)
    if closing_mps is None or speed == UNKNOWN:
        return ""
    if abs(closing_mps) <= 2 * (sigma_mps or 0.0) or abs(closing_mps) < 0.005:
        return "steady"
    return f"closing {speed}" if closing_mps > 0 else f"leaving {speed}"


def format_bearing(bearing_rad: float | None) -> str:
    """Write a bearing, positive to the right, in whole degrees: ``3° left`` or ``ahead``; empty if unknown."""
    if bearing_rad is None or not abs(bearing_rad) <= math.tau:
        return ""
    degrees = round(math.degrees(bearing_rad))
    if degrees == 0:
        return "ahead"
    return f"{abs(degrees)}° {'right' if degrees > 0 else 'left'}"


def format_tilt(tilt_rad: float | None) -> str:
    """Write the angle between a normal and the line of sight: ``tilted 14°`` or ``face on``; empty if unknown."""
    if tilt_rad is None or not abs(tilt_rad) <= math.tau:
        return ""
    degrees = round(math.degrees(abs(tilt_rad)))
    return f"tilted {degrees}°" if degrees else "face on"


def format_level(level: float) -> str:
    """Write an actuator's level, from 0 to 1, in per cent; one that is not off never reads as 0."""
    percent = round(level * 100)
    return "<1 %" if level > 0 and percent == 0 else f"{percent} %"


def format_turn(angular_radps: float, tilt_radps: float = 0.0) -> str:
    """Write a rate of turn, positive to the left, such as ``0.10 rad/s``."""
    tilt = f", {_fixed(tilt_radps, 2)} up" if tilt_radps else ""
    return f"{_fixed(angular_radps, 2)} rad/s{tilt}"


def format_time(time_s: float) -> str:
    """Write a time in a run: ``12.3 s``, and from ten minutes on ``10:07`` or ``1:02:03``."""
    if time_s < 600:
        return f"{_fixed(time_s, 1)} s"
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def format_age(age_s: float) -> str:
    """Write the age of a frame: ``34 ms``, and from one second on ``2.1 s``."""
    return f"{round(age_s * 1000)} ms" if age_s < 1 else f"{_fixed(age_s, 1)} s"


def format_place(candidate: RejectedCandidate) -> str:
    """Write the size and the position of a candidate, such as ``24 px at 310, 120``."""
    x, y = candidate.centre_px
    return f"{candidate.size_px:.0f} px at {x:.0f}, {y:.0f}"


def format_best(reason: str, rejected: Sequence[RejectedCandidate]) -> str:
    """Write what looked most like the target, such as ``looked at 24 px at 310, 120: edge scatters by 2.1 px``.

    Args:
        reason: The words beside it: a test that they name is not named again.
        rejected: The candidates, the most like the target first; none gives an empty text.
    """
    if not rejected:
        return ""
    best = rejected[0]
    words = f"looked at {format_place(best)}"
    return words if not best.reason or best.reason in reason else f"{words}: {best.reason}"


# A length or a speed as reasons have it: ``2.43 m ± 0.04``, ``3.05 m (10.0 ft)`` or ``0.21 m/s``.
_LENGTH_IN_WORDS = re.compile(
    r"(?<![\w.])(?P<value>-?\d+(?:\.(?P<decimals>\d+))?) m(?P<speed>/s)?\b"
    r"(?: ± (?P<sigma>\d+\.\d+))?(?: \(-?[\d.]+ ft\))?"
)


def in_unit(words: str, unit: LengthUnit) -> str:
    """Return words with each length and speed in them in a unit, to the place that the words state it to.

    Reasons are put into words in metres, once, so that recordings of a run are the same for everyone.
    """
    return words if unit is METRE else _LENGTH_IN_WORDS.sub(lambda found: _convert(found, unit), words)


def _convert(found: re.Match[str], unit: LengthUnit) -> str:
    value, step = float(found["value"]) / unit.size_m, 10.0 ** -len(found["decimals"] or "") / unit.size_m
    decimals = min(unit.decimals_max, max(0, math.floor(-math.log10(step) + 0.5)))
    plus_minus = f" ± {_fixed(float(found['sigma']) / unit.size_m, decimals)}" if found["sigma"] else ""
    return f"{_fixed(value, decimals)} {unit.symbol}{found['speed'] or ''}{plus_minus}"


def _decimals_of(sigma: float, decimals_max: int) -> int:
    """Return the place of the first digit of ``sigma`` once rounded to it: 0.04 gives 2, 0.096 gives 1, 12 gives -1."""
    if sigma == 0:
        return decimals_max
    return min(decimals_max, -int(f"{sigma:.0e}".partition("e")[2]))


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"  # adding zero turns -0.0 into 0.0
