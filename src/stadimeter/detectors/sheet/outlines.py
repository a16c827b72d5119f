"""Evidence from the corners of outlines alone: whether they face the camera, as one side tells, and which are twins."""

from __future__ import annotations

import math

import numpy as np

from stadimeter.core.detection import Flags, Points, Values

# Of two outlines with sides and contrasts alike to this, a few lengths apart, each is the other one's twin, as of two
# strips of tape: no rival, and this much speaks for both. At 0.25 instead of 0.15 off the ratio of the sheet's sides,
# squares on a board were taken for it, turned away: 5 of 60 boards, 3 with 0.15 and without twins.
TWIN_LOG_SIDE, TWIN_LOG_ASPECT, TWIN_LOG_CONTRAST, TWIN_LENGTHS = 0.25, 0.15, 0.3, (0.5, 4.0)
TWIN_EVIDENCE = 0.7

# A sheet of which one side is known must face the camera: standard deviations of its angles from right ones, and of the
# logarithm of the ratio of opposite sides. This share of all outlines face it just as well.
FACING_RAD = 0.06
FACING_LOG_RATIO = 0.05
FACING_OF_ANY = 0.8

# By how much the named side appears too long for the other one as stated, as a logarithm: OF_THE_RATIO are as near as
# that on either side, since what is turned away about the named side only shortens the other; some are anywhere below
# the limit, since the other one is not known or curled, fewer above; other outlines are spread over ANY_LOG_RATIO.
NEAR_LOG_RATIOS, OF_THE_RATIO, ANY_LOG_RATIO = (0.07, 0.12), 0.7, 2.4
MAX_LOG_RATIO, OF_SHORT, OF_LONG = math.log(1.5), 0.28, 0.02

# One that the border cuts may be turned away; the same for the two angles of it that are seen.
CUT_OFF_RAD = 0.3
CUT_OFF_OF_ANY = 0.7

AFTER, BEFORE = [1, 2, 3, 0], [3, 0, 1, 2]


def facing_evidence(corners_px: Points, sigmas_px: Values) -> Values:
    """Return the evidence that outlines, ``(c, 4, 2)``, are a rectangle of any length that faces the camera.

    The standard deviation of their corners' coordinates is that of the measurement and of the sheet's own shape.
    """
    # Four angles and two ratios, normally distributed about a rectangle seen face on; an error of s px in both ends of
    # a side of l px turns it by up to 2 s / l.
    cosines, lengths = _cosines(corners_px)
    noise = (2 * sigmas_px / lengths.min(axis=1))[:, None]
    squares = (cosines / np.hypot(FACING_RAD, noise)) ** 2
    ratios = np.log(lengths[:, :2] / lengths[:, 2:]) / np.hypot(FACING_LOG_RATIO, noise)
    return np.asarray(-math.log(FACING_OF_ANY) - (squares.sum(axis=1) + (ratios**2).sum(axis=1)) / 2)


def ratio_evidence(log_ratios: Values) -> Values:
    """Return the evidence of the ratios of sides, named to other one, as logarithms off that stated, for the sheet."""
    short, long = NEAR_LOG_RATIOS
    near = np.exp(-((log_ratios / np.where(log_ratios < 0, short, long)) ** 2) / 2)
    near *= OF_THE_RATIO / ((short + long) / 2 * math.sqrt(2 * math.pi))
    return np.asarray(np.log(ANY_LOG_RATIO * (near + np.where(log_ratios < 0, OF_LONG, OF_SHORT) / MAX_LOG_RATIO)))


def cut_off_evidence(corners_px: Points, free: Flags) -> Values:
    """Return the evidence that outlines cut by the border are a rectangle; `free` are the sides that are not seen."""
    # A corner is seen where neither of the two sides that meet there is the border.
    cosines, _ = _cosines(corners_px)
    seen = ~(free | free[:, [3, 0, 1, 2]])
    return np.asarray(-math.log(CUT_OFF_OF_ANY) - ((cosines / CUT_OFF_RAD) ** 2 * seen).sum(axis=1) / 2)


def _cosines(corners_px: Points) -> tuple[Values, Values]:
    """Return the cosines of the angles at the corners, and the lengths of the sides, both ``(c, 4)``."""
    sides = corners_px[:, AFTER] - corners_px
    lengths = np.maximum(np.hypot(sides[..., 0], sides[..., 1]), 1e-9)
    return (sides[:, BEFORE] * sides).sum(axis=2) / (lengths * lengths[:, BEFORE]), lengths


def _log_sides(corners_px: Points) -> Values:
    """Return the logarithms of the longer and the shorter side of outlines, ``(c, 2)``."""
    _, lengths = _cosines(corners_px)
    pairs = lengths[:, :2] + lengths[:, 2:]
    return np.asarray(np.log(-np.sort(-pairs, axis=1) / 2))


class Twins:
    """The outlines of a picture that are the one twin of another, such as strips of tape that come in pairs.

    Args:
        outlines_px: All of them, shape ``(n, 4, 2)``.
        contrasts: How much they differ from what is around, shape ``(n,)``.
        aspect: The longer side of the sheet over the other one.
    """

    def __init__(self, outlines_px: Points, contrasts: Values, aspect: float) -> None:
        self._centres, self._sides = outlines_px.mean(axis=1), _log_sides(outlines_px)
        self._contrasts, self._log_aspect = contrasts, math.log(aspect)

    def of(self, corners_px: Points, contrasts: Values, *, several: bool) -> Flags:
        """Return which are beside outlines, ``(c, 4, 2)``, and like them, shape ``(c, n)``; one of them, or several."""
        off = self._centres - corners_px.mean(axis=1)[:, None]
        sides = _log_sides(corners_px)
        apart = np.hypot(off[..., 0], off[..., 1]) / np.exp(sides[:, :1])
        # Of a named colour there may be a board full of them, however far apart.
        alike = (apart > TWIN_LENGTHS[0]) & ((apart < TWIN_LENGTHS[1]) | several)
        alike &= (np.abs(self._sides - sides[:, None]) < TWIN_LOG_SIDE).all(axis=2)
        alike &= np.abs(np.log(np.maximum(self._contrasts, 1) / np.maximum(contrasts[:, None], 1))) < TWIN_LOG_CONTRAST
        # Several of them, such as tiles or panes, are no pair; an outline may show twice at one place.
        low, high = (np.where(alike[..., None], off, far) for far in (np.inf, -np.inf))
        spread = (high.max(axis=1, initial=-np.inf) - low.min(axis=1, initial=np.inf)).max(axis=1)
        is_one = (spread < np.exp(sides[:, 1])) | several
        faces = np.abs(sides[:, 0] - sides[:, 1] - self._log_aspect) < TWIN_LOG_ASPECT
        return np.asarray(alike & (is_one & faces)[:, None])
