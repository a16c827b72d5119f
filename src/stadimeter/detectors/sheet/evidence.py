"""Evidence for an outline being the sheet: the logarithm of one likelihood ratio, and one threshold for it.

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
- **Whole.** They end at its corners, and it is there between them. The sides of a tile, a book on its shelf or a panel
  lead on, as sides of what is beside it. A frame is hollow, and the corners of a cushion are round.
- **Twin.** One outline beside it of the same size and contrast, as strips of tape come in pairs, is no rival and speaks
  for it.
- **Rivals.** The more outlines of about such a contrast there are, the more probably one of them does all this by
  chance. What stands out less, such as the specks of a carpet, is no rival.

All constants were chosen on rendered pictures, with and without sheets, so that in one of a hundred cluttered pictures
without a sheet one is seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Flags, Indices, Plane, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange
from stadimeter.detectors.sampling import CODES
from stadimeter.detectors.sheet.candidates import SheetFit, bends, unevenness
from stadimeter.detectors.sheet.edges import QuadEdges
from stadimeter.detectors.sides import areas
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import COORDINATES

# Candidates for a sheet: outlines of four straight sides that some splitting of a picture into two shows.
#
# What touches a sheet in the picture and looks like it sticks to its outline, and a finger bites into it. So an
# outline need not have four corners: any four of its longest straight pieces that, made longer, meet in a
# quadrilateral and make up enough of it are a candidate.

Polygon = NDArray[np.generic]

# Of the coarse picture: side of the square whose median is taken, and number of levels at which a channel is split. On
# 44 pictures of paper on tables, cloth and wood 42 outlines are among those of 6 levels, 38 of one level. Levels are
# spread evenly between the ends of this range of shares of the pixels, or halve the share that is brighter: of 80
# sheets in rendered clutter, many before something nearly as white, 72 are found with the latter, 65 with the former.
MEDIAN_PX, LEVELS = 5, 6
LEVEL_RANGE = (0.01, 0.995)

# Under uneven light a sheet is brighter than the mean of a square around it: its side as a share of the picture, and
# by how many levels at least. A page on a pale door below a lamp is found in no other way. A small sheet stands out by
# half of what anything does.
AROUND_SHARE, MIN_APART = 0.2, 8.0

# A picture of more outlines than this is noise; looking through them takes long and finds nothing.
MAX_CONTOURS = 3000

# The longest pieces of an outline that are combined, and how many it may have.
PIECES_KEPT = 6
MAX_PIECES = 24


# Tolerance of the polygon that stands for an outline (Douglas and Peucker), in the fine picture, and in the coarse one,
# whose outlines are few and rough: of 20 sheets that are taped to a table and cut at corners 14 are found with the
# latter, 10 with the former in both.
FINE_PX, COARSE_PX = 3.0, 2.0

# An outline of more pieces than this may be ragged by writing or tape: its convex hull is tried too.
RAGGED_PIECES = 4

# The share of each side of a candidate that pieces of the outline must make up.
MIN_COVER = 0.3

# Pieces that lead the same way, to 14 degrees, may be parts of one side.
ALIKE_COSINE = 0.97

# Neighbouring sides meet at a larger angle than that of this sine: 12 degrees.
MIN_SINE = 0.2

# Candidates are roughly known, so their sides may be shorter than the smallest, by this factor.
MIN_SIDE = 0.7

# Outlines are one if their corners round to the same cells of this size, in pixels of the reduced picture.
SAME_PX = 3.0

# Corners and sides in order, from the next one and from the one before.
AFTER, BEFORE = [1, 2, 3, 0], [3, 0, 1, 2]


class SearchedPicture(NamedTuple):
    """A reduced picture in which outlines are looked for."""

    image: Image
    darkest: Plane  # the darkest of the three channels of each pixel
    brightest: Plane  # the brightest of them

    @classmethod
    def of(cls, image: Image) -> SearchedPicture:
        """Return a picture of three channels with what is needed of it."""
        blue, green, red = cv2.split(image)
        darkest, brightest = cv2.min(cv2.min(blue, green), red), cv2.max(cv2.max(blue, green), red)
        return cls(np.ascontiguousarray(image), np.asarray(darkest, np.uint8), np.asarray(brightest, np.uint8))


def quick_masks(picture: SearchedPicture) -> Iterator[Plane]:
    """Yield black and white versions that show a sheet that stands out.

    White paper on brown wood hardly differs in brightness but clearly in its darkest channel.
    """
    for plane in (picture.darkest, picture.brightest):
        yield _split(plane)


def pale_masks(picture: SearchedPicture) -> Iterator[Plane]:
    """Yield black and white versions of a coarse picture in which a pale sheet is one region, as a person sees it.

    A half of the picture is brighter than the first level, a quarter than the second and so on: paper that lies on
    something nearly as white differs from it at one of the last ones.
    """
    yield from _regions(picture.darkest, halving=True)


def other_masks(picture: SearchedPicture) -> Iterator[Plane]:
    """Yield the same for a dark sheet and one on coloured cloth, and two of what is brighter than around it."""
    for plane in (picture.brightest, np.asarray(cv2.subtract(picture.brightest, picture.darkest), np.uint8)):
        yield from _regions(plane)
    around_px = max(round(AROUND_SHARE * max(picture.darkest.shape)), 1) | 1  # odd, so that it has a middle
    apart = np.asarray(
        cv2.subtract(picture.darkest, cv2.boxFilter(picture.darkest, -1, (around_px, around_px))), np.uint8
    )
    for level in (MIN_APART, float(apart.max()) / 2):
        yield _above(apart, level)


def _regions(plane: Plane, *, halving: bool = False) -> Iterator[Plane]:
    # Letters, wood grain and fabric are gone with a median; what is left is split at its own level and at several.
    smooth = np.asarray(cv2.medianBlur(plane, MEDIAN_PX), np.uint8)
    yield _split(smooth)
    shares = np.cumsum(counts_of(smooth))
    if halving:
        levels = np.searchsorted(shares / shares[-1], 1 - 0.5 ** np.arange(1, LEVELS + 1))
    else:
        low, high = np.searchsorted(shares / shares[-1], LEVEL_RANGE).tolist()
        levels = np.linspace(low, high, LEVELS + 2)[1:-1]
    for level in levels.tolist():
        yield _above(smooth, float(level))


def _above(plane: Plane, level: float) -> Plane:
    return np.asarray(cv2.threshold(plane, level, 255, cv2.THRESH_BINARY)[1], np.uint8)


def _split(plane: Plane) -> Plane:
    """Return a plane split where its two kinds of pixels differ most (Otsu)."""
    return np.asarray(cv2.threshold(plane, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1], np.uint8)


def find_quadrilaterals(masks: Iterable[Plane], smallest_side_px: float, tolerance_px: float = FINE_PX) -> Points:
    """Return the outlines of four straight sides in masks, without those that are all but the same; a sheet or not.

    The corners are clockwise on the screen from the one nearest to the top left, shape ``(c, 4, 2)``; the largest
    outline is first.
    """
    polygons = [polygon for mask in masks for polygon in _polygons(mask, smallest_side_px, tolerance_px)]
    if not polygons:
        return np.empty((0, 4, 2))
    of_four = [polygon for polygon in polygons if len(polygon) == 4]
    of_more = [polygon for polygon in polygons if len(polygon) > 4]
    found = [_whole(of_four, smallest_side_px)]
    if of_more:
        found.append(_of_pieces(of_more, smallest_side_px, tolerance_px))
    return _distinct(_in_standard_order(np.concatenate(found)))


def counts_of(plane: Plane, mask: Plane | None = None) -> Values:
    """Count the pixels of each level, of every second one in both directions, shape ``(256,)``."""
    of_them = None if mask is None else mask[::2, ::2].copy()
    return cv2.calcHist([plane[::2, ::2].copy()], [0], of_them, [CODES], (0, CODES)).ravel().astype(np.float64)


def _polygons(mask: Plane, smallest_side_px: float, tolerance_px: float) -> list[Polygon]:
    """Return polygons that stand for the outlines in a mask that are large enough, each ``(n, 1, 2)``."""
    # Enclosed areas and boxes are cheap and leave out most contours before a polygon is fitted.
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    min_px, min_px2 = MIN_SIDE * smallest_side_px, smallest_side_px**2
    polygons: list[Polygon] = []
    if len(contours) > MAX_CONTOURS:
        return polygons
    area = cv2.contourArea
    for contour in [each for each in contours if area(each) >= min_px2 and len(each) >= 4]:
        _, _, width, height = cv2.boundingRect(contour)
        if width < min_px or height < min_px:
            continue
        polygon = cv2.approxPolyDP(contour, tolerance_px, closed=True)
        if 4 <= len(polygon) <= MAX_PIECES:
            polygons.append(polygon)
        if len(polygon) > RAGGED_PIECES:
            around = cv2.approxPolyDP(cv2.convexHull(contour), tolerance_px, closed=True)
            if len(around) >= 4:
                polygons.append(around)
    return polygons


def _whole(polygons: list[Polygon], smallest_side_px: float) -> Points:
    """Return those polygons of four corners that are quadrilaterals that a sheet may be, ``(c, 4, 2)``."""
    corners = np.array(polygons, np.float64).reshape(-1, 4, 2)
    vectors = corners[:, AFTER] - corners
    length = np.hypot(vectors[..., 0], vectors[..., 1])
    sine = _cross(vectors, vectors[:, AFTER]) / np.maximum(length * length[:, AFTER], 1e-9)
    return np.asarray(corners[_turns_one_way(sine) & (length > MIN_SIDE * smallest_side_px).all(axis=1)])


def _turns_one_way(sine: Values) -> Flags:
    """Find what is convex: the sides turn the same way at all four corners, and by more than the least angle."""
    return np.asarray((sine > MIN_SINE).all(axis=-1) | (sine < -MIN_SINE).all(axis=-1))


def _longest(polygons: list[Polygon]) -> tuple[Points, Points]:
    """Return where the longest straight pieces of polygons start, and how they lead on, both ``(m, 6, 2)``."""
    # All polygons in one list of corners, each ending with the way back to its first one.
    counts = np.array([len(polygon) for polygon in polygons])
    starts = np.concatenate(polygons)[:, 0].astype(np.float64)
    firsts = np.cumsum(counts) - counts
    after = np.arange(1, len(starts) + 1)
    after[firsts + counts - 1] = firsts
    vectors = starts[after] - starts
    # A row for each polygon; what is no piece is shorter than any and comes last.
    row = np.repeat(np.arange(len(polygons)), counts)
    squares = np.full((len(polygons), max(int(counts.max()), PIECES_KEPT)), -1.0)
    squares[row, np.arange(len(starts)) - firsts[row]] = (vectors * vectors).sum(axis=1)
    longest = np.sort(np.argsort(-squares, axis=1, kind="stable")[:, :PIECES_KEPT], axis=1)
    is_piece = (longest < counts[:, None])[..., None]
    places = np.minimum(firsts[:, None] + longest, len(starts) - 1)
    return starts[places] * is_piece, vectors[places] * is_piece


def _of_pieces(polygons: list[Polygon], smallest_side_px: float, tolerance_px: float) -> Points:
    """Return the quadrilaterals that any four pieces of a polygon form, corners ``(c, 4, 2)``."""
    # Every choice of four of the six longest pieces, in order: 15 for each polygon. `sine` is that of the angle between
    # neighbouring pieces; where all four turn one way, their lines are met in order around a quadrilateral.
    starts, vectors = _longest(polygons)
    length = np.hypot(vectors[..., 0], vectors[..., 1])
    along = vectors / np.maximum(length, 1e-9)[..., None]
    chosen = _fours()
    ahead = along[:, chosen]
    sine = _cross(ahead, ahead[:, :, AFTER])
    row, four = np.nonzero(_turns_one_way(sine) & (length[:, chosen] > 0).all(axis=2))
    pieces = chosen[four]
    start, ahead, sine = starts[row[:, None], pieces], ahead[row, four], sine[row, four]
    # Where the line of a piece meets that of the next: from its start, by (next start - start) x next / sine along it.
    met = start + (_cross(start[:, AFTER] - start, ahead[:, AFTER]) / sine)[..., None] * ahead
    corners = met[:, BEFORE]
    # Each side must be made up of enough outline: three sides of a box and a stray piece meet in four corners too.
    reached = ((met - corners) * ahead).sum(axis=2)
    good = np.nonzero((reached > MIN_SIDE * smallest_side_px).all(axis=1))[0]
    cover = _in_line(starts, vectors, along, length, tolerance_px)
    good = good[(cover[row[good, None], pieces[good]] > MIN_COVER * reached[good]).all(axis=1)]
    return np.asarray(corners[good])


def _in_line(starts: Points, vectors: Points, along: Points, length: Values, tolerance_px: float) -> Values:
    """Return the length together of all pieces that lie on the line of each, shape ``(m, 6)``."""
    # A piece lies on the line of another if both its ends are near that, and it leads the same way.
    to_start = starts[:, None] - starts[:, :, None]
    to_end = to_start + vectors[:, None]
    here = along[:, :, None]
    near_px = 1.5 * tolerance_px
    near = (np.abs(_cross(here, to_start)) < near_px) & (np.abs(_cross(here, to_end)) < near_px)
    alike = (here * along[:, None]).sum(axis=3) > ALIKE_COSINE
    return np.asarray((near & alike) @ length[..., None])[..., 0]


@cache
def _fours() -> Indices:
    return np.array(list(combinations(range(PIECES_KEPT), 4)))


def _cross(first: Points, second: Points) -> Values:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def _in_standard_order(corners: Points) -> Points:
    """Return the corners clockwise on the screen, starting with the one that is nearest to the top left."""
    # With y downwards, the cross product of the diagonals is above zero for corners that come clockwise on the screen.
    counter = _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) < 0
    clockwise = np.where(counter[:, None, None], corners[:, ::-1], corners)
    first = np.argmin(clockwise.sum(axis=2), axis=1)
    return np.take_along_axis(clockwise, ((first[:, None] + np.arange(4)) % 4)[..., None], axis=1)


def _distinct(corners: Points) -> Points:
    """Leave out outlines whose corners all lie close to those of another, and put the largest first."""
    # Corners rounded to a coarse grid: outlines in one cell of it are the same sheet, found in several masks.
    cells: dict[tuple[float, ...], int] = {}
    for number, cell in enumerate(np.rint(corners.reshape(-1, 8) / SAME_PX).tolist()):
        cells.setdefault(tuple(cell), number)
    corners = corners[list(cells.values())]
    return np.asarray(corners[np.argsort(-areas(corners), kind="stable")])


def not_seen_before(corners: Points, seen: set[tuple[float, ...]]) -> Flags:
    """Return which outlines, ``(c, 4, 2)``, are not among those seen, to a pixel, and add them to these."""
    cells = [tuple(cell) for cell in np.rint(corners.reshape(-1, 8)).tolist()]
    new = np.array([cell not in seen for cell in cells], np.bool_)
    seen.update(cells)
    return new


# Evidence from the corners of outlines alone: whether they face the camera, as one side tells, and which are twins.

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


# Evidence for and against a sheet: its shape, its sides, and what is beside and inside of them ------------------------

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

# What bent or uneven sides take from the evidence for each time the limit that they are beyond it.
ODD_EVIDENCE = 3.0

# Contrast, in levels, that sheets have as often as other outlines, with more in proportion; and the least that counts.
USUAL_CONTRAST = 50.0
MIN_CONTRAST = 4.0

# What differs from its surroundings by this share of a candidate's contrast, on the mean of its sides, is its rival. A
# picture that shows many of them is of a place that holds many more, hence a power of their number above 1; but more
# than this are parts of one thing, such as the panels of a door, and count no further.
RIVAL_SHARE, RIVAL_AREA = 0.35, 0.1
MAX_RIVALS = 20
RIVAL_POWER = 1.5

# What lies in an outline, and is smaller than this share of it, is its content: letters, boxes, a printed frame.
CONTENT_SHARE = 0.9

# Outlines that are neither brighter nor darker than what is around on all sides: how many of them are looked at.
# And how many outlines at most, the clearest first.
UNCLEAR_LOOKED_AT, MAX_LOOKED_AT = 8, 64

# Where colours beside a side are read: at these shares of its length.
ALONG = np.array((0.25, 0.5, 0.75))


def slack_share(size: SheetShape, *, by_hand: bool = True) -> float:
    """Return the standard deviation of a sheet's corners from those of an exact rectangle, as a share of its size."""
    cut_share = CUT_M / size.longest_m if by_hand else 0.0
    return math.hypot(FLATNESS_SHARE, cut_share, TOLERANCE_FACTOR * size.relative_sigma)


def shape_evidence(fit: SheetFit, sigmas_px: Values, longest_px: Values, size: SheetShape) -> Values:
    """Return the evidence of the shapes of outlines for the sheet: one that was printed, or cut by hand.

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


def sides_evidence(edges: QuadEdges) -> Values:
    """Return the evidence of outlines' sides for the sheet: those of others are there, and straight, by chance."""
    support = SUPPORT_POWER * np.log(np.maximum(np.add.reduce(edges.support, axis=1) / 4, 1e-3))
    odd = np.maximum(bends(edges), unevenness(edges)) - 1
    return np.asarray(support - ODD_EVIDENCE * np.maximum(odd, 0))


class Looks:
    """The looks of a part of a picture, to tell how probable the looks of a sheet are there.

    Args:
        image: The whole picture.
        picture: That part, reduced.
        scale: Its scale.
        left_top_px: Where it begins in the whole picture.
        colour: The colours of the sheet, if they are named.
    """

    def __init__(
        self, image: Image, picture: SearchedPicture, scale: float, left_top_px: Points, colour: HsvRange | None
    ) -> None:
        self._image = image
        self._picture, self._scale, self._left_top_px = picture.image, scale, left_top_px
        self._colour = colour
        mask = None if colour is None else colour.mask(picture.image)
        self._share = 1.0 if mask is None else float(np.count_nonzero(mask)) / max(mask.size, 1)
        self._below = [_shares_below(plane, mask) for plane in (picture.darkest, picture.brightest)]

    def note_others(self, outlines_px: Points, aspect: float = 1.0) -> None:
        """Note the outlines that the picture shows at first sight, ``(c, 4, 2)``, and the sheet's aspect."""
        self._others, self._places = _mean_contrast(self._steps(outlines_px)), outlines_px
        self._twins = Twins(outlines_px, self._others, aspect)

    def clearest(self, outlines_px: Points) -> Points:
        """Return the outlines that stand out most on all their sides; in turn from each nested group.

        A sheet with a chessboard on it stands out less than each of its squares.
        """
        contrast = _least_contrast(self._steps(outlines_px))
        order = np.argsort(-contrast, kind="stable")[: np.count_nonzero(contrast > 0) + UNCLEAR_LOOKED_AT]
        turns = np.argsort(_rank_in_group(outlines_px[order]), kind="stable")[:MAX_LOOKED_AT]
        return np.asarray(outlines_px[order[turns]])

    def evidence(self, corners_px: Points, inside: Values | None = None, free: Flags | None = None) -> Values:
        """Return the evidence of the looks of outlines, and of how they stand out, for the sheet.

        Args:
            corners_px: Their corners, shape ``(c, 4, 2)``.
            inside: Their colours inside each side, shape ``(c, 4, 3)``; None to read them in the reduced picture.
            free: Which sides are none but where the border cuts, shape ``(c, 4)``.
        """
        # All figures are in levels of 8 bits of the reduced picture. A candidate is its own rival, hence at least one.
        inside_here, outside = self._beside(corners_px)
        steps = inside_here - outside
        inside = inside_here if inside is None else inside
        mean_contrast = _mean_contrast(steps)
        # Tiles and panes are many; where the colour is named, several things of it are too.
        twins = self._twins.of(corners_px, mean_contrast, several=self._colour is not None)
        content = inside_of(self._places, corners_px)
        is_like = areas(self._places) >= RIVAL_AREA * areas(corners_px)[:, None]
        rivals = ((self._others >= RIVAL_SHARE * mean_contrast[:, None]) & is_like & ~twins & ~content).sum(axis=1)
        contrast = np.maximum(_least_contrast(steps, free), MIN_CONTRAST) / USUAL_CONTRAST
        # The colour of an outline is the median of its four sides, so that a finger on one of them does not count.
        usual = np.add.reduce(np.sort(inside, axis=1)[:, 1:3], axis=1) / 2
        looks = self._brightness(usual) if self._colour is None else self._of_colour(usual, self._colour)
        evidence = np.asarray(looks + np.log(contrast) - RIVAL_POWER * np.log(np.clip(rivals, 1, MAX_RIVALS)))
        evidence += TWIN_EVIDENCE * twins.any(axis=1)
        # What the border cuts has fewer than eight ends and four corners, so these say nothing of it.
        if free is not None:
            return evidence
        evidence += ends_evidence(self._picture, self._reduced(corners_px), steps)
        return evidence + filling_evidence(self._image, corners_px, inside, steps)

    def in_frames(self, corners_px: Points) -> Flags:
        """Return which outlines have a band around them, as a picture has a frame, shape ``(c,)``."""
        return in_frames(self._picture, self._reduced(corners_px))

    def _steps(self, corners_px: Points) -> Values:
        """Return by how many levels the inside of each side is brighter, in each channel, shape ``(c, 4, 3)``."""
        inside, outside = self._beside(corners_px)
        return np.asarray(inside - outside)

    def _beside(self, corners_px: Points) -> Values:
        """Return the colours inside and outside of each side, shape ``(2, c, 4, 3)``."""
        corners = self._reduced(corners_px)
        vector = corners[:, [1, 2, 3, 0]] - corners
        on_side = corners[:, :, None] + ALONG[:, None] * vector[:, :, None]
        return np.asarray(np.add.reduce(colours_beside(self._picture, on_side, vector), axis=3) / len(ALONG))

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


def inside_of(outlines_px: Points, around_px: Points) -> Flags:
    """Return which outlines, ``(n, 4, 2)``, lie in larger ones, ``(c, 4, 2)``: their content; shape ``(c, n)``."""
    along = around_px[:, AFTER] - around_px
    off = outlines_px.mean(axis=1)[None, :, None] - around_px[:, None]
    turns = along[:, None, :, 0] * off[..., 1] - along[:, None, :, 1] * off[..., 0]
    is_in = (turns > 0).all(axis=2)
    return np.asarray(is_in & (areas(outlines_px) < CONTENT_SHARE * areas(around_px)[:, None]))


def _rank_in_group(outlines_px: Points) -> Indices:
    """Return for each outline how many before it lie in the same one directly, shape ``(n,)``."""
    sizes = np.where(inside_of(outlines_px, outlines_px).T, areas(outlines_px), np.inf)
    group = np.where(np.isfinite(sizes.min(axis=1, initial=np.inf)), sizes.argmin(axis=1), -1) if len(sizes) else sizes
    same = group[:, None] == group[None, :]
    return np.asarray(np.tril(same, -1).sum(axis=1))


def _mean_contrast(steps: Values) -> Values:
    """Return by how many levels outlines differ from what is around, of the channel that differs most on each side."""
    return np.asarray(np.add.reduce(np.maximum.reduce(np.abs(steps), axis=2), axis=1) / 4)


def _least_contrast(steps: Values, free: Flags | None = None) -> Values:
    """Return by how many levels outlines are brighter on all sides, or darker, in the channel where they are most so.

    Negative where they are neither in any.
    """
    brighter, darker = steps, -steps
    if free is not None:
        brighter, darker = (np.where(free[..., None], np.inf, each) for each in (brighter, darker))
    return np.asarray(np.maximum(brighter.min(axis=1), darker.min(axis=1)).max(axis=1))


def _shares_below(plane: Image, mask: Image | None) -> Values:
    """Return the share of pixels in a mask that are darker than each level, shape ``(257,)``."""
    counts = counts_of(plane, mask)
    return np.concatenate(((0.0,), np.cumsum(counts) / max(counts.sum(), 1)))


def _looked_up(shares: Values, levels: Values) -> Values:
    return np.asarray(shares[np.clip(np.rint(levels), 0, 256).astype(np.intp)])


def _few(share: Values) -> Values:
    return np.asarray(np.exp(-share / FEW_SHARE) / FEW_SHARE)


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

# Places inside, as bilinear weights of the four corners: not quite perspective, but inside. What looks much like that
# which is around is a hole; what is written on a sheet does not.
_ACROSS, _DOWN = (each.ravel() for each in np.meshgrid(*[np.linspace(0.15, 0.85, 6)] * 2))
INNER = np.stack(((1 - _ACROSS) * (1 - _DOWN), _ACROSS * (1 - _DOWN), _ACROSS * _DOWN, (1 - _ACROSS) * _DOWN)).T

# The share of those places that differ from what is around counts with this power, and as no less than that.
FILLED_POWER, MIN_FILLED = 4.0, 0.05

# How far from both sides the corners are looked at, as a share of the longest, and in pixels at least; and what each
# that is missing takes from the evidence, for MAX_CORNERS at most: paper curls at a corner, but not at all of them.
INTO_CORNER, MIN_INTO_CORNER_PX = 0.045, 1.4
CORNER_EVIDENCE, MAX_CORNERS = 1.2, 3


# Where a band around an outline may end: at these shares of its shorter side, from MIN_BAND_PX of the reduced picture
# on. An edge is there if all these shares of a side show a step of BAND_LEVELS; on one side the wall may be as dark as
# a frame. Of 60 rendered rooms with a frame that is as long for its width as the sheet, 2 were taken for the sheet
# without a doubt with 10 levels on four sides, none with these; of 64 real sheets none has a band.
BANDS = np.linspace(0.04, 0.3, 14)
MIN_BAND_PX = 3.5
ALONG_BAND = np.array((0.2, 0.35, 0.5, 0.65, 0.8))
BAND_LEVELS, BAND_SIDES = 8.0, 3


def steps_across(picture: Image, places: Points, along: Points) -> Values:
    """Return by how many levels the inside is brighter across sides, in each channel, shape ``(c, 4, n, 3)``.

    Args:
        picture: The picture.
        places: Places on the lines of four sides of outlines, shape ``(c, 4, n, 2)``.
        along: How the sides lead, clockwise on the screen, shape ``(c, 4, 2)``.
    """
    inside, outside = colours_beside(picture, places, along)
    return np.asarray(inside - outside)


def colours_beside(picture: Image, places: Points, along: Points) -> Values:
    """Return the colours inside and outside of sides, shape ``(2, c, 4, n, 3)``; the same as of `steps_across`."""
    outward = np.stack((along[..., 1], -along[..., 0]), axis=-1)
    outward *= BESIDE_PX / np.maximum(np.hypot(outward[..., 0], outward[..., 1]), 1e-9)[..., None]
    return _at(picture, places + np.stack((-outward, outward))[:, :, :, None])


def in_frames(picture: Image, corners: Points) -> Flags:
    """Return which outlines, ``(c, 4, 2)``, have a band around them: another edge beyond each side, parallel to it."""
    vector = corners[:, AFTER] - corners
    length = np.maximum(np.hypot(vector[..., 0], vector[..., 1]), 1e-9)
    outward = np.stack((vector[..., 1], -vector[..., 0]), axis=-1) / length[..., None]
    bands = BANDS * length.min(axis=1)[:, None]
    on_side = corners[:, :, None] + ALONG_BAND[:, None] * vector[:, :, None]
    places = on_side[:, :, :, None] + bands[:, None, None, :, None] * outward[:, :, None, None]
    steps = steps_across(picture, places.reshape(*places.shape[:2], -1, 2), vector).reshape(*places.shape[:4], 3)
    # At one distance all places of a side show a step of the same sign. Nearer than MIN_BAND_PX it is the side's own.
    alike = np.maximum(steps.min(axis=2), -steps.max(axis=2)).max(axis=3) * (bands >= MIN_BAND_PX)[:, None]
    return np.asarray((alike.max(axis=2) >= BAND_LEVELS).sum(axis=1) >= BAND_SIDES)


def ends_evidence(picture: Image, corners: Points, steps: Values) -> Values:
    """Return the evidence of the ends of the sides of outlines for the sheet.

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
    """Return the evidence of what is inside of outlines for the sheet.

    Args:
        image: The picture.
        corners_px: Their corners, shape ``(c, 4, 2)``.
        inside: Their colours inside each side, in levels, shape ``(c, 4, 3)``.
        steps: By how many levels the inside of each side is brighter, in each channel, shape ``(c, 4, 3)``.
    """
    # The colours around follow from those inside and the steps. A place inside is hollow if it differs from what is
    # around by less than half of what the sides do.
    around = inside - steps
    off = _at(image, INNER @ corners_px) - np.add.reduce(around, axis=1, keepdims=True) / 4
    limits = np.maximum.reduce(np.abs(np.add.reduce(steps, axis=1) / 4), axis=1, keepdims=True) / 2
    hollow = np.add.reduce(np.maximum.reduce(np.abs(off), axis=2) < limits, axis=1) / len(INNER)
    filled = np.log(np.maximum(1 - hollow, MIN_FILLED))
    # Light falls off across a sheet, so a corner is compared with the two sides that meet there.
    beside = np.stack((around, inside))
    off = _at(image, _into_corners(corners_px)) - (beside + beside[:, :, BEFORE]) / 2
    off_around, off_inside = np.maximum.reduce(np.abs(off), axis=3)
    missing = (off_around < off_inside).sum(axis=1)
    return np.asarray(FILLED_POWER * filled - CORNER_EVIDENCE * np.minimum(missing, MAX_CORNERS))


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
    # Held inside before it is rounded, which is the same; NaN becomes 0, the least.
    x, y = (np.rint(np.fmin(np.fmax(places[..., i], 0), last - 1)) for i, last in ((0, width), (1, height)))
    pixels = picture.reshape(-1, picture.shape[2])
    return np.asarray(pixels.take((y * width + x).astype(np.intp), axis=0), np.float64)
