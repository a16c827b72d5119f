"""Candidates for a sheet: outlines of four straight sides that some splitting of a picture into two shows.

What touches a sheet in the picture and looks like it sticks to its outline, and a finger bites into it. So an outline
need not have four corners: any four of its longest straight pieces that, made longer, meet in a quadrilateral and make
up enough of it are a candidate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Flags, Indices, Plane, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import CODES
from stadimeter.detectors.sides import areas

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
