"""Search for tags in a picture, each look harder than the last.

A reduced picture first, larger ones only if the tag is not there. Around a prediction only a part of the picture is
looked at, reduced until the tag is about `TRACKED_PX` long, so that the cost depends neither on the picture's size nor
on the tag's. Outlines of four corners are found by `cv2.aruco`.

`cv2.aruco` compares each outline with each: a fine chequer of ten thousand squares would take it minutes. So where
outlines are many, only the largest are looked for. It also keeps every contour of a picture, however short: for 50
megapixels of noise OpenCV 4.10 took 10 GB, OpenCV 5 1.2 GB. So noise is looked through with one window size, and at
half its size where only large outlines are left to look for.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from pydantic import BeforeValidator

from stadimeter.core.detection import Flags, Plane, Points, Prediction, Profiles, RejectedCandidate
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Light, Region, grey_of, reduced, to_full_scale
from stadimeter.detectors.sides import side_lengths
from stadimeter.detectors.tag.sides import measure_sides

# Families of tags, and reading the code of a tag from its four corners.
#
# OpenCV finds outlines fast but compares each with every member of a family, in version 5 a millisecond for each
# outline. Here the code is read at full resolution, however much the picture was reduced for the search, and looked
# up among all members in all four directions; only if it is none of them, it is compared with all by a product of
# matrices.

# Samples along a cell; the outermost are left out, since neighbouring cells blur into them.
SAMPLES = 4

# The order of the corners from each of them on.
FROM = np.array([[(first + i) % 4 for i in range(4)] for first in range(4)])

# Least difference between white and black cells, in levels of 8 bits.
MIN_CONTRAST = 12.0

# The share of the border's cells that may look white: three of 28.
MAX_BORDER_ERRORS = 0.12

# Share of white in the border above which better corners would not help.
MAX_BORDER_DOUBTS = 0.4


class SeenTag(Struct, frozen=True, kw_only=True, eq=False):
    """A tag whose code was read."""

    number: int  # which member of the family it is
    errors: int  # how many of its cells are wrong
    corners_px: Points  # its corners clockwise on the screen, starting with its own top left one, shape ``(4, 2)``

    @property
    def side_px(self) -> float:
        """Its longest side."""
        return float(np.linalg.norm(self.corners_px[[1, 2, 3, 0]] - self.corners_px, axis=1).max())


class Unread(NamedTuple):
    """The reason the content of an outline is no tag of the family."""

    reason: str  # the test that it failed, with the figure and the limit
    white_border: float  # the share of the border's cells that look white; 1 where there is no contrast

    @property
    def may_be_tag(self) -> bool:
        """True if it may still be a tag, if its corners were known better: most of the border is black."""
        return self.white_border < MAX_BORDER_DOUBTS


def read_tag(grey: Plane, corners_px: Points, family: TagFamily, *, inverted: bool = False) -> SeenTag | Unread:
    """Read the code inside an outline, or why it is no tag of the family; `inverted` accepts white on black too.

    What parts black from white is found by Otsu's criterion: the variance between the two classes is the largest (N.
    Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and Cybernetics 9,
    1979).
    """
    # Levels of 8 bits, one a cell; a threshold of its own for each outline, as light differs across a picture.
    cells = _cells(grey, corners_px, family.cells)
    white = np.asarray(cv2.threshold(cells, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1], np.uint8)
    has_both = 0 < cv2.countNonZero(white) < white.size
    contrast = cv2.mean(cells, white)[0] - cv2.mean(cells, 1 - white)[0] if has_both else 0.0
    if contrast < MIN_CONTRAST:
        return Unread(f"white cells are brighter by {contrast:.0f} levels, limit {MIN_CONTRAST:.0f}", 1.0)
    # The outermost ring of cells is the tag's border.
    border = _white_border(white)
    if inverted and border > 0.5:
        white, border = 1 - white, 1 - border
    if border > MAX_BORDER_ERRORS:
        return Unread(f"{border:.0%} of the border is not black, limit {MAX_BORDER_ERRORS:.0%}", border)
    return _closest(white[1:-1, 1:-1], corners_px, family, border)


def _cells(grey: Plane, corners: Points, count: int) -> Plane:
    """Return the brightness of each cell, shape ``(count, count)``."""
    # The map leads from a square of `side` pixels to the picture, as WARP_INVERSE_MAP takes it: each sample of the
    # square is read where it comes from.
    side = count * SAMPLES
    turned = cv2.getPerspectiveTransform(_square(side), corners.astype(np.float32))
    flat = cv2.warpPerspective(
        grey, turned, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    mean = _inner_means(count)
    return np.asarray(np.rint(mean @ np.asarray(flat, np.float32) @ mean.T), np.uint8)


@cache
def _square(side: int) -> Profiles:
    """Return the corners of a square picture, from the outer edge of its first pixel on."""
    return np.array(((0, 0), (side, 0), (side, side), (0, side)), np.float32) - np.float32(0.5)


@cache
def _inner_means(count: int) -> Profiles:
    """Return the matrix that takes the mean of the inner samples of each cell, shape ``(count, count * SAMPLES)``."""
    inner = np.zeros(SAMPLES, np.float32)
    inner[1:-1] = 1 / (SAMPLES - 2)
    return np.kron(np.eye(count, dtype=np.float32), inner)


def _white_border(white: Plane) -> float:
    """Return the share of the border's cells that are white."""
    cells = len(white)
    inner = white[1:-1, 1:-1]
    return (cv2.countNonZero(white) - cv2.countNonZero(inner)) / (cells * cells - inner.size)


def _closest(inner: Plane, corners: Points, family: TagFamily, border: float) -> SeenTag | Unread:
    """Return the member with the fewest wrong cells, whichever way it is turned."""
    # Mostly no cell is wrong, and the code is a key. Otherwise +1 and -1 make the product of two codes the number of
    # cells that agree less those that differ; so (cells - product) / 2 differ.
    row, errors = family.rows.get(inner.tobytes()), 0
    if row is None:
        agreement = family.codes @ (inner.reshape(-1).astype(np.float32) * 2 - 1)
        row = int(np.argmax(agreement))
        errors = round((inner.size - float(agreement[row])) / 2)
    if errors > family.max_errors:
        return Unread(f"its code differs from every tag in {errors} cells or more, limit {family.max_errors}", border)
    quarter, number = divmod(row, family.members)
    # Turned clockwise by n quarters, its own top left corner is n corners further on.
    return SeenTag(number=number, errors=errors, corners_px=corners[FROM[quarter]])


APRILTAG, ARUCO = "apriltag-", "aruco-"

# The families by the name that people write, each with OpenCV's name for it.
DICTIONARIES = {
    f"{ARUCO}{size}x{size}-{count}": f"DICT_{size}X{size}_{count}"
    for size in (4, 5, 6, 7)
    for count in (50, 100, 250, 1000)
} | {
    f"{ARUCO}original": "DICT_ARUCO_ORIGINAL",
    f"{ARUCO}mip-36h12": "DICT_ARUCO_MIP_36h12",
    f"{APRILTAG}16h5": "DICT_APRILTAG_16h5",
    f"{APRILTAG}25h9": "DICT_APRILTAG_25h9",
    f"{APRILTAG}36h10": "DICT_APRILTAG_36h10",
    f"{APRILTAG}36h11": "DICT_APRILTAG_36h11",
}

# The share of the errors that a family could correct which is accepted, as `cv2.aruco` does: correcting all of them
# takes clutter for a tag.
CORRECTED_SHARE = 0.6


class TagFamily(Struct, frozen=True, kw_only=True, eq=False):
    """A set of square tags that differ in their code."""

    name: str  # such as ``apriltag-36h11``
    cells: int  # how many cells a side of the black square is long, its border of one cell included
    members: int  # how many tags there are; they are numbered from 0
    # The cells inside the border, row by row, of each member: 1 for white, -1 for black. First all members upright,
    # then all turned clockwise by one, two and three quarters, shape ``(4 * members, (cells - 2)²)``.
    codes: Profiles
    rows: dict[bytes, int]  # where in `codes` a code is, by its cells as bytes, 1 for white and 0 for black
    max_errors: int  # how many wrong cells are accepted

    def cells_of(self, number: int) -> Flags:
        """Return which cells inside the border of a member are black, upright, shape ``(cells - 2, cells - 2)``."""
        return np.asarray(self.codes[number] < 0).reshape(self.cells - 2, self.cells - 2)


@cache
def tag_family(name: str) -> TagFamily:
    """Return one of the families in `DICTIONARIES`.

    OpenCV holds the AprilTag families turned by half a turn against the pictures that their authors publish; here they
    are turned back.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[name]))
    size = int(dictionary.markerSize)
    rows = np.asarray(dictionary.bytesList)
    bits = [cv2.aruco.Dictionary.getBitsFromByteList(rows[i : i + 1], size) for i in range(len(rows))]
    upright = np.stack(bits).astype(np.float32) * 2 - 1
    if name.startswith(APRILTAG):
        upright = np.rot90(upright, 2, axes=(1, 2))
    # All four directions of all members: rows count first the members, then the quarters by which they are turned.
    turned = [np.rot90(upright, -quarters, axes=(1, 2)) for quarters in range(4)]
    codes = np.stack(turned).reshape(-1, size * size)
    codes.setflags(write=False)
    return TagFamily(
        name=name,
        cells=size + 2,
        members=len(rows),
        codes=codes,
        rows=_rows(codes),
        max_errors=int(_correctable(codes, len(rows)) * CORRECTED_SHARE),
    )


def _correctable(codes: Profiles, members: int) -> int:
    """Return the most wrong cells that leave no doubt which member it is: less than half of the least two differ by.

    OpenCV says so too, but before version 5 wrongly for AprilTags.
    """
    # The product of two codes of n cells that differ in d is n - 2 d; the largest is that of the two most alike.
    alike = codes @ codes[:members].T
    np.fill_diagonal(alike, -np.inf)
    differ = int(codes.shape[1] - float(alike.max())) // 2
    return max(0, (differ - 1) // 2)


def _rows(codes: Profiles) -> dict[bytes, int]:
    """Return where each code is; of those that look the same, the first."""
    white = (codes > 0).astype(np.uint8)
    return {white[row].tobytes(): row for row in reversed(range(len(white)))}


def parse_family(text: object) -> str:
    """Read one of `DICTIONARIES`; ``36h11`` and ``4x4-50`` are enough where only one family ends so.

    Raises:
        ValueError: There is no such family; the message offers the likely one.
    """
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a family of tags; write it as text, such as 'apriltag-36h11'")
    wanted = text.strip().lower().replace("_", "-")
    for name in (wanted, APRILTAG + wanted, ARUCO + wanted):
        if name in DICTIONARIES:
            return name
    raise ValueError(_no_family(text, wanted))


def _no_family(text: str, wanted: str) -> str:
    short = {name.removeprefix(APRILTAG).removeprefix(ARUCO): name for name in DICTIONARIES}
    close = difflib.get_close_matches(wanted, [*DICTIONARIES, *short], n=1, cutoff=0.6)
    guess = f"; did you mean {short.get(close[0], close[0])!r}?" if close else "."
    return f"there is no family of tags {text!r}{guess} There are: {', '.join(DICTIONARIES)}"


TagFamilyName = Annotated[str, BeforeValidator(parse_family)]


# Pixels are compared with the mean of a square around them; one size is enough for most tags.
ONE_WINDOW = (13, 13)

# OpenCV's own choice: squares of 3, 13 and 23 pixels.
THREE_WINDOWS = (3, 23)

# No tag fits into a smaller picture.
MIN_PICTURE_PX = 8

# Outlines whose corners are all nearer to each other are one.
SAME_PX = 1.5

# A direction, and how far apart along it the centres of two outlines that are one may be.
OBLIQUE = np.array((0.8, 0.6))
NEAR_PX = SAME_PX * (0.8 + 0.6)

# Distance in pixels of OpenCV's outline inside the edge of a black tag: through the middles of the outermost dark
# pixels.
INSET_PX = 0.85

# The corner after each corner.
ROUND = np.array((1, 2, 3, 0))

# Number of outlines that a look may show: rooms show ten, shelves and keyboards a hundred.
MAX_OUTLINES = 250

# Outlines are counted in pictures with at least this long side; too few have room in smaller ones to matter.
COUNTED_FROM_PX = 400

# Outlines are counted at a half of the size that they are looked for at, which takes a twentieth of the time.
COUNTING_SCALE = 2

# At full size an outline is at most this many times as long as counted at half, plus a pixel a side. Without it a floor
# whose outlines are all alike would lose them all.
COUNTING_ERROR = 1.1

# A picture with more contours than this at half its size is noise: 12.5 megapixels of it have 135,000, and the busiest
# real picture that was tried 23,000 in 3 megapixels.
MAX_CONTOURS = 100_000

# Outlines of a longer perimeter than this are still found at half the size: tags of 16 px are.
HALVED_FROM_PX = 128.0

# Outlines with less than this share of the area of a square of their length are no tags, and do not count.
HOLLOW = 0.25


class TagOutlines(NamedTuple):
    """The outlines that a look found."""

    corners_px: Points  # clockwise, the largest first, shape ``(k, 4, 2)``
    left_out_px: float = 0.0  # outlines of a shorter perimeter than this were left out since there are too many


class _Crowd(NamedTuple):
    """The number of outlines in a picture."""

    perimeter_px: float  # no more than `MAX_OUTLINES` outlines have a longer one; 0 if no more have the smallest one
    contours: int = 0  # how many contours there are at half the size, of any length


def find_outlines(grey: Plane, smallest_perimeter_px: float, long_side_px: int, *, thorough: bool) -> TagOutlines:
    """Return outlines of four corners that differ from what is around.

    What costs time is what is found, so small ones are left out early: OpenCV's limit is a share of the picture's long
    side and its default, 0.03, means nothing in a small part of a picture.

    Args:
        smallest_perimeter_px: TagOutlines that are shorter than this around are left out.
        long_side_px: The picture is searched with its long side reduced to this.
        thorough: Whether three window sizes are tried instead of one, but for noise.
    """
    nothing = np.zeros((0, 4, 2))
    if min(grey.shape) < MIN_PICTURE_PX:
        return TagOutlines(nothing)
    small, scale = reduced(grey, long_side_px, cv2.INTER_LINEAR)
    crowd = _crowd(small, smallest_perimeter_px * scale)
    crowded_px = crowd.perimeter_px / scale
    is_noise = crowd.contours > MAX_CONTOURS
    if is_noise and crowd.perimeter_px > HALVED_FROM_PX:
        small, half = reduced(small, max(small.shape) // 2, cv2.INTER_LINEAR)
        scale *= half
    # OpenCV's limit is a share of the long side of the picture that it is given.
    rate = max(smallest_perimeter_px, crowded_px) * scale / max(small.shape)
    parameters = _parameters(THREE_WINDOWS if thorough and not is_noise else ONE_WINDOW, rate)
    named, _, others = cv2.aruco.ArucoDetector(_no_dictionary(), parameters).detectMarkers(small)
    found = (*named, *others)
    outlines = distinct(_around_dark(np.concatenate(found), scale)) if found else nothing
    return TagOutlines(outlines[:MAX_OUTLINES], crowded_px)


def _crowd(grey: Plane, smallest_perimeter_px: float) -> _Crowd:
    if max(grey.shape) < COUNTED_FROM_PX:
        return _Crowd(0.0)
    half, scale = reduced(grey, max(grey.shape) // COUNTING_SCALE, cv2.INTER_LINEAR)
    window, below = ONE_WINDOW[0] // COUNTING_SCALE | 1, _parameters(ONE_WINDOW, 0.0).adaptiveThreshConstant
    dark = cv2.adaptiveThreshold(half, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, below)
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # The number of points of a contour is its length, from pixel to pixel.
    long = [each for each in contours if len(each) > scale * smallest_perimeter_px]
    if len(long) > MAX_OUTLINES:
        long = [each for each in long if cv2.contourArea(each) > HOLLOW * (len(each) / 4) ** 2]
    if len(long) <= MAX_OUTLINES:
        return _Crowd(0.0, len(contours))
    return _Crowd(COUNTING_ERROR * (sorted(map(len, long), reverse=True)[MAX_OUTLINES] + 4) / scale, len(contours))


def _around_dark(corners: Profiles, scale: float) -> Points:
    """Return where outlines of a reduced picture lead around what is dark, in the full picture, the largest first."""
    around_px = np.abs(corners.take(ROUND, axis=1) - corners).reshape(-1, 8).sum(axis=1, dtype=np.float64)
    # Of a square, each edge is an eighth of the way around from the centre, so moving the edges out by INSET_PX
    # stretches it by this factor. Other shapes of outlines are near enough: they are measured anew.
    growth = (1 + 8 * INSET_PX / around_px) / scale
    centre = corners.sum(axis=1, keepdims=True) / 4
    grown = to_full_scale(centre, scale) + (corners - centre) * growth[:, None, None]
    return np.asarray(grown if len(grown) == 1 else grown[np.argsort(-around_px, kind="stable")])


def _parameters(windows: tuple[int, int], rate: float) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows
    parameters.minMarkerPerimeterRate = max(rate, 1e-3)
    parameters.minDistanceToBorder = 0
    # OpenCV reads the code too, of every outline; with one pixel a cell that costs least, and nothing is made of it.
    parameters.perspectiveRemovePixelPerCell = 1
    # An outline inside another, such as a tag on its paper, would hide behind it.
    parameters.minMarkerDistanceRate = 0.0
    return parameters


@cache
def _no_dictionary() -> cv2.aruco.Dictionary:
    """Return a dictionary of a single small tag: OpenCV returns what it does not recognise as well."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.Dictionary(np.asarray(family.bytesList)[:1], family.markerSize, 0)


def distinct(outlines: Points) -> Points:
    """Leave out what was found twice: of two outlines that are one, the later, shape ``(k, 4, 2)``.

    Only neighbours along an oblique line are compared: a table of all with all would fill the memory where a floor or a
    grille shows thousands. The line is oblique since their rows and columns would meet in one place of an axis.
    """
    if len(outlines) == 1:
        return outlines
    along = outlines.mean(axis=1) @ OBLIQUE
    order = np.argsort(along)
    along = along[order]
    is_left = np.ones(len(outlines), np.bool_)
    # Neighbours in the order along that line, then those two places apart, and so on until none are near any more.
    for step in range(1, len(outlines)):
        near = np.flatnonzero(along[step:] - along[:-step] < NEAR_PX)
        if not len(near):
            break
        one, other = order[near], order[near + step]
        is_same = np.abs(outlines[one] - outlines[other]).reshape(-1, 8).max(axis=1) < SAME_PX
        is_left[np.maximum(one, other)[is_same]] = False
    return outlines[is_left]


# The first look is at the picture halved until its long side is no longer than this.
FIRST_LONG_SIDE_PX = 480

# A picture is never reduced less than what makes the smallest wanted tag this long.
MIN_FOUND_PX = 16.0

# Larger pictures are never searched in full: at half the size 50 megapixels are 12, as many as a still picture of a
# Pi's camera has. Tags that are found are measured in full all the same.
MAX_SEARCHED_PIXELS = 16_000_000

# Tags with a shorter side are not looked for in a reduced picture: their cells run into each other.
MIN_READ_PX = 10.0

# Share of its perimeter that a tag keeps when it is turned by 70 degrees; turned further it cannot be read.
TURNED_SHARE = 0.65

# Length of a tag's side in the reduced picture that is searched around a prediction.
TRACKED_PX = 40.0

# Around a prediction the picture is cut out so that a tag standing on its corner fits in, with some of its paper.
HALF_DIAGONAL, MARGIN_PX = math.sqrt(0.5), 8

# Greatest error of a prediction, in its standard deviations.
SIGMAS = 3.0

# Corners of an outline are good to a pixel or two. Where cells are smaller than this, the sides are measured before the
# code is given up.
SMALL_CELL_PX = 5.0


def candidate(corners_px: Points, reason: str) -> RejectedCandidate:
    """Return an outline of four corners, shape ``(4, 2)``, as a candidate that was rejected."""
    x, y = corners_px.mean(axis=0).tolist()
    corners = tuple((float(x_px), float(y_px)) for x_px, y_px in corners_px)
    size_px = max(side_lengths(corners_px))
    return RejectedCandidate(centre_px=(x, y), size_px=size_px, reason=reason, corners_px=corners)


class LookResult(Struct, frozen=True, kw_only=True, eq=False):
    """Tags and outlines seen in one look at a picture or a part of it."""

    grey: Plane  # what was looked at, shape ``(height, width)``
    left_top_px: Points  # where its first pixel is in the picture
    tags: tuple[SeenTag, ...]  # the tags of the family, the largest first, with their corners in `grey`
    outlines: int  # how many outlines of four corners there were
    left_out_px: float = 0.0  # tags with a shorter side were left out
    is_crowded: bool = False  # whether they were since there are too many outlines
    # Outlines that show no tag of the family, shape ``(4, 2)`` in `grey` each, and why.
    unread: Sequence[tuple[Points, Unread]] = ()

    def rejected(self, most: int) -> list[RejectedCandidate]:
        """Return outlines that show no tag, the most like one first, the larger first where they are alike."""
        likely = sorted(self.unread, key=lambda found: found[1].white_border)[:most]
        return [candidate(corners + self.left_top_px, unread.reason) for corners, unread in likely]


class TagSearch(Struct, frozen=True, kw_only=True):
    """Looks for the tags of a family."""

    family: TagFamily
    light: Light
    min_side_px: float  # tags whose longest side is smaller than this are not looked for
    inverted: bool = False

    def around(self, image: Image, prediction: Prediction) -> LookResult | None:
        """Look where a tag is expected, for whole ones only; None if the place is not in the picture."""
        # All lengths are in pixels of the full picture, and taken at their worst within SIGMAS standard deviations.
        longest_px = prediction.size_px + SIGMAS * prediction.sigma_px
        min_px = max((prediction.size_px - SIGMAS * prediction.sigma_px) / 2, self.min_side_px)
        half_px = HALF_DIAGONAL * prediction.size_px + SIGMAS * prediction.sigma_px + MARGIN_PX
        region = Region.around(prediction.centre_px, half_px, image, outwards=True)
        if region is None:
            return None
        left_top, grey = region.left_top_px, grey_of(region.of(image))
        reduced_px = max(1, round(max(grey.shape) * min(1.0, TRACKED_PX / longest_px)))
        seen = self._whole(grey, left_top, min_px, reduced_px)
        # A tag that is turned far is much narrower than it is long.
        return seen if seen.tags else self._whole(grey, left_top, min_px, max(grey.shape))

    def _whole(self, grey: Plane, left_top: Points, min_px: float, long_side_px: int) -> LookResult:
        outlines = find_outlines(grey, 4 * TURNED_SHARE * min_px, long_side_px, thorough=False)
        # An outline that reaches the edge of the part may go on beyond it.
        height, width = grey.shape
        last = (width - 1 - MARGIN_PX / 2, height - 1 - MARGIN_PX / 2)
        corners = outlines.corners_px
        whole = corners[((corners > MARGIN_PX / 2) & (corners < last)).reshape(-1, 8).all(axis=1)]
        return self._read_all(grey, left_top, outlines._replace(corners_px=whole), len(corners))

    def everywhere(self, image: Image) -> Iterator[LookResult]:
        """Yield what the whole picture shows, each time looking harder and longer: the caller may stop early."""
        grey = grey_of(image)
        yield from self.quickly(grey)
        yield self._look(grey, self._long_sides(grey)[-1], thorough=True)

    def quickly(self, grey: Plane) -> Iterator[LookResult]:
        """Yield what the whole picture shows at each scale, the smallest first; enough for tags that are well seen."""
        for long_side_px in self._long_sides(grey):
            yield self._look(grey, long_side_px, thorough=False)

    def _long_sides(self, grey: Plane) -> list[int]:
        """Return the long sides, in pixels, at which the picture is searched: each time twice as large."""
        # How many times the picture is halved for the first look, and for the last one.
        full_px = max(grey.shape)
        coarsest = max(0, math.ceil(math.log2(full_px / FIRST_LONG_SIDE_PX)))
        by_tag = math.floor(math.log2(self.min_side_px / MIN_FOUND_PX))
        by_memory = math.ceil(math.log2(grey.size / MAX_SEARCHED_PIXELS) / 2)
        finest = max(0, by_tag, by_memory)
        return [max(1, full_px >> halvings) for halvings in range(max(coarsest, finest), finest - 1, -1)]

    def _look(self, grey: Plane, long_side_px: int, *, thorough: bool) -> LookResult:
        scale = long_side_px / max(grey.shape)
        min_px = max(self.min_side_px, MIN_READ_PX / scale)
        outlines = find_outlines(grey, 4 * TURNED_SHARE * min_px, long_side_px, thorough=thorough)
        seen = self._read_all(grey, np.zeros(2), outlines, len(outlines.corners_px))
        crowded_px = outlines.left_out_px / 4
        return replace(seen, left_out_px=max(min_px, crowded_px), is_crowded=crowded_px > min_px)

    def _read_all(self, grey: Plane, left_top: Points, outlines: TagOutlines, count: int) -> LookResult:
        """Read the code in outlines; each tag of the picture counts once."""
        tags: list[SeenTag] = []
        unread: list[tuple[Points, Unread]] = []
        for corners in outlines.corners_px:
            tag = self._read(grey, corners)
            if isinstance(tag, Unread):
                unread.append((corners, tag))
            elif not any(_same(tag, other) for other in tags):
                tags.append(tag)
        return LookResult(grey=grey, left_top_px=left_top, tags=tuple(tags), outlines=count, unread=unread)

    def _read(self, grey: Plane, corners: Points) -> SeenTag | Unread:
        """Read a code, and once more between measured sides where a cell is hardly larger than an outline's error."""
        tag = read_tag(grey, corners, self.family, inverted=self.inverted)
        if not isinstance(tag, Unread) or not tag.may_be_tag:
            return tag
        if not np.abs(corners[[1, 2, 3, 0]] - corners).max() < SMALL_CELL_PX * self.family.cells:
            return tag
        sides = measure_sides(grey, corners, self.family.cells, self.light)
        return tag if sides is None else read_tag(grey, sides.corners_px, self.family, inverted=self.inverted)


def _same(tag: SeenTag, other: SeenTag) -> bool:
    apart = np.abs(tag.corners_px.mean(axis=0) - other.corners_px.mean(axis=0)).max()
    return tag.number == other.number and bool(apart < other.side_px / 2)
