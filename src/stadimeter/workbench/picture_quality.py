"""Faults of a picture, found before anything is looked for in it: black, dark, clipped, blurred."""

from __future__ import annotations

import math

import cv2
import numpy as np

from stadimeter.core.frame import Image

# A picture is black if nearly no pixel has a channel above this: a covered lens gives noise below it.
BLACK_LEVEL = 20

# A picture is dark if nearly no pixel has a channel above this: noise then moves edges, and hues are unsure.
DARK_LEVEL = 70

# Lamps and reflections may be brighter than these levels, if they are no more than this share of the picture.
MAX_GLARE_SHARE = 0.02

# Where every channel is above this level, shape and colour are lost; a window or a lamp is less than this share.
CLIPPED_LEVEL = 250
CLIPPED_SHARE = 0.15

# An edge is judged if the levels around it differ by this much.
EDGE_CONTRAST = 40

# The percentile of the edges that is judged: what is out of focus in front or behind is no fault.
EDGE_WINDOW_PX = 15
EDGES_SHARE_MIN = 0.001
EDGE_PERCENTILE = 90

# The sharpest edges of 80 real pictures, from USB cameras to telephones, have 0.8 px at most.
BLURRED_SIGMA_PX = 2.0

# What smoothing against noise and taking differences adds to the blur.
OWN_VARIANCE_PX2 = 1.0


# A longer exposure is proposed that would bring the brightest parts to this level, with the usual gamma of cameras.
ENOUGH_LEVEL = 150
GAMMA = 2.2

# Longer exposures halve the frame rate, and blur what moves.
MAX_EXPOSURE_S = 0.033


def picture_remarks(image: Image, exposure_s: float | None = None) -> tuple[str, ...]:
    """List what is wrong with a picture, a sentence each, with what to do about it; nothing if it is good.

    Args:
        exposure_s: For how long it was exposed, to propose another; None if that is not known.
    """
    brightest = float(np.quantile(image.max(axis=2), 1 - MAX_GLARE_SHARE))
    if brightest <= BLACK_LEVEL:
        return ("the picture is black: take the cover off the lens, switch the light on, or set a longer exposure",)
    remarks: list[str] = []
    proposed = _exposure_hint(exposure_s, better_exposure_s(image, exposure_s))
    if brightest <= DARK_LEVEL:
        words = f"the picture is dark, hardly a level above {brightest:.0f} of 255: more light, longer exposure"
        remarks.append(f"{words}{proposed}")
    clipped = float(np.mean(image.min(axis=2) >= CLIPPED_LEVEL))
    if clipped > CLIPPED_SHARE:
        words = f"{clipped:.0%} of the picture is clipped to white: set a shorter exposure, or less light"
        remarks.append(f"{words}{proposed}")
    blur_px = blur_sigma_px(image)
    if blur_px is not None and blur_px > BLURRED_SIGMA_PX:
        remarks.append(
            f"the picture is blurred, its sharpest edges by {blur_px:.1f} px: clean and focus the lens, and hold still"
        )
    return tuple(remarks)


def better_exposure_s(image: Image, exposure_s: float | None) -> float | None:
    """Return the exposure for which a picture would be neither dark nor clipped: the one that it had, if it is good.

    Args:
        exposure_s: The exposure that it had; None if that is not known, and so is a better one.
    """
    if exposure_s is None:
        return None
    brightest = float(np.quantile(image.max(axis=2), 1 - MAX_GLARE_SHARE))
    if BLACK_LEVEL < brightest <= DARK_LEVEL:
        return min(exposure_s * float((ENOUGH_LEVEL / brightest) ** GAMMA), MAX_EXPOSURE_S)
    is_clipped = float(np.mean(image.min(axis=2) >= CLIPPED_LEVEL)) > CLIPPED_SHARE
    return exposure_s / 2 if is_clipped else exposure_s


def _exposure_hint(now_s: float | None, wanted_s: float | None) -> str:
    if now_s is None or wanted_s is None or 0.8 < wanted_s / now_s < 1.25:
        return ""
    return f' (try exposure = "{1e3 * wanted_s:.2g} ms" in [camera]; it was {1e3 * now_s:.3g} ms)'


def blur_sigma_px(image: Image) -> float | None:
    """Measure how blurred the sharpest edges are, as the standard deviation of a Gaussian; None without clear edges.

    A step of height h that is blurred so has the slope h/(σ·√(2π)) at most. So each clear edge tells its σ by the ratio
    of what the levels around it differ by and its steepest slope.
    """
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0).astype(np.float32)
    window = np.ones((EDGE_WINDOW_PX, EDGE_WINDOW_PX), np.uint8)
    height = cv2.dilate(grey, window) - cv2.erode(grey, window)
    slope = cv2.magnitude(cv2.Sobel(grey, -1, 1, 0, scale=1 / 8), cv2.Sobel(grey, -1, 0, 1, scale=1 / 8))
    edges = (height > EDGE_CONTRAST) & (slope >= cv2.dilate(slope, window))
    if np.count_nonzero(height > EDGE_CONTRAST) < EDGES_SHARE_MIN * grey.size:
        return None
    steepness = np.percentile(slope[edges] / height[edges], EDGE_PERCENTILE)
    variance_px2 = float(1 / (2 * np.pi * steepness**2))
    return math.sqrt(max(0.0, variance_px2 - OWN_VARIANCE_PX2))
