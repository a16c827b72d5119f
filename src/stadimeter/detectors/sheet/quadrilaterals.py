"""Candidates for a sheet: outlines of four straight sides that some splitting of a picture into two shows.

What touches a sheet in the picture and looks like it sticks to its outline, and a finger bites into it. So an outline
need not have four corners: any four of its longest straight pieces that, made longer, meet in a quadrilateral and make
up enough of it are a candidate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache, reduce
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Flags, Indices, Plane, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import CODES
from stadimeter.detectors.sides import areas, grown

Polygon = NDArray[np.generic]

# Levels at which a channel is split where one does not do, spread evenly between these percentiles of it.
LEVELS = 10
LEVEL_RANGE = (1.0, 99.5)

# Under uneven light, pixels are compared with the mean of a square around them: its side as a share of the picture, and
# the least difference in levels.
AROUND_SHARE = 0.2
MIN_APART = 8

# Where brightness changes by less than this from pixel to pixel, in quarter levels, a picture is even.
FLAT_LIMITS = (5, 8, 13, 20)

# An even area ends this far before the edge of the sheet, in pixels of the reduced picture.
FLAT_SHRINKS_PX = 1.4

# Tolerance of the polygon that stands for an outline (Douglas and Peucker).
TOLERANCE_PX = 1.5

# A picture of more outlines than this is noise; looking through them takes long and finds nothing.
MAX_CONTOURS = 3000

# The longest pieces of an outline that are combined, and how many it may have. One of more than RAGGED_PIECES may be
# ragged by writing, so its convex hull is tried too.
PIECES_KEPT = 6
MAX_PIECES = 24
RAGGED_PIECES = 8

# The share of each side of a candidate that pieces of the outline must make up.
MIN_COVER = 0.45

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


def quick_masks(picture: SearchedPicture) -> Iterator[tuple[Plane, float]]:
    """Yield black and white versions that show a sheet that stands out, and how many pixels too small it is there.

    White paper on brown wood hardly differs in brightness but clearly in its darkest channel.
    """
    for plane in (cv2.cvtColor(picture.image, cv2.COLOR_BGR2GRAY), picture.darkest, picture.brightest):
        yield np.asarray(cv2.threshold(plane, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1], np.uint8), 0.0


def bright_masks(picture: SearchedPicture, first: int = 0) -> Iterator[tuple[Plane, float]]:
    """Yield black and white versions of a picture that show a bright sheet before things of many colours.

    Every second level from the first; those between are for a sheet with something nearly as bright behind it.
    """
    yield from _levels(picture.darkest, slice(first, None, 2))


def thorough_masks(picture: SearchedPicture) -> Iterator[tuple[Plane, float]]:
    """Yield black and white versions of a picture that show a dark sheet, and one of any kind under uneven light."""
    _, darkest, brightest = picture
    # Uneven light: what is brighter than the mean around it (of the darkest channel), or darker (of the brightest). The
    # square is odd, so that it has a middle.
    around_px = max(round(AROUND_SHARE * max(darkest.shape)), 1) | 1
    for plane, sign in ((darkest, 1), (brightest, -1)):
        mean = cv2.boxFilter(plane, -1, (around_px, around_px))
        apart = cv2.subtract(plane, mean) if sign > 0 else cv2.subtract(mean, plane)
        yield np.asarray(cv2.threshold(apart, MIN_APART, 255, cv2.THRESH_BINARY)[1], np.uint8), 0.0
    yield from _levels(brightest, slice(None))
    # A sheet of any brightness is even inside; it ends where brightness changes, a pixel or so before its edge.
    change = _change(picture.image)
    for limit in FLAT_LIMITS:
        yield np.asarray(cv2.threshold(change, limit, 255, cv2.THRESH_BINARY_INV)[1], np.uint8), FLAT_SHRINKS_PX


def find_quadrilaterals(masks: Iterable[tuple[Plane, float]], smallest_side_px: float) -> Points:
    """Return the outlines of four straight sides in masks, without those that are all but the same; a sheet or not.

    Each mask comes with the number of pixels by which things are too small in it. The corners are clockwise on the
    screen from the one nearest to the top left, shape ``(c, 4, 2)``; the largest outline is first.
    """
    polygons: list[Polygon] = []
    too_small: list[float] = []
    for mask, too_small_px in masks:
        polygons += _polygons(mask, smallest_side_px)
        too_small += [too_small_px] * (len(polygons) - len(too_small))
    if not polygons:
        return np.empty((0, 4, 2))
    of_four = np.array([len(polygon) == 4 for polygon in polygons])
    found = [_whole(polygons, np.nonzero(of_four)[0], smallest_side_px)]
    if not of_four.all():
        found.append(_of_pieces(polygons, np.nonzero(~of_four)[0], smallest_side_px))
    rows, corners = (np.concatenate(each) for each in zip(*found, strict=True))
    corners = _in_standard_order(corners)
    return _distinct(grown(corners, np.array(too_small)[rows]) if any(too_small) else corners)


def _levels(plane: Plane, which: slice) -> Iterator[tuple[Plane, float]]:
    counts = counts_of(plane)
    shares = np.cumsum(counts) * (100 / counts.sum())
    low, high = np.searchsorted(shares, LEVEL_RANGE).tolist()
    for level in np.linspace(low, high, LEVELS + 2)[1:-1][which]:
        yield np.asarray(cv2.threshold(plane, float(level), 255, cv2.THRESH_BINARY)[1], np.uint8), 0.0


def counts_of(plane: Plane, mask: Plane | None = None) -> Values:
    """Return how many pixels have each level, of every second one in both directions, shape ``(256,)``."""
    of_them = None if mask is None else mask[::2, ::2].copy()
    return cv2.calcHist([plane[::2, ::2].copy()], [0], of_them, [CODES], (0, CODES)).ravel().astype(np.float64)


def _change(image: Image) -> Plane:
    """Return how much the channel that changes most changes from pixel to pixel."""
    changes = []
    for plane in cv2.split(image):
        slopes = (cv2.Sobel(plane, cv2.CV_16S, *way) for way in ((1, 0), (0, 1)))
        across, down = (cv2.convertScaleAbs(slope, alpha=0.25) for slope in slopes)
        changes.append(cv2.add(across, down))
    return np.asarray(reduce(cv2.max, changes), np.uint8)


def _polygons(mask: Plane, smallest_side_px: float) -> list[Polygon]:
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
        polygon = cv2.approxPolyDP(contour, TOLERANCE_PX, closed=True)
        if 4 <= len(polygon) <= MAX_PIECES:
            polygons.append(polygon)
        if len(polygon) > RAGGED_PIECES:
            around = cv2.approxPolyDP(cv2.convexHull(contour), TOLERANCE_PX, closed=True)
            if len(around) >= 4:
                polygons.append(around)
    return polygons


def _whole(polygons: list[Polygon], rows: Indices, smallest_side_px: float) -> tuple[Indices, Points]:
    """Return which of the polygons of four corners are quadrilaterals that a sheet may be, and these."""
    corners = np.array([polygons[row] for row in rows.tolist()], np.float64).reshape(-1, 4, 2)
    vectors = corners[:, AFTER] - corners
    length = np.hypot(vectors[..., 0], vectors[..., 1])
    sine = _cross(vectors, vectors[:, AFTER]) / np.maximum(length * length[:, AFTER], 1e-9)
    good = _turns_one_way(sine) & (length > MIN_SIDE * smallest_side_px).all(axis=1)
    return rows[good], corners[good]


def _turns_one_way(sine: Values) -> Flags:
    """Return what is convex: the sides turn the same way at all four corners, and by more than the least angle."""
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


def _of_pieces(polygons: list[Polygon], rows: Indices, smallest_side_px: float) -> tuple[Indices, Points]:
    """Return the quadrilaterals that any four pieces of a polygon form: whose they are, and corners ``(c, 4, 2)``."""
    # Every choice of four of the six longest pieces, in order: 15 for each polygon. `sine` is that of the angle between
    # neighbouring pieces; where all four turn one way, their lines are met in order around a quadrilateral.
    starts, vectors = _longest([polygons[row] for row in rows.tolist()])
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
    cover = _in_line(starts, vectors, along, length)
    good = good[(cover[row[good, None], pieces[good]] > MIN_COVER * reached[good]).all(axis=1)]
    return rows[row[good]], corners[good]


def _in_line(starts: Points, vectors: Points, along: Points, length: Values) -> Values:
    """Return how long all pieces are together that lie on the line of each, shape ``(m, 6)``."""
    # A piece lies on the line of another if both its ends are near that, and it leads the same way.
    to_start = starts[:, None] - starts[:, :, None]
    to_end = to_start + vectors[:, None]
    here = along[:, :, None]
    near = (np.abs(_cross(here, to_start)) < 1.5 * TOLERANCE_PX) & (np.abs(_cross(here, to_end)) < 1.5 * TOLERANCE_PX)
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
