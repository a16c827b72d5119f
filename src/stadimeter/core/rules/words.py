"""Figures in the reasons that rules give."""

from __future__ import annotations


def metres(value_m: float, sigma_m: float) -> str:
    """Return a distance with its standard deviation, to the centimetre, or to the millimetre if it is that sure.

    Args:
        value_m: The distance.
        sigma_m: Its standard deviation.

    Returns:
        Such as ``2.43 m ± 0.04``.
    """
    digits = 2 if sigma_m >= 0.01 else 3
    return f"{value_m:.{digits}f} m ± {sigma_m:.{digits}f}"


def duration(seconds: float) -> str:
    """Return a duration as people write it, to the last bit.

    Args:
        seconds: In seconds.

    Returns:
        Such as ``8 h``, ``30 min`` or ``90.5 s``.
    """
    for unit, unit_s, least_s in (("h", 3600, 3600), ("min", 60, 120)):
        if seconds >= least_s and seconds % unit_s == 0:
            return f"{seconds / unit_s:g} {unit}"
    return f"{seconds:g} s"
