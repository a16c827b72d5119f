"""Similar triangles: the whole of pinhole ranging in two formulas.

An object of width W at the distance D from a pinhole, square to the optical axis, appears P pixels wide at a focal
length of F pixels, with ``P / F = W / D``: the triangle before the pinhole and the one behind it are similar. A
textbook rule (R. Szeliski, Computer Vision: Algorithms and Applications, 2nd edition, section 2.1.4).

D is the depth: the distance along the optical axis.
"""

from __future__ import annotations

import math


def focal_length_px(apparent_px: float, distance_m: float, size_m: float) -> float:
    """Return the focal length F = P · D / W.

    Args:
        apparent_px: How large the object appears, P.
        distance_m: How deep it lies, D.
        size_m: How large it is, W.

    Returns:
        The focal length in pixels.

    Raises:
        ValueError: A value is not a finite number above zero.
    """
    _check(apparent_px=apparent_px, distance_m=distance_m, size_m=size_m)
    return apparent_px * distance_m / size_m


def distance_m(focal_px: float, size_m: float, apparent_px: float) -> float:
    """Return the distance D = W · F / P.

    Args:
        focal_px: The focal length in pixels, F.
        size_m: How large the object is, W.
        apparent_px: How large it appears in pixels, P.

    Returns:
        How deep it lies, in metres.

    Raises:
        ValueError: A value is not a finite number above zero.
    """
    _check(focal_px=focal_px, size_m=size_m, apparent_px=apparent_px)
    return size_m * focal_px / apparent_px


def _check(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} is not a finite number above zero")
