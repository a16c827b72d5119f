"""Outlines in a picture that may be those of discs.

The picture is parted at several levels of brightness. What is bright of it or dark may be a disc; whether it is shaped
like one is seen from its area and its second moments, which an ellipse has in a fixed proportion, and from how far its
outline lies from the ellipse with these moments.

Of a disc that is partly hidden, or touches what is as bright, or is cut off by the border, only a part of the outline
is an ellipse: ellipses through pieces of it are tried, and the one that most of the outline lies on is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from stadimeter.core.detection import Flags, Plane, Points, RejectedCandidate, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.disc.edges import (
    INSIDE,
    Ellipse,
    EllipseEdges,
    Lens,
    Trouble,
    diameters_px,
    ellipse_from_moments,
    ellipse_through,
)
from stadimeter.detectors.hsv import HsvRange
from stadimeter.detectors.sampling import Region, grey_of, reduced, to_full_scale

# The choice of the disc among several ellipses in a picture, and whether it can be made at all ------------------------
#
# Any ellipse of even brightness, such as another lid, looks the same as the disc. How much each speaks for being it
# is one number, see `stadimeter.detectors.disc.edges.evidence`. How many other ellipses a picture holds by chance
# goes with the number of outlines in it: before a wall the only one is the disc, among a hundred shapes of all
# kinds a flat faint one hardly is. A colour that the user has named leaves as many as have it.

MAX_REJECTED = 8

# Least evidence for a disc for each other outline in the picture. Chosen on rendered clutter of which one shape in
# five is an ellipse: another one is taken in 2 to 3 % of the pictures then.
EVIDENCE_PER_OUTLINE = 5.2

# More outlines than this are texture, which is not elliptical, instead of more things.
MAX_OUTLINES = 100

# Another disc with this share of the evidence may as well be the one.
RIVAL_SHARE = 0.75

# Every eighth pixel tells which share of the picture has the disc's colour; it counts as this at least. So much of the
# disc must have it.
COLOUR_STEP = 8
MIN_PICTURE_COLOUR_SHARE = 0.02
MIN_DISC_COLOUR_SHARE = 0.6

# Number of tests that an outline has passed before its colour is looked at.
TESTS = 10


class RefusedDisc(Struct, frozen=True, kw_only=True, eq=False):
    """A candidate that is no disc, as an ellipse in the picture."""

    ellipse: Ellipse
    is_bright: bool
    trouble: Trouble

    @property
    def described(self) -> str:
        """Description of the candidate, and why it is none."""
        larger, smaller, _ = self.ellipse.axes()
        shade = "bright" if self.is_bright else "dark"
        return f"{shade} outline, {2 * larger:.0f}x{2 * smaller:.0f} px, {self.trouble.text}"


class Disc(Struct, frozen=True, kw_only=True, eq=False):
    """A candidate that is a disc, without the lens's distortion."""

    edges: EllipseEdges
    is_bright: bool
    evidence: float
    truncated: bool


class Judged(Struct, kw_only=True):
    """All candidates of a picture or of a part of it."""

    discs: list[Disc] = field(default_factory=list)
    refused: list[RefusedDisc] = field(default_factory=list)
    brightness_range: int = 0
    outlines: int = 0  # how many outlines of another shape there are, at all levels of brightness

    def ranked(self) -> list[Disc]:
        """Return the discs, the best first: a whole one comes before any that the border cuts off."""
        return sorted(self.discs, key=lambda each: (not each.truncated, each.evidence), reverse=True)

    @property
    def has_whole(self) -> bool:
        """True if there is a disc that the border does not cut off."""
        return any(not each.truncated for each in self.discs)


def find_doubt(disc: Disc, judged: Judged, lens: Lens, colour_share: float) -> str:
    """Return why it cannot be said that a disc is the one; an empty string if it can."""
    # First the other discs, then the other outlines: both tell that another ellipse may be the one. Without this test
    # another ellipse was taken in 15 to 27 % of cluttered pictures, with it in 1.5 %.
    rival = next((each for each in judged.ranked() if _is_rival(each, disc)), None)
    advice = "name its colour" if colour_share == 1.0 else "look closer"
    if rival is not None:
        return f"ambiguous: 2 discs fit, {_describe_place(disc, lens)} and {_describe_place(rival, lens)}; {advice}"
    # A named colour leaves as many candidates as have it, so the limit falls by the share of the picture with that
    # colour; texture counts as 100 outlines at most, since in rooms a third of the discs were lost to it.
    limit = EVIDENCE_PER_OUTLINE * min(judged.outlines, MAX_OUTLINES) * colour_share
    if disc.evidence < limit:
        return (
            f"ambiguous: {_describe_place(disc, lens)} may be any ellipse among {judged.outlines} outlines: evidence "
            f"{disc.evidence:.0f}, limit {limit:.0f}; {advice}"
        )
    return ""


def _is_rival(other: Disc, disc: Disc) -> bool:
    """Check whether another disc fits as well, elsewhere: a ring has two outlines around one centre."""
    apart_px = float(np.abs(other.edges.ellipse.centre_px - disc.edges.ellipse.centre_px).max())
    # A quarter of the diameter: inner and outer edge of a ring count as one disc.
    elsewhere = apart_px > diameters_px(disc.edges)[0] / 4
    return elsewhere and not other.truncated and other.evidence > RIVAL_SHARE * disc.evidence


def _describe_place(disc: Disc, lens: Lens) -> str:
    x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
    return f"{diameters_px(disc.edges)[0]:.0f} px at {x:.0f}, {y:.0f}"


def colour_share(image: Image, colour: HsvRange | None) -> float:
    """Return about which share of a picture has a colour; 1 without one."""
    if colour is None:
        return 1.0
    thinned = np.ascontiguousarray(image[::COLOUR_STEP, ::COLOUR_STEP])
    # Every eighth pixel each way: a 64th of the picture. 2 % at least, or a rare colour would leave no limit at all.
    share = int(np.count_nonzero(colour.mask(thinned))) / (thinned.shape[0] * thinned.shape[1])
    return max(float(share), MIN_PICTURE_COLOUR_SHARE)


def find_colour_trouble(image: Image, ellipse: Ellipse, lens: Lens, colour: HsvRange) -> Trouble | None:
    """Return why the inside of an ellipse has not a colour; None if it has."""
    # 64 points on four rings up to three quarters of the half axes, bent to where they appear, nearest pixels.
    last = np.array((image.shape[1], image.shape[0])) - 1
    x, y = np.clip(np.rint(lens.bent(INSIDE @ ellipse.half_axes_px + ellipse.centre_px)), 0, last).astype(np.intp).T
    share = int(np.count_nonzero(colour.mask(np.ascontiguousarray(image[y, x][None])))) / len(x)
    if share >= MIN_DISC_COLOUR_SHARE:
        return None
    return Trouble(TESTS, f"has the disc's colour on {share:.0%} of it, limit {MIN_DISC_COLOUR_SHARE:.0%}")


def refuse_shape(outline: Outline, view: View) -> RefusedDisc:
    """Return an outline of another shape as a candidate that is no disc."""
    larger, smaller, _ = outline.ellipse.axes()
    if outline.off_px < math.inf:
        why = f"is no ellipse: its outline lies {outline.off_px / view.scale:.1f} px off one"
    elif outline.fill <= MIN_FILL:
        why = f"is no ellipse: it fills {outline.fill:.0%} of one, limit {MIN_FILL:.0%}"
    else:
        why = f"is {smaller / larger:.2f} times as high as wide, limit {MIN_ASPECT:.2f}"
    return RefusedDisc(
        ellipse=view.in_full(outline.ellipse), is_bright=outline.shape.is_bright, trouble=Trouble(-1, why)
    )


def likeness(refused: RefusedDisc) -> tuple[int, float]:
    """Return the figures of a candidate that are larger the more it is like a disc."""
    return refused.trouble.passed, refused.ellipse.axes()[0]


def list_rejected(judged: Judged, taken: Disc | None, lens: Lens) -> tuple[RejectedCandidate, ...]:
    """Return the other discs, and what is no disc, the most like one first."""
    found = [] if taken is None else [_describe_less_evident(each, taken, lens) for each in judged.ranked()]
    for each in sorted(judged.refused, key=likeness, reverse=True):
        x, y = lens.bent(each.ellipse.centre_px).tolist()
        found.append(RejectedCandidate(centre_px=(x, y), size_px=2 * each.ellipse.axes()[0], reason=each.trouble.text))
    return tuple(found[:MAX_REJECTED])


def _describe_less_evident(disc: Disc, taken: Disc, lens: Lens) -> RejectedCandidate:
    x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
    if disc.truncated:
        reason = "is cut off by the border"
    else:
        reason = f"stands out less than the disc that was taken: {disc.evidence:.0f}, limit {taken.evidence:.0f}"
    return RejectedCandidate(centre_px=(x, y), size_px=diameters_px(disc.edges)[0], reason=reason)


Contour = NDArray[np.int32]

# Outlines are looked for in a picture of this size, and measured in the full one.
SEARCH_LONG_SIDE_PX = 800

# A disc is found if one of these levels lies between it and all that is around it.
LEVELS = 10

# A picture whose brightest and darkest values differ by less holds nothing.
MIN_RANGE = 6

# Side of the mean filter, in pixels. Without it noise gives thousands of specks at every level.
SMOOTH = 3

# The least area of an outline that is measured, as a share of that of a circle with its length.
COMPACT = 0.5

# The least area of an outline, as a share of that of the ellipse with its moments: a square has 0.955.
MIN_FILL = 0.93

# Flatter outlines are not looked at; the limit for a disc is applied to its measured outline.
MIN_ASPECT = 0.2

# Greatest distance of an outline from its ellipse, root mean square: in pixels, and as a share of the mean half
# axis.
OFF_PX, OFF_SHARE = 0.8, 0.025

# Outlines are one if their centres are nearer than this share of the size, and their sizes differ by less.
SAME_PLACE, SAME_SIZE = 0.2, 0.15

# Number of outlines that are no ellipses, the largest, that are looked at.
MAX_LOOKED_AT = 40


class View(Struct, frozen=True, kw_only=True, eq=False):
    """A part of a picture, reduced if it is large."""

    left_top_px: Points  # its first pixel in the whole picture, x and y
    grey: Plane  # the part in code values, reduced
    scale: float  # by how much: 0.5 for half the size

    @classmethod
    def of(cls, image: Image, region: Region) -> View:
        """Return a view of a part of a picture."""
        small, scale = reduced(region.of(image), SEARCH_LONG_SIDE_PX)
        return cls(left_top_px=region.left_top_px, grey=grey_of(small), scale=scale)

    def in_full(self, ellipse: Ellipse) -> Ellipse:
        """Return where an ellipse of the reduced part is in the whole picture."""
        return Ellipse(
            centre_px=to_full_scale(ellipse.centre_px, self.scale) + self.left_top_px,
            half_axes_px=ellipse.half_axes_px / self.scale,
        )


class Shape(NamedTuple):
    """A region brighter or darker than a level."""

    contour: Contour  # the pixels of its outline, shape ``(n, 1, 2)``
    area: float  # the area within, in px²
    is_bright: bool  # whether it is brighter than what is around it


class Outline(NamedTuple):
    """A shape beside the ellipse that it is most like."""

    shape: Shape
    ellipse: Ellipse
    size_px: float  # the larger diameter of the ellipse
    fill: float  # the area of the shape, as a share of that of the ellipse
    off_px: float  # how far the outline lies from the ellipse, root mean square; infinite if it is flat or hollow
    seen: int = 1  # at how many levels it was seen

    @property
    def promise(self) -> float:
        """Its likely prominence as a disc: a root of contrast times size, times how round it is."""
        larger, smaller, _ = self.ellipse.axes()
        return math.sqrt(self.seen * larger) * smaller / larger

    @property
    def is_elliptical(self) -> bool:
        """True if nearly all of it lies on the ellipse."""
        return self.off_px < max_off_px(self.ellipse)


class DiscOutlines(NamedTuple):
    """Outlines that were found in a picture."""

    ellipses: Sequence[Outline]  # what is elliptical, each of them once, the most promising first
    others: Sequence[Shape]  # what has another shape, at every level
    brightness_range: int  # by how much the brightest and the darkest value differ


def find_outlines(grey: Plane, min_px: float, *, bright: bool, dark: bool) -> DiscOutlines:
    """Find what may be a disc with a larger diameter of `min_px` at least."""
    smooth = np.asarray(cv2.blur(grey, (SMOOTH, SMOOTH)), np.uint8)
    darkest, brightest = (int(each) for each in cv2.minMaxLoc(smooth)[:2])
    if brightest - darkest < MIN_RANGE:
        return DiscOutlines((), (), brightest - darkest)
    ellipses: list[Outline] = []
    others: list[Shape] = []
    # A disc shows as a compact shape at every level between its own brightness and that of what is around it, so the
    # number of levels at which it was seen tells its contrast.
    # Ten levels between the extremes, which are left out: at those nothing is parted.
    for level in np.linspace(darkest, brightest, LEVELS + 2)[1:-1]:
        for shape in _shapes(smooth, float(level), min_px):
            if not (bright if shape.is_bright else dark):
                continue
            outline = _fit_outline(shape) if _is_compact(shape) else None
            if outline is not None and outline.is_elliptical:
                if outline.size_px > min_px:
                    ellipses.append(outline)
            else:
                others.append(shape)
    promising = sorted(pick_distinct(ellipses), key=lambda each: -each.promise)
    return DiscOutlines(ellipses=promising, others=others, brightness_range=brightest - darkest)


def pick_largest(shapes: Iterable[Shape], count: int) -> list[Outline]:
    """Return the largest of shapes that are no ellipses, what was seen at several levels once."""
    looked_at = sorted(shapes, key=lambda each: -each.area)[:MAX_LOOKED_AT]
    outlines = (_fit_outline(each) for each in looked_at)
    return pick_distinct([each for each in outlines if each is not None])[:count]


def max_off_px(ellipse: Ellipse) -> float:
    """Return the distance that the outline of an ellipse may lie from it, root mean square."""
    larger, smaller, _ = ellipse.axes()
    return max(OFF_PX, OFF_SHARE * (larger + smaller) / 2)


def root_mean_square(values: Values) -> float:
    """Return the root of the mean of squares."""
    return math.sqrt(float(values @ values) / len(values))


def _shapes(smooth: Plane, level: float, min_px: float) -> Iterator[Shape]:
    """Yield what is brighter or darker than a level and large enough.

    OpenCV goes around what is bright and around its holes in opposite ways, so the sign of the area tells them apart. A
    tree of the contours tells the same, but OpenCV takes a minute to grow it where there are a hundred thousand holes.
    """
    # All contours in a flat list; the least area is that of the flattest ellipse of this length that is looked at.
    parted = cv2.threshold(smooth, level, 255, cv2.THRESH_BINARY)[1]
    contours, _ = cv2.findContours(parted, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    min_area = MIN_ASPECT * math.pi / 4 * min_px**2
    for contour in contours:
        if len(contour) > 2 * min_px:
            area = cv2.contourArea(contour, oriented=True)
            if abs(area) > min_area:
                yield Shape(np.asarray(contour, np.int32), abs(area), is_bright=area < 0)


def _is_compact(shape: Shape) -> bool:
    # Isoperimetric quotient 4 π A / L², 1 for a circle, 0.785 for a square; the length counts pixels, so diagonals are
    # short and a circle comes out above 1.
    return 4 * math.pi * shape.area > COMPACT * len(shape.contour) ** 2


def _fit_outline(shape: Shape) -> Outline | None:
    """Return the outline of a shape as an ellipse; None for a line."""
    # Area, centroid and central second moments by Green's theorem from the contour: all in pixels of the reduced
    # picture.
    moments = cv2.moments(shape.contour)
    area = moments["m00"]
    centre = (moments["m10"] / area, moments["m01"] / area)
    ellipse = ellipse_from_moments(area, centre, (moments["mu20"], moments["mu11"], moments["mu02"]))
    if ellipse is None:
        return None
    larger, smaller, _ = ellipse.axes()
    fill, off_px = area / (math.pi * larger * smaller), math.inf
    if fill > MIN_FILL and smaller > MIN_ASPECT * larger:
        off_px = root_mean_square(ellipse.distances_px(shape.contour[:, 0].astype(np.float64)))
    return Outline(shape, ellipse, 2 * larger, fill, off_px)


def pick_distinct(outlines: Sequence[Outline]) -> list[Outline]:
    """Keep once what was seen at several levels, as it is most like an ellipse; the largest first."""
    if not outlines:
        return []
    # Greedy: the best of what is alike stays, and how many were alike says at how many levels it was seen, its
    # contrast.
    order = sorted(outlines, key=lambda each: (not each.is_elliptical, each.off_px, -each.fill))
    places = np.array([each.ellipse.centre_px for each in order])
    sizes = np.array([each.size_px for each in order])
    shades = np.array([each.shape.is_bright for each in order])
    is_left = np.ones(len(order), np.bool_)
    kept = []
    for number, outline in enumerate(order):
        if is_left[number]:
            # Same place within a fifth of the size, and same size within 15 %: shapes of neighbouring levels differ by
            # the width of the edge.
            near = (np.abs(places - places[number]) < SAME_PLACE * sizes[number]).all(axis=1)
            alike = np.abs(sizes / sizes[number] - 1) < SAME_SIZE
            same = is_left & near & alike & (shades == shades[number])
            kept.append(outline._replace(seen=int(np.count_nonzero(same))))
            is_left &= ~same
    return sorted(kept, key=lambda each: -each.size_px)


# The pieces of smaller outlines are too short to tell an ellipse from.
MIN_SIZE_PX = 16.0

# Least share of an outline that must be left.
MIN_SHARE_LEFT = 0.55

# Points taken of an outline, the lengths of pieces of it, and how many of each length there are.
POINTS = 96
PIECE_POINTS = (24, 48)
PIECES = 8

# Points within this multiple of what a whole outline may be off are on the ellipse.
TIMES_OFF = 1.5

# Points that are off by less are on the ellipse through a piece.
ON_PIECE_PX = 2.0

FITS = 3
BORDER_PX = 2

_STARTS = np.concatenate([np.arange(0, POINTS, POINTS // PIECES) for _ in PIECE_POINTS])
_ENDS = _STARTS + np.repeat(PIECE_POINTS, PIECES)


def find_partly_hidden(outlines: Iterable[Outline], shape: tuple[int, int]) -> list[Outline]:
    """Find ellipses that most of an outline lies on, hidden or cut off by the border in part, the largest first.

    Args:
        outlines: What is not elliptical as a whole.
        shape: Height and width of the picture.
    """
    found = (_fit_most_of(each, shape) for each in outlines if each.size_px > MIN_SIZE_PX)
    return pick_distinct([each for each in found if each is not None])


def _fit_most_of(outline: Outline, shape: tuple[int, int]) -> Outline | None:
    """Return the ellipse that most of an outline lies on; the border of the picture is no part of it."""
    contour = outline.shape.contour
    points = contour[np.arange(POINTS) * len(contour) // POINTS, 0].astype(np.float64)
    inner = ((points >= BORDER_PX) & (points < np.array(shape[::-1]) - BORDER_PX)).all(axis=1)
    ellipse = ellipse_through(points[_on_best_piece(points, inner)])
    for _ in range(FITS):
        ellipse = None if ellipse is None else ellipse_through(points[inner & _is_on(ellipse, points)])
    if ellipse is None:
        return None
    larger, smaller, _ = ellipse.axes()
    on_it = inner & _is_on(ellipse, points)
    # Steps from pixel to pixel are longer across a diagonal: there are 0.9 pixels on each pixel of length.
    length_px = np.count_nonzero(on_it) * len(contour) / POINTS
    is_left = length_px > 0.9 * MIN_SHARE_LEFT * ellipse.perimeter_px()
    if not (is_left and MIN_SIZE_PX < 2 * larger < 2 * max(shape) and smaller > MIN_ASPECT * larger):
        return None
    return outline._replace(
        ellipse=ellipse, size_px=2 * larger, off_px=root_mean_square(ellipse.distances_px(points[on_it]))
    )


def _on_best_piece(points: Points, inner: Flags) -> Flags:
    """Return which points are on that ellipse through a piece of them that most are on."""
    # Centred and scaled to unit spread, as in `stadimeter.ranging.flat.cone_through`: the normal equations are
    # well conditioned then. Pieces of a quarter and of half of the outline, eight starts each.
    middle = points.mean(axis=0)
    size_px = max(math.sqrt(float(np.mean((points - middle) ** 2))), 1.0)
    x, y = ((points - middle) / size_px).T
    rows = np.stack((x * x, x * y, y * y, x, y), axis=1)
    # One row for each of the 16 pieces, one column for each of the 96 points: all pieces are held against all points at
    # once.
    a, b, c, d, e = (each[:, None] for each in _conics(rows * inner[:, None]).T)
    off = a * x * x + b * x * y + c * y * y + d * x + e * y - 1
    # How far off a point is in space, to first order (P. Sampson, 1982).
    steepness = np.hypot(2 * a * x + b * y + d, b * x + 2 * c * y + e)
    is_on = inner & _is_ellipse(a, b, c, d, e) & (np.abs(off) < ON_PIECE_PX / size_px * np.maximum(steepness, 1e-9))
    return np.asarray(is_on[int(np.argmax(is_on.sum(axis=1)))])


def _is_ellipse(a: Values, b: Values, c: Values, d: Values, e: Values) -> Flags:
    """Return which conics are ellipses with points on them; the middle of the outline need not be inside."""
    area = 4 * a * c - b * b
    safe = np.where(area > 0, area, 1.0)
    x, y = (b * e - 2 * c * d) / safe, (b * d - 2 * a * e) / safe
    return np.asarray((area > 0) & (((d * x + e * y) / 2 - 1) * a < 0), np.bool_)


def _conics(rows: Values) -> Values:
    """Return the conic through each piece, ``a x² + b x y + c y² + d x + e y = 1``, shape ``(pieces, 5)``."""
    twice = np.concatenate((rows, rows))
    # The normal equations of a piece are the difference of two running sums, so all pieces cost as much as one.
    squares = np.concatenate((np.zeros((1, 5, 5)), np.cumsum(twice[:, :, None] * twice[:, None, :], axis=0)))
    sums = np.concatenate((np.zeros((1, 5)), np.cumsum(twice, axis=0)))
    normal = squares[_ENDS] - squares[_STARTS] + 1e-9 * np.eye(5)
    return np.asarray(np.linalg.solve(normal, (sums[_ENDS] - sums[_STARTS])[:, :, None])[:, :, 0])


def _is_on(ellipse: Ellipse, points: Points) -> Flags:
    return np.asarray(np.abs(ellipse.distances_px(points)) < TIMES_OFF * max_off_px(ellipse), np.bool_)
