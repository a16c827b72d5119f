"""How much speaks for an outline being the sheet: the logarithm of one likelihood ratio, and one threshold for it.

It compares how probable what is seen is of the sheet, with its tolerances, and of any other outline in such a picture.
Its parts are independent, so they add up:

- **Shape.** Four corners have eight coordinates and a pose six degrees of freedom, so a picture of the sheet fulfils
  two conditions as exactly as its corners are measured and it was cut. Other outlines are spread evenly over both. For
  small sheets, or badly cut ones, this tells little: nearly every outline fits.
- **Looks.** A sheet is mostly the brightest thing in the picture, or of a colour that the user has named.
- **Sides.** They are seen whole, and straight.
- **The picture.** The more outlines there are, the more probably one of them does all this by chance.

All constants were chosen on rendered pictures, with and without sheets, so that in one of a hundred cluttered pictures
without a sheet one is seen.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange
from stadimeter.detectors.sheet.candidates import SheetFit
from stadimeter.detectors.sheet.edges import QuadEdges
from stadimeter.detectors.sheet.lines import Values
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import COORDINATES

FLATNESS_SHARE = 0.00125
TOLERANCE_FACTOR = 0.4
"""Standard deviation of the corners of a sheet from those of an exact rectangle: a share of its size because nothing is
quite flat, and this multiple of the tolerance of its sides."""

CUT_M = 0.0006
CUT_PX = 0.15
CUT_BY_HAND = 0.3
"""What scissors, tape or a knife in a careful hand add to it, and what rough edges do in a picture; and the share of
sheets that are so and not printed."""

HEAVY_TAIL = 4.0
"""Degrees of freedom of Student's distribution of the misfit: some sheets are worse than their tolerance."""

LEAST_RATIO = 1e-6

ALIKE = 6
"""Levels of 8 bits within which brightness does not differ."""

FEW_SHARE = 0.05
BRIGHT_MOST, BRIGHT_LEAST, DARK_MOST, ANY_LOOKS = 0.55, 0.15, 0.1, 0.2
"""Of how many sheets the darkest channel is brighter than nearly all of the picture, of how many only the brightest
one, how many are darker than nearly all of it, and how many look anyhow. "Nearly" is exponential with this mean."""

OF_THE_COLOUR = 0.95
LEAST_COLOUR_SHARE = 0.02
"""The share of sheets that have the colour named for them; least share of the picture that is taken to have it."""

SUPPORT_POWER = 6.0

FACING_RAD = 0.06
FACING_LOG_RATIO = 0.05
FACING_OF_ANY = 0.4
"""A sheet of which one side is known must face the camera: standard deviations of its angles from right ones, and of
the logarithm of the ratio of opposite sides. This share of all outlines face it just as well."""

CUT_OFF_RAD = 0.3
CUT_OFF_OF_ANY = 0.7
"""One that the border cuts may be turned away; the same for the two angles of it that are seen."""


def slack_share(size: SheetShape, *, by_hand: bool = True) -> float:
    """Return the standard deviation of a sheet's corners from those of an exact rectangle, as a share of its size."""
    cut_share = CUT_M / size.longest_m if by_hand else 0.0
    return math.hypot(FLATNESS_SHARE, cut_share, TOLERANCE_FACTOR * size.relative_sigma)


def shape_evidence(fit: SheetFit, sigmas_px: Values, longest_px: Values, size: SheetShape) -> Values:
    """Return how much the shapes of outlines speak for the sheet: one that was printed, or cut by hand.

    Args:
        fit: Their misfit.
        sigmas_px: Standard deviations of their corners' coordinates as they were measured.
        longest_px: Their longest sides.
        size: The sheet.
    """
    printed, by_hand = (slack_share(size, by_hand=each) * longest_px for each in (False, True))
    exact = _shape_ratio(fit, np.hypot(sigmas_px, printed))
    rough = _shape_ratio(fit, np.hypot(np.hypot(sigmas_px, CUT_PX), by_hand))
    ratio = (1 - CUT_BY_HAND) * exact + CUT_BY_HAND * rough
    return np.asarray(np.log(np.maximum(ratio, LEAST_RATIO)))


def _shape_ratio(fit: SheetFit, sigmas_px: Values) -> Values:
    squares = COORDINATES * (fit.misfit_px / sigmas_px) ** 2
    spread = fit.chance_per_square * sigmas_px**2 / (COORDINATES / 2)
    return np.asarray((1 + squares / HEAVY_TAIL) ** -(HEAVY_TAIL / 2 + 1) / np.clip(spread, LEAST_RATIO, 1.0))


def facing_evidence(corners_px: Points, sigmas_px: Values) -> Values:
    """Return how much outlines, ``(c, 4, 2)``, look like a rectangle of any length that faces the camera.

    The standard deviation of their corners' coordinates is that of the measurement and of the sheet's own shape.
    """
    cosines, lengths = _cosines(corners_px)
    noise = (2 * sigmas_px / lengths.min(axis=1))[:, None]
    squares = (cosines / np.hypot(FACING_RAD, noise)) ** 2
    ratios = np.log(lengths[:, :2] / lengths[:, 2:]) / np.hypot(FACING_LOG_RATIO, noise)
    return np.asarray(-math.log(FACING_OF_ANY) - (squares.sum(axis=1) + (ratios**2).sum(axis=1)) / 2)


def cut_off_evidence(corners_px: Points, free: NDArray[np.bool_]) -> Values:
    """Return how much outlines that the border cuts look like a rectangle; `free` are the sides that are not seen."""
    cosines, _ = _cosines(corners_px)
    seen = ~(free | free[:, [3, 0, 1, 2]])
    return np.asarray(-math.log(CUT_OFF_OF_ANY) - ((cosines / CUT_OFF_RAD) ** 2 * seen).sum(axis=1) / 2)


def _cosines(corners_px: Points) -> tuple[Values, Values]:
    """Return the cosines of the angles at the corners, and the lengths of the sides, both ``(c, 4)``."""
    sides = corners_px[:, [1, 2, 3, 0]] - corners_px
    lengths = np.maximum(np.hypot(sides[..., 0], sides[..., 1]), 1e-9)
    before = [3, 0, 1, 2]
    return (sides[:, before] * sides).sum(axis=2) / (lengths * lengths[:, before]), lengths


def sides_evidence(edges: QuadEdges) -> Values:
    """Return how much the sides of outlines speak for the sheet: those of others are there by chance."""
    return np.asarray(SUPPORT_POWER * np.log(np.maximum(edges.support.mean(axis=1), 1e-3)))


class Looks:
    """What a picture looks like, to tell how probable the looks of a sheet are there."""

    def __init__(self, picture: Image, colour: HsvRange | None) -> None:
        self._colour = colour
        if colour is not None:
            self._share = float(np.count_nonzero(colour.mask(picture))) / max(picture.shape[0] * picture.shape[1], 1)
            return
        channels = cv2.split(picture)
        planes = (cv2.min(cv2.min(channels[0], channels[1]), channels[2]), cv2.max(cv2.max(*channels[:2]), channels[2]))
        self._below = [_shares_below(np.asarray(plane, np.uint8)) for plane in planes]

    def evidence(self, inside: Values) -> Values:
        """Return how much the looks of outlines speak for the sheet; their colours inside are ``(c, 4, 3)``."""
        usual = np.median(inside, axis=1)
        if self._colour is not None:
            return self._of_colour(usual, self._colour)
        in_darkest, in_brightest = self._below
        darkest, brightest = usual.min(axis=1), usual.max(axis=1)
        density = (
            ANY_LOOKS
            + BRIGHT_MOST * _few(1 - _looked_up(in_darkest, darkest + ALIKE))
            + BRIGHT_LEAST * _few(1 - _looked_up(in_brightest, brightest + ALIKE))
            + DARK_MOST * _few(_looked_up(in_brightest, brightest - ALIKE))
        )
        return np.asarray(np.log(density))

    def _of_colour(self, usual: Values, colour: HsvRange) -> Values:
        pixels = np.clip(np.rint(usual), 0, 255).astype(np.uint8)[:, None]
        has_it = colour.mask(np.ascontiguousarray(pixels))[:, 0] > 0
        share = min(max(self._share, LEAST_COLOUR_SHARE), 1 - LEAST_COLOUR_SHARE)
        return np.where(has_it, math.log(OF_THE_COLOUR / share), math.log((1 - OF_THE_COLOUR) / (1 - share)))


def _shares_below(plane: Image) -> Values:
    """Return the share of pixels that are darker than each level, shape ``(257,)``."""
    some = plane[::2, ::2]
    counts = np.bincount(some.ravel(), minlength=256)
    return np.concatenate(((0.0,), np.cumsum(counts) / max(some.size, 1)))


def _looked_up(shares: Values, levels: Values) -> Values:
    return np.asarray(shares[np.clip(np.rint(levels), 0, 256).astype(np.intp)])


def _few(share: Values) -> Values:
    return np.asarray(np.exp(-share / FEW_SHARE) / FEW_SHARE)
