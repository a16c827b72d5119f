"""The bending of straight lines by a lens, and the way back.

The model is the one of OpenCV's calibration with five coefficients, in this order: k1, k2, p1, p2, k3. A direction
(x, y) per unit of depth, with s = x² + y², appears at

    x' = x·R + 2·p1·x·y + p2·(s + 2·x²)
    y' = y·R + p1·(s + 2·y²) + 2·p2·x·y        with R = 1 + k1·s + k2·s² + k3·s³

(D. C. Brown, Decentering distortion of lenses, Photogrammetric Engineering 32, 1966). The polynomial turns around at
some angle, where further out would appear further in; beyond this reach it says nothing about the lens. There is no
formula for the way back; Newton's method finds it, quadratically, since the Jacobian is known and symmetric.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stadimeter.errors import CalibrationError

Coefficients = tuple[float, ...]
Points = NDArray[np.float64]
Numbers = TypeVar("Numbers", float, Points)

# Newton's method needs three to six steps on real lenses; what needs more does not arrive.
_STEPS = 20

# Coefficients of real lenses stay below a few hundred.
_BEYOND_REASON = 1e6

# Per unit of depth: far below a millionth of a pixel.
_CLOSE_ENOUGH = 1e-11


def check_coefficients(coefficients: Coefficients) -> None:
    """Refuse coefficients that are not those of a lens.

    Args:
        coefficients: None, or k1 k2 p1 p2, or k1 k2 p1 p2 k3.

    Raises:
        CalibrationError: There is another number of them, or one is not finite or beyond reason.
    """
    if len(coefficients) not in {0, 4, 5}:
        raise CalibrationError(
            f"distortion has {len(coefficients)} coefficients; write none, or k1, k2, p1, p2, or k1, k2, p1, p2, k3",
            "distortion",
        )
    if not all(abs(each) < _BEYOND_REASON for each in coefficients):
        raise CalibrationError(f"distortion {list(coefficients)} has a coefficient that no lens has", "distortion")


def distorted(directions: Points, coefficients: Coefficients) -> Points:
    """Return where directions appear.

    Args:
        directions: x to the right and y down per unit of depth, shape (n, 2).
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The bent directions, shape (n, 2); NaN for those that are out of the lens's reach.
    """
    x, y = directions[:, 0], directions[:, 1]
    within = np.where(x * x + y * y < _reach(coefficients), 1.0, np.nan)
    bent_x, bent_y = _bent(x, y, coefficients)
    return np.column_stack((bent_x * within, bent_y * within))


def distorted_direction(x: float, y: float, coefficients: Coefficients) -> tuple[float, float]:
    """Return where one direction appears, without the cost of arrays.

    Args:
        x: To the right, per unit of depth.
        y: Down, per unit of depth.
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The bent direction; NaN where it is out of the lens's reach.
    """
    return _bent(x, y, coefficients) if x * x + y * y < _reach(coefficients) else (math.nan, math.nan)


def undistorted(appearing: Points, coefficients: Coefficients) -> Points:
    """Return which directions appear at some places: the inverse of `distorted`.

    Args:
        appearing: Bent directions, x to the right and y down per unit of depth, shape (n, 2).
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The directions, shape (n, 2); NaN where there is none, since the lens does not reach there.
    """
    appearing_x, appearing_y = appearing[:, 0], appearing[:, 1]
    x, y = appearing_x.copy(), appearing_y.copy()
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            off_x, off_y = _off(x, y, appearing_x, appearing_y, coefficients)
            if np.abs(off_x).max(initial=0.0) < _CLOSE_ENOUGH and np.abs(off_y).max(initial=0.0) < _CLOSE_ENOUGH:
                break
            a, b, d = jacobian(x, y, coefficients)
            determinant = a * d - b * b
            x, y = x + (d * off_x - b * off_y) / determinant, y + (a * off_y - b * off_x) / determinant
        off_x, off_y = _off(x, y, appearing_x, appearing_y, coefficients)
        found = (np.hypot(off_x, off_y) < 10 * _CLOSE_ENOUGH) & (x * x + y * y < _reach(coefficients))
    found_or_nan = np.where(found, 1.0, np.nan)
    return np.column_stack((x * found_or_nan, y * found_or_nan))


def _off(x: Points, y: Points, wanted_x: Points, wanted_y: Points, coefficients: Coefficients) -> tuple[Points, Points]:
    bent_x, bent_y = _bent(x, y, coefficients)
    return wanted_x - bent_x, wanted_y - bent_y


def _bent(x: Numbers, y: Numbers, coefficients: Coefficients) -> tuple[Numbers, Numbers]:
    k1, k2, p1, p2, k3 = all_five(coefficients)
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    twice_xy = 2 * x * y
    return (
        x * radial + p1 * twice_xy + p2 * (s + 2 * x * x),
        y * radial + p1 * (s + 2 * y * y) + p2 * twice_xy,
    )


def slopes_by_coefficient(x: Points, y: Points) -> Points:
    """Return the change of bent directions with k1, k2, p1, p2 and k3, in which they are linear; shape (n, 2, 5)."""
    s, twice_xy = x * x + y * y, 2 * x * y
    return np.stack(
        (
            np.column_stack((x * s, x * s * s, twice_xy, s + 2 * x * x, x * s**3)),
            np.column_stack((y * s, y * s * s, s + 2 * y * y, twice_xy, y * s**3)),
        ),
        axis=1,
    )


def jacobian(x: Points, y: Points, coefficients: Coefficients) -> tuple[Points, Points, Points]:
    """Return ∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y.

    Args:
        x: To the right, per unit of depth, shape (n,).
        y: Down, per unit of depth, shape (n,).
        coefficients: k1, k2, p1, p2 and perhaps k3.
    """
    k1, k2, p1, p2, k3 = all_five(coefficients)
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3))
    return (
        radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
        x * y * slope + 2 * p1 * x + 2 * p2 * y,
        radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


@lru_cache(maxsize=32)
def _reach(coefficients: Coefficients) -> float:
    """Return the s at which r·R, the bent distance from the axis, first turns around.

    There 1 + 3·k1·s + 5·k2·s² + 7·k3·s³ = 0. Its roots are found as those of 1/s, which is always a cubic.
    """
    k1, k2, _, _, k3 = all_five(coefficients)
    roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3])
    turning = [root.real for root in roots if abs(root.imag) <= 1e-9 * abs(root) and root.real > 0]
    return 1 / max(turning) if turning else math.inf


def all_five(coefficients: Coefficients) -> tuple[float, float, float, float, float]:
    """Return k1, k2, p1, p2 and k3; those that are not given are 0."""
    k1, k2, p1, p2, k3 = (*coefficients, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return k1, k2, p1, p2, k3
