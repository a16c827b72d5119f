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
