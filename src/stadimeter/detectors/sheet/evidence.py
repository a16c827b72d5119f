"""How much speaks for an outline being the sheet: the logarithm of one likelihood ratio, and one threshold for it.

It compares how probable what is seen is of the sheet, with its tolerances, and of any other outline in such a picture.
Its parts are independent, so they add up:

- **Shape.** Four corners have eight coordinates and a pose six degrees of freedom, so a picture of the sheet fulfils
  two conditions as exactly as its corners are measured and it was cut. Other outlines are spread evenly over both, or,
  where they are rectangles too, over one. For small sheets, or badly cut ones, this tells little: nearly every outline
  fits.
- **Looks.** A sheet is mostly the brightest thing in the picture, or of a colour that the user has named.
- **Contrast.** It is brighter than what is behind it on all four sides, or darker on all of them, and by more than most
  things are. What is of many colours, such as a carpet, has no outline of which this is so.
- **Sides.** They are seen whole, and straight.
- **Whole.** They end at its corners, and it is there between them, see `stadimeter.detectors.sheet.whole`.
- **Rivals.** The more outlines of about such a contrast there are, the more probably one of them does all this by
  chance. What stands out less, such as the specks of a carpet, is no rival.

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
from stadimeter.detectors.sheet.whole import ends_evidence, filling_evidence, steps_across
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import COORDINATES

Which = NDArray[np.bool_]

# Standard deviation of the corners of a sheet from those of an exact rectangle: a share of its size because nothing is
# quite flat, and this multiple of the tolerance of its sides.
FLATNESS_SHARE = 0.00125
TOLERANCE_FACTOR = 0.4

# What scissors, tape or a knife in a careful hand add to it, and what rough edges do in a picture; the share of sheets
# that are so and not printed; and that of those which are bent, torn or half in shadow, whose shape tells nothing.
CUT_M = 0.0006
CUT_PX = 0.15
CUT_BY_HAND, DAMAGED = 0.3, 0.1

# The share of other outlines that are rectangles too.
RECTANGLES = 0.05

# Degrees of freedom of Student's distribution of the misfit: some sheets are worse than their tolerance.
HEAVY_TAIL = 4.0

# Likelihood ratios and shares are held above this, so that one wrong part cannot outweigh all others by itself.
MIN_RATIO = 1e-6

# Levels of 8 bits within which brightness does not differ.
ALIKE = 6

# Of how many sheets the darkest channel is brighter than nearly all of the picture, of how many only the brightest one,
# how many are darker than nearly all of it, and how many look anyhow. "Nearly" is exponential with this mean.
FEW_SHARE = 0.08
BRIGHT_THROUGHOUT, BRIGHT_IN_ONE, DARK_THROUGHOUT, ANY_LOOKS = 0.51, 0.14, 0.1, 0.25

# The share of sheets that have the colour named for them; least share of the picture that is taken to have it.
OF_THE_COLOUR = 0.95
MIN_COLOUR_SHARE = 0.02

# The mean share of the sides that is seen counts with this power: half of them seen divides the odds by 64.
SUPPORT_POWER = 6.0

# Contrast, in levels, that sheets have as often as other outlines, with more in proportion; and the least that counts.
USUAL_CONTRAST = 50.0
MIN_CONTRAST = 4.0

# What differs from its surroundings by this share of a candidate's contrast, on the mean of its sides, is its rival. A
# picture that shows many of them is of a place that holds many more, hence a power of their number above 1; but more
# than this are parts of one thing, such as the panels of a door, and count no further.
RIVAL_SHARE = 0.35
MAX_RIVALS = 8
RIVAL_POWER = 1.5

# Where colours beside a side are read: at these shares of its length.
ALONG = np.array((0.25, 0.5, 0.75))

# A sheet of which one side is known must face the camera: standard deviations of its angles from right ones, and of the
# logarithm of the ratio of opposite sides. This share of all outlines face it just as well.
FACING_RAD = 0.06
FACING_LOG_RATIO = 0.05
FACING_OF_ANY = 0.8

# One that the border cuts may be turned away; the same for the two angles of it that are seen.
CUT_OFF_RAD = 0.3
CUT_OFF_OF_ANY = 0.7


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
    # A mixture of three kinds of sheets: printed, cut by hand, and damaged ones, whose shape is as likely as any
    # outline's.
    exact = _shape_ratio(fit, np.hypot(sigmas_px, printed))
    rough = _shape_ratio(fit, np.hypot(np.hypot(sigmas_px, CUT_PX), by_hand))
    ratio = (1 - CUT_BY_HAND - DAMAGED) * exact + CUT_BY_HAND * rough + DAMAGED
    return np.asarray(np.log(np.maximum(ratio, MIN_RATIO)))


def _shape_ratio(fit: SheetFit, sigmas_px: Values) -> Values:
    # The misfit is a root mean square over eight coordinates, of which two remain beyond the pose: their sum of squares
    # in standard deviations has two degrees of freedom, and its density is Student's, relative to the best fit.
    squares = COORDINATES * (fit.misfit_px / sigmas_px) ** 2
    spread = np.clip(fit.chance_per_square * sigmas_px**2 / (COORDINATES / 2), MIN_RATIO, 1.0)
    # Other outlines fit as well as that with the probability `spread`, an area in the plane of both conditions; those
    # that are rectangles too fulfil one condition and need only fit in the other, so with its square root.
    spread = (1 - RECTANGLES) * spread + RECTANGLES * np.sqrt(spread)
    return np.asarray((1 + squares / HEAVY_TAIL) ** -(HEAVY_TAIL / 2 + 1) / spread)


def facing_evidence(corners_px: Points, sigmas_px: Values) -> Values:
    """Return how much outlines, ``(c, 4, 2)``, look like a rectangle of any length that faces the camera.

    The standard deviation of their corners' coordinates is that of the measurement and of the sheet's own shape.
    """
    # Four angles and two ratios, normally distributed about a rectangle seen face on; an error of s px in both ends of
    # a side of l px turns it by up to 2 s / l.
    cosines, lengths = _cosines(corners_px)
    noise = (2 * sigmas_px / lengths.min(axis=1))[:, None]
    squares = (cosines / np.hypot(FACING_RAD, noise)) ** 2
    ratios = np.log(lengths[:, :2] / lengths[:, 2:]) / np.hypot(FACING_LOG_RATIO, noise)
    return np.asarray(-math.log(FACING_OF_ANY) - (squares.sum(axis=1) + (ratios**2).sum(axis=1)) / 2)


def cut_off_evidence(corners_px: Points, free: Which) -> Values:
    """Return how much outlines that the border cuts look like a rectangle; `free` are the sides that are not seen."""
    # A corner is seen where neither of the two sides that meet there is the border.
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
    """What a part of a picture looks like, to tell how probable the looks of a sheet are there.

    Args:
        image: The whole picture.
        picture: That part, reduced.
        scale: Its scale.
        left_top_px: Where it begins in the whole picture.
        colour: The colours of the sheet, if they are named.
    """

    def __init__(
        self, image: Image, picture: Image, scale: float, left_top_px: Points, colour: HsvRange | None
    ) -> None:
        self._image = image
        self._picture, self._scale, self._left_top_px = picture, scale, left_top_px
        self._colour = colour
        self._others = np.empty(0)
        channels = cv2.split(picture)
        planes = (cv2.min(cv2.min(channels[0], channels[1]), channels[2]), cv2.max(cv2.max(*channels[:2]), channels[2]))
        mask = None if colour is None else colour.mask(picture)
        self._share = 1.0 if mask is None else float(np.count_nonzero(mask)) / max(mask.size, 1)
        self._below = [_shares_below(np.asarray(plane, np.uint8), mask) for plane in planes]

    def note_others(self, outlines_px: Points) -> None:
        """Note the outlines that the picture shows at first sight, ``(c, 4, 2)``."""
        self._others = _mean_contrast(self._steps(outlines_px))

    def clearest_first(self, outlines_px: Points) -> Points:
        """Return outlines in the order of how much they stand out on all their sides."""
        return np.asarray(outlines_px[np.argsort(-_least_contrast(self._steps(outlines_px)), kind="stable")])

    def evidence(self, corners_px: Points, inside: Values, free: Which | None = None) -> Values:
        """Return how much the looks of outlines, and how they stand out, speak for the sheet.

        Args:
            corners_px: Their corners, shape ``(c, 4, 2)``.
            inside: Their colours inside each side, shape ``(c, 4, 3)``.
            free: Which sides are none but where the border cuts, shape ``(c, 4)``.
        """
        # All figures are in levels of 8 bits of the reduced picture. A candidate is its own rival, hence at least one.
        steps = self._steps(corners_px)
        rivals = (self._others >= RIVAL_SHARE * _mean_contrast(steps)[:, None]).sum(axis=1)
        contrast = np.maximum(_least_contrast(steps, free), MIN_CONTRAST) / USUAL_CONTRAST
        # The colour of an outline is the median of its four sides, so that a finger on one of them does not count.
        usual = np.median(inside, axis=1)
        looks = self._brightness(usual) if self._colour is None else self._of_colour(usual, self._colour)
        evidence = np.asarray(looks + np.log(contrast) - RIVAL_POWER * np.log(np.clip(rivals, 1, MAX_RIVALS)))
        # What the border cuts has fewer than eight ends and four corners, so these say nothing of it.
        if free is not None:
            return evidence
        evidence += ends_evidence(self._picture, self._reduced(corners_px), steps)
        return evidence + filling_evidence(self._image, corners_px, inside, steps)

    def _steps(self, corners_px: Points) -> Values:
        """Return by how many levels the inside of each side is brighter, in each channel, shape ``(c, 4, 3)``."""
        corners = self._reduced(corners_px)
        vector = corners[:, [1, 2, 3, 0]] - corners
        on_side = corners[:, :, None] + ALONG[:, None] * vector[:, :, None]
        return np.asarray(steps_across(self._picture, on_side, vector).mean(axis=2))

    def _reduced(self, corners_px: Points) -> Points:
        return np.asarray((corners_px - self._left_top_px + 0.5) * self._scale - 0.5)

    def _brightness(self, usual: Values) -> Values:
        # A density relative to that of any other outline: of a share s of the picture that is as bright or brighter, an
        # exponential with the mean FEW_SHARE over the even distribution that any outline has.
        in_darkest, in_brightest = self._below
        darkest, brightest = usual.min(axis=1), usual.max(axis=1)
        density = (
            ANY_LOOKS
            + BRIGHT_THROUGHOUT * _few(1 - _looked_up(in_darkest, darkest + ALIKE))
            + BRIGHT_IN_ONE * _few(1 - _looked_up(in_brightest, brightest + ALIKE))
            + DARK_THROUGHOUT * _few(_looked_up(in_brightest, brightest - ALIKE))
        )
        return np.asarray(np.log(density))

    def _of_colour(self, usual: Values, colour: HsvRange) -> Values:
        # Bayes: sheets have the colour with OF_THE_COLOUR, other outlines as often as pixels of the picture have it.
        pixels = np.clip(np.rint(usual), 0, 255).astype(np.uint8)[:, None]
        has_it = colour.mask(np.ascontiguousarray(pixels))[:, 0] > 0
        share = min(max(self._share, MIN_COLOUR_SHARE), 1 - MIN_COLOUR_SHARE)
        # A range for white holds a pale wall too; then the brightest of what has the colour is most like the sheet.
        of_it = math.log(OF_THE_COLOUR / share) + self._brightness(usual)
        return np.where(has_it, of_it, math.log((1 - OF_THE_COLOUR) / (1 - share)))


def _mean_contrast(steps: Values) -> Values:
    """Return by how many levels outlines differ from what is around, of the channel that differs most on each side."""
    return np.asarray(np.abs(steps).max(axis=2).mean(axis=1))


def _least_contrast(steps: Values, free: Which | None = None) -> Values:
    """Return by how many levels outlines are brighter on all sides, or darker, in the channel where they are most so.

    Negative where they are neither in any.
    """
    brighter, darker = steps, -steps
    if free is not None:
        brighter, darker = (np.where(free[..., None], np.inf, each) for each in (brighter, darker))
    return np.asarray(np.maximum(brighter.min(axis=1), darker.min(axis=1)).max(axis=1))


def _shares_below(plane: Image, mask: Image | None) -> Values:
    """Return the share of pixels in a mask that are darker than each level, shape ``(257,)``, of every second pixel."""
    some, of_them = plane[::2, ::2], None if mask is None else mask[::2, ::2]
    counts = np.bincount((some if of_them is None else some[of_them > 0]).ravel(), minlength=256)
    return np.concatenate(((0.0,), np.cumsum(counts) / max(counts.sum(), 1)))


def _looked_up(shares: Values, levels: Values) -> Values:
    return np.asarray(shares[np.clip(np.rint(levels), 0, 256).astype(np.intp)])


def _few(share: Values) -> Values:
    return np.asarray(np.exp(-share / FEW_SHARE) / FEW_SHARE)
