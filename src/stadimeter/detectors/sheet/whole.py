"""Whether an outline is that of one whole thing: how much this speaks for a sheet.

The sides of a sheet end at its corners. Those of a tile, a book on its shelf or a panel lead on, as sides of what is
beside it; and four sides of different things that happen to enclose something lead on too. A sheet is there up to its
corners, while a frame is hollow and the corners of a cushion are round.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.sheet.lines import Values

# How far in and out of a side colours are read, in pixels of the reduced picture.
BESIDE_PX = 1.5

# A side leads on if there is a step across its line at all these shares of its length beyond the corner, at least
# MIN_BEYOND_PX of the reduced picture: at least LEADS_ON_SHARE of the step across the side itself, and MIN_LEVELS.
BEYOND = np.array((0.15, 0.25, 0.35))
MIN_BEYOND_PX = np.array((2.0, 3.0, 4.0))
LEADS_ON_SHARE = 0.3
MIN_LEVELS = 4.0

# How many of the eight ends of its sides lead on, of a sheet and of other outlines.
OF_SHEETS, OF_OTHERS = 0.1, 0.24

# Places inside, as shares of the sides. What looks much like that which is around is a hole; what is written on a sheet
# does not.
GRID = np.linspace(0.15, 0.85, 6)

# The share of those places that differ from what is around counts with this power, and as no less than that.
FILLED_POWER, MIN_FILLED = 4.0, 0.05

# How far from both sides the corners are looked at, as a share of the longest, and in pixels at least; and what each
# that is missing takes from the evidence, for MAX_CORNERS at most: paper curls at a corner, but not at all of them.
INTO_CORNER, MIN_INTO_CORNER_PX = 0.045, 1.4
CORNER_EVIDENCE, MAX_CORNERS = 1.2, 3

AFTER, BEFORE = [1, 2, 3, 0], [3, 0, 1, 2]


def steps_across(picture: Image, places: Points, along: Points) -> Values:
    """Return by how many levels the inside is brighter across sides, in each channel.

    Args:
        picture: The picture.
        places: Places on the lines of four sides of outlines, shape ``(c, 4, n, 2)``.
        along: How the sides lead, clockwise on the screen, shape ``(c, 4, 2)``.

    Returns:
        Shape ``(c, 4, n, 3)``.
    """
    outward = np.stack((along[..., 1], -along[..., 0]), axis=-1)
    outward *= BESIDE_PX / np.maximum(np.hypot(outward[..., 0], outward[..., 1]), 1e-9)[..., None]
    return _at(picture, places - outward[:, :, None]) - _at(picture, places + outward[:, :, None])


def ends_evidence(picture: Image, corners: Points, steps: Values) -> Values:
    """Return how much the ends of the sides of outlines speak for the sheet.

    Args:
        picture: The reduced picture.
        corners: Their corners in it, shape ``(c, 4, 2)``.
        steps: By how many levels the inside of each side is brighter, in each channel, shape ``(c, 4, 3)``.
    """
    # Three places on the line of each side beyond both its ends, in pixels of the reduced picture; shape (c, 4, 6, 2).
    vector = corners[:, AFTER] - corners
    length = np.hypot(vector[..., 0], vector[..., 1])[..., None]
    ahead = (vector / np.maximum(length, 1e-9))[:, :, None] * np.maximum(BEYOND * length, MIN_BEYOND_PX)[..., None]
    beyond = np.concatenate((corners[:, :, None] - ahead, corners[:, AFTER, None] + ahead), axis=2)
    # A side leads on only if all three places show a step: one alone may be something that happens to lie there.
    across = np.abs(steps_across(picture, beyond, vector)).max(axis=3).reshape(*length.shape[:2], 2, len(BEYOND))
    least = LEADS_ON_SHARE * np.maximum(np.abs(steps).max(axis=2), MIN_LEVELS)
    lead_on = (across.min(axis=3) >= least[..., None]).sum(axis=(1, 2))
    # Each of the eight ends is taken as independent: the logarithms of their likelihood ratios add up.
    ends = 8 - lead_on
    return np.asarray(lead_on * math.log(OF_SHEETS / OF_OTHERS) + ends * math.log((1 - OF_SHEETS) / (1 - OF_OTHERS)))


def filling_evidence(image: Image, corners_px: Points, inside: Values, steps: Values) -> Values:
    """Return how much what is inside of outlines speaks for the sheet.

    Args:
        image: The picture.
        corners_px: Their corners, shape ``(c, 4, 2)``.
        inside: Their colours inside each side, in levels, shape ``(c, 4, 3)``.
        steps: By how many levels the inside of each side is brighter, in each channel, shape ``(c, 4, 3)``.
    """
    # The colours around follow from those inside and the steps. A place inside is hollow if it differs from what is
    # around by less than half of what the sides do.
    around = inside - steps
    off = np.abs(_at(image, _inner(corners_px)) - around.mean(axis=1, keepdims=True)).max(axis=2)
    hollow = (off < np.abs(steps.mean(axis=1)).max(axis=1, keepdims=True) / 2).mean(axis=1)
    filled = np.log(np.maximum(1 - hollow, MIN_FILLED))
    # Light falls off across a sheet, so a corner is compared with the two sides that meet there.
    at_corners = ((each + each[:, BEFORE]) / 2 for each in (around, inside))
    missing = _is_nearer(_at(image, _into_corners(corners_px)), *at_corners).sum(axis=1)
    return np.asarray(FILLED_POWER * filled - CORNER_EVIDENCE * np.minimum(missing, MAX_CORNERS))


def _is_nearer(colours: Values, one: Values, other: Values) -> NDArray[np.bool_]:
    """Return which colours differ less from one than from the other, in the channel that differs most."""
    return np.asarray(np.abs(colours - one).max(axis=2) < np.abs(colours - other).max(axis=2))


def _inner(corners_px: Points) -> Points:
    """Return places all over the inside of outlines, shape ``(c, n, 2)``."""
    # Bilinear weights of the four corners: not quite perspective, but inside.
    across, down = (each.ravel() for each in np.meshgrid(GRID, GRID))
    weights = np.stack(((1 - across) * (1 - down), across * (1 - down), across * down, (1 - across) * down))
    return np.asarray(np.swapaxes(weights, 0, 1) @ corners_px)


def _into_corners(corners_px: Points) -> Points:
    """Return a place just inside of each corner of outlines, shape ``(c, 4, 2)``."""
    vector = corners_px[:, AFTER] - corners_px
    length = np.hypot(vector[..., 0], vector[..., 1])
    ahead = vector / np.maximum(length, 1e-9)[..., None]
    inset_px = np.maximum(INTO_CORNER * length.max(axis=1), MIN_INTO_CORNER_PX)[:, None, None]
    # Inwards from a corner is along the next side and back along the one before.
    return np.asarray(corners_px + inset_px * (ahead - ahead[:, BEFORE]))


def _at(picture: Image, places: Points) -> Values:
    """Return the colours of a picture at the nearest pixels."""
    height, width = picture.shape[:2]
    x, y = np.moveaxis(np.rint(np.nan_to_num(places, nan=0.0)), -1, 0)
    x, y = (np.clip(each, 0, last - 1).astype(np.intp) for each, last in ((x, width), (y, height)))
    return np.asarray(picture[y, x], np.float64)
