"""Candidates for a sheet: how well they fit its shape, and what a search took and refused.

How far four corners are from being the picture of a rectangle is found for many outlines at once, without their poses.
The homography from a rectangle to its picture is ``[w r1, h r2, t]`` up to a factor, with r1 and r2 at right angles and
of the same length (Z. Zhang, "A flexible new technique for camera calibration", 2000, section 2.3). Eight coordinates
less six of the pose leave these two conditions. By how much the corners must move to fulfil them follows from their
derivatives to first order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field

from stadimeter.config.units import PAPER, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Points, RejectedCandidate, Values
from stadimeter.detectors.sheet.edges import QuadEdges
from stadimeter.detectors.sides import QuadShapes, longest_sides_px, quad_area, quad_shapes, side_lengths
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import COORDINATES

# Tests of the four sides of a candidate, and of whether it is rather another paper than the one looked for ------------

# The share of any side, and of all sides, that must be seen as a straight edge; and of the others where the border cuts
# one. The rest may be hidden by fingers, or lie before something that looks like the sheet.
MIN_SUPPORT = 0.25
MIN_MEAN_SUPPORT = 0.7
MIN_CUT_SUPPORT = 0.85

# Least contrast of each side with what is behind it, in levels of 8 bits of the channel that differs most.
MIN_CONTRAST = 6.0

# Greatest scatter of the edge about a straight line, in pixels or as a share of the side, whatever is more.
MAX_BEND_PX = 0.6
MAX_BEND_SHARE = 0.003

# Greatest difference of the inside along its border, in levels or as a share of the contrast, whatever is more: light
# may fall off across a sheet, but it is one thing.
UNEVEN_LEVELS = 20.0
UNEVEN_SHARE = 0.35


def side_tests(edges: QuadEdges, min_side_px: float) -> tuple[Test, ...]:
    """Return tests of the sides: which candidates pass, and what to say of one that does not."""
    shapes = quad_shapes(edges.corners_px)
    # One number for each candidate and test; those that follow are shape (c,) but for `support`, which has the sides.
    contrast, support = edges.colour_contrast.min(axis=1), edges.support
    return (
        (shapes.shorter_px >= min_side_px, lambda i: small_text(shapes, i, min_side_px)),
        (
            contrast >= MIN_CONTRAST,
            lambda i: f"stands out on its weakest side by {contrast[i]:.0f} levels, limit {MIN_CONTRAST:.0f}",
        ),
        (support.min(axis=1) >= MIN_SUPPORT, lambda i: straight_text(edges, i, MIN_SUPPORT)),
        (
            support.mean(axis=1) >= MIN_MEAN_SUPPORT,
            lambda i: f"{support[i].mean():.0%} of its sides are straight edges, limit {MIN_MEAN_SUPPORT:.0%}",
        ),
    )


def bends(edges: QuadEdges) -> Values:
    """Return the scatter of the most bent side's steps about a straight line, in times the limit, shape ``(c,)``."""
    limits_px = np.maximum(MAX_BEND_PX, MAX_BEND_SHARE * quad_shapes(edges.corners_px).sides_px)
    return np.asarray((edges.scatter_px / limits_px).max(axis=1))


def unevenness(edges: QuadEdges) -> Values:
    """Return the difference of the inside along the border, in times the limit, shape ``(c,)``."""
    uneven = np.maximum(edges.unevenness.max(axis=1), _imbalance(edges))
    return np.asarray(uneven / even_limits(edges))


def even_limits(edges: QuadEdges) -> Values:
    """Return by how many levels the inside may differ along the border."""
    limits: Values = np.maximum(UNEVEN_LEVELS, UNEVEN_SHARE * edges.colour_contrast.max(axis=1))
    return limits


def _imbalance(edges: QuadEdges) -> Values:
    """Return by how many levels the insides differ, other than by light that falls off evenly across."""
    # Light that falls off in one direction makes one side of each pair brighter by as much as the other is darker: the
    # sums of both pairs are then alike, whatever the colour of the sheet.
    across = edges.inside[:, [0, 2]].sum(axis=1) - edges.inside[:, [1, 3]].sum(axis=1)
    imbalance: Values = np.abs(across).max(axis=1) / 2
    return imbalance


def small_text(shapes: QuadShapes, number: int, limit_px: float) -> str:
    """Say how small a candidate is."""
    return f"{shapes.shorter_px[number]:.0f} px wide, limit {limit_px:.0f} px"


def straight_text(edges: QuadEdges, number: int, limit: float) -> str:
    """Say how little of its worst side is seen."""
    return f"a side of which {edges.support[number].min():.0%} is a straight edge, limit {limit:.0%}"


# Two ratios of sides are different, or the same, that differ by more, or less, than this share.
OTHER_SHAPE = 0.04
SAME_SHAPE = 0.02

# Papers whose areas differ by more than this factor, as a logarithm, are not mistaken for each other.
LIKE_IN_SIZE = math.log(1.5)

# Greatest cosine of a corner in space that is a right one.
RIGHT_ANGLE = 0.05

# Opposite sides of a sheet that faces the camera differ by this factor at most.
FACING_RATIO = 1.03

# A sheet has a name if both its sides are those of the paper, to this share.
NAMED = 0.005

_SIDES_M = {name: tuple(sorted(map(parse_length, each))) for name, each in PAPER.items()}


def other_paper(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which paper an outline is rather than the sheet: ``sides 1.29 : 1, not 1.41 : 1: letter instead of A4?``.

    Empty where no paper that it may be mistaken for explains it better. Without the lens only what faces the camera
    tells its shape.
    """
    seen = _seen_aspect(corners_px, lens)
    wanted = size.longest_m / size.shortest_m
    if seen is None or _log_ratio(seen, wanted) < OTHER_SHAPE:
        return ""
    alike = [name for name in mistaken_for(size) if _log_ratio(_aspect(_SIDES_M[name]), seen) < SAME_SHAPE]
    return f"sides {seen:.2f} : 1, not {wanted:.2f} : 1: {alike[0]} instead of {_name(size)}?" if alike else ""


def other_shape(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which size would fit an outline that is no picture of the sheet; empty where it is no rectangle for sure."""
    seen, wanted = _seen_aspect(corners_px, lens), size.longest_m / size.shortest_m
    if seen is None or _log_ratio(seen, wanted) < OTHER_SHAPE:
        return ""
    long_mm = 1000 * size.longest_m
    fitting = f"sides {seen:.2f} : 1, not {wanted:.2f} : 1; about {long_mm:.0f} x {long_mm / seen:.0f} mm would fit"
    return other_paper(corners_px, size, lens) or fitting


def mistaken_for(size: SheetShape) -> list[str]:
    """Return the papers that a sheet with a name may be mistaken for, the likeliest first; none for any other sheet.

    They are of about its size, but of another shape: one of the same, such as A5 for A4, looks just alike, so it
    explains nothing.
    """
    if not _name(size):
        return []
    off = {name: _log_ratio(each[0] * each[1], size.shortest_m * size.longest_m) for name, each in _SIDES_M.items()}
    own = size.longest_m / size.shortest_m
    others = (name for name, each in _SIDES_M.items() if _log_ratio(_aspect(each), own) >= OTHER_SHAPE)
    return sorted((name for name in others if off[name] < LIKE_IN_SIZE), key=lambda name: off[name])


def _name(size: SheetShape) -> str:
    return next((name for name, each in _SIDES_M.items() if _is_size(each, size)), "")


def _aspect(sides_m: tuple[float, ...]) -> float:
    return sides_m[1] / sides_m[0]


def _seen_aspect(corners_px: Points, lens: CameraModel | None) -> float | None:
    if lens is None:
        shapes = quad_shapes(corners_px[None])
        is_turned = shapes.side_ratio[0] > FACING_RATIO or math.cos(shapes.sharpest_rad[0]) > RIGHT_ANGLE
        return None if is_turned else float(shapes.aspect[0])
    cosine, ratio = seen_sides(lens.directions(corners_px))
    return max(ratio, 1 / ratio) if abs(cosine) < RIGHT_ANGLE and ratio > 0 else None


def _log_ratio(one: float, other: float) -> float:
    return abs(math.log(one / other))


def _is_size(sides_m: tuple[float, ...], size: SheetShape) -> bool:
    return _log_ratio(sides_m[0], size.shortest_m) < NAMED and _log_ratio(sides_m[1], size.longest_m) < NAMED


# Which candidates pass, and what to say of one that does not, by its number.
Test = tuple[Flags, Callable[[int], str]]

# Rejected candidates that are reported, and those that each test notes.
MAX_REJECTED = 8
REFUSED_OF_A_KIND = 3

# The stage of what passed all tests: later than the last of them, so that it is reported first.
KEPT_STAGE = 16

# Least evidence of what is taken for the sheet (of 100 rooms without one none has more than 0.8; a page on grained wood
# has 1.4), and that beyond which no other one is looked for; and least evidence of what is perhaps the sheet, where
# nothing else is as likely: of what looks like paper, and of what does not, such as a letter on a page.
MIN_EVIDENCE = 1.3
SURE_EVIDENCE = 2.5
MIN_PERHAPS, MIN_PERHAPS_OTHER = -1.5, -0.7

# A candidate with less evidence than another by RIVAL_EVIDENCE is not the sheet, unless it is beyond doubt itself. Two
# that may be it contradict each other if the logarithms of their sizes differ by more than RIVAL_LOG_SIZE, plus
# RIVAL_LOG_SIZE_A_LENGTH for each length of the sheet that they are apart, up to MAX_LENGTHS: of two strips of tape
# beside each other on a wall that is turned away, one is nearer, and both are right.
RIVAL_EVIDENCE = 1.5
RIVAL_LOG_SIZE = 0.05
RIVAL_LOG_SIZE_A_LENGTH, MAX_LENGTHS = 0.05, 3.0

# Candidates whose corners are all nearer to each other are one.
SAME_PX = 1.0


class SheetCandidate(Struct, frozen=True, kw_only=True, eq=False):
    """An outline that looks like the sheet."""

    corners_px: Points  # its corners, clockwise on the screen, shape ``(4, 2)``
    corner_sigma_px: float  # standard deviation of their coordinates
    is_brighter: bool  # whether it is brighter than what is around it
    quality: float  # from 0, barely a candidate, to 1, as it should look
    is_paper: bool = True  # whether nothing tells that it is a frame, a screen or a pane rather than paper
    evidence: float = 0.0  # how much speaks for it being the sheet, see `stadimeter.detectors.sheet.evidence`

    @property
    def score(self) -> float:
        """The larger and the more like the sheet, the better; of what is beyond doubt, the larger."""
        return min(self.evidence, SURE_EVIDENCE) + math.log(max(quad_area(self.corners_px.tolist()), 1e-9))

    @property
    def longest_px(self) -> float:
        """The length of its longest side."""
        return max(side_lengths(self.corners_px))

    @property
    def where(self) -> str:
        """Its size and place, for messages."""
        return f"{self.longest_px:.0f} px long at ({self.centre_px[0]:.0f}, {self.centre_px[1]:.0f})"

    @property
    def centre_px(self) -> tuple[float, float]:
        """The mean of its corners."""
        x_px, y_px = self.corners_px.mean(axis=0).tolist()
        return x_px, y_px


class RefusedCandidate(NamedTuple):
    """A candidate that failed a test; what is said of it is put into words when it is asked for."""

    rank: float  # the more like the sheet, the more
    stage: int
    centre_px: tuple[float, float]
    size_px: float
    corners_px: Points
    why: Callable[[], str]

    def rejected(self) -> RejectedCandidate:
        """Return it with its reason in words."""
        corners = tuple((float(x_px), float(y_px)) for x_px, y_px in self.corners_px)
        return RejectedCandidate(centre_px=self.centre_px, size_px=self.size_px, reason=self.why(), corners_px=corners)


class Findings(Struct, kw_only=True):
    """Result of a search."""

    # What passed every test but, perhaps, that of the evidence.
    kept: list[SheetCandidate] = field(default_factory=list)
    # The largest outline that could be one and is cut off by the border, if there is no whole one.
    cut_off: SheetCandidate | None = None
    refused: list[RefusedCandidate] = field(default_factory=list)
    # The largest outlines of another shape, each ``(4, 2)``.
    misfits: list[Points] = field(default_factory=list)

    # Of these, what may be the sheet, the likeliest first.
    likely: list[SheetCandidate] = field(default_factory=list)

    @property
    def best(self) -> SheetCandidate | None:
        """The outline that looks most like the sheet; None if none is one."""
        return self.likely[0] if self.likely else None

    @property
    def is_sure(self) -> bool:
        """True if the best one is the sheet beyond doubt: paper, of which enough tells, and nothing contradicts."""
        return self.best is not None and not self.doubt

    @property
    def rival(self) -> SheetCandidate | None:
        """Another one that is as likely, and would be at another distance; None if there is none."""
        best = self.best
        others = (each for each in self.likely[1:] if best and _contradict(each, best) and not _is_inside(each, best))
        return next(others, None)

    @property
    def twin(self) -> SheetCandidate | None:
        """Another one that may be the sheet and is about as far away; None if there is none."""
        best = self.best
        others = (each for each in self.likely[1:] if best and not _contradict(each, best) and _apart(each, best) > 0.5)
        return next(others, None)

    @property
    def doubt(self) -> str:
        """The reason the best one is only perhaps the sheet, or none is taken; empty where it is beyond doubt."""
        best, rival = self.best, self.rival
        if best is None:
            return ""
        if rival is not None:
            return f"two outlines fit, one {best.where}, one {rival.where}; name its colour, or take the other one away"
        if best.evidence < MIN_EVIDENCE:
            return f"little speaks for it: evidence {best.evidence:.1f}, limit {MIN_EVIDENCE:.1f}"
        if not best.is_paper:
            looks = "in a frame" if best.is_brighter else "darker than what is around it"
            return f"it is {looks}; name its colour if it is the sheet"
        return ""

    def keep(self, candidate: SheetCandidate) -> None:
        """Keep what passed all tests, if it is not there already."""
        same = (np.abs(each.corners_px - candidate.corners_px).max() < SAME_PX for each in self.kept)
        if any(same):
            return
        self.kept.append(candidate)
        # Evidence is a logarithm: RIVAL_EVIDENCE below the best means less than a quarter of its odds. A dark frame, or
        # the pale mat in it, has the shape of paper too: beside it, what looks like paper needs no more than is enough.
        papers = [each for each in self.kept if each.is_paper]
        most, most_of_papers = (max((c.evidence for c in every), default=-math.inf) for every in (self.kept, papers))
        is_paper = most_of_papers >= min(most - RIVAL_EVIDENCE, MIN_EVIDENCE)
        most, every = (most_of_papers, papers) if is_paper else (most, self.kept)
        least = max(most - RIVAL_EVIDENCE, MIN_PERHAPS if is_paper else MIN_PERHAPS_OTHER)
        likely = [each for each in every if each.evidence >= least]
        self.likely = sorted(likely, key=lambda each: -each.score)

    def sift(self, stage: int, corners: Points, good: Flags, test: Test, likely: Values | None = None) -> Flags:
        """Return which of the good candidates, ``(c, 4, 2)``, pass a test; note the likeliest, or largest, that fail.

        The later the test, the more like the sheet they are; how likely each is, about -10 to 10, counts like tests.
        """
        # The rank joins both: whole numbers are the stage. The logarithm of the size over ten stays below one test.
        passed, why = test
        numbers = (good > passed).nonzero()[0]
        if len(numbers):
            sizes = longest_sides_px(corners[numbers])
            ranks = np.log(sizes) / 10 if likely is None else np.minimum(np.maximum(likely[numbers], -10.0), 10.0)
            for which in np.argsort(-ranks, kind="stable")[:REFUSED_OF_A_KIND].tolist():
                number = int(numbers[which])
                x_px, y_px = (np.add.reduce(corners[number], axis=0) / 4).tolist()
                rank, size_px = stage + float(ranks[which]), float(sizes[which])
                self.refused.append(
                    RefusedCandidate(rank, stage, (x_px, y_px), size_px, corners[number], partial(why, number))
                )
        return good & passed

    def refuse_first(self, corners_px: Points, why: str) -> None:
        """Note an outline that is refused as the first of those that are reported."""
        sizes_px, (x_px, y_px) = longest_sides_px(corners_px[None]), corners_px.mean(axis=0).tolist()
        first = max((each.rank for each in self.refused), default=0.0) + KEPT_STAGE
        refused = RefusedCandidate(first, KEPT_STAGE, (x_px, y_px), float(sizes_px[0]), corners_px, lambda: why)
        self.refused.append(refused)

    def largest_refused_px(self, stage: int) -> float:
        """Return the size of the largest candidate that was refused at a stage or later; 0 if none was."""
        return max((each.size_px for each in self.refused if each.stage >= stage), default=0.0)

    def rejected(self) -> tuple[RejectedCandidate, ...]:
        """List the refused candidates, the most like the sheet first, each place once."""
        taken = None if self.rival else self.best
        others = [each for each in self.kept if each is not taken]
        every = [_as_refused(each) for each in others] + self.refused
        kept: list[RejectedCandidate] = []
        places = [] if taken is None else [taken.centre_px]
        for each in sorted(every, key=lambda item: (-item.rank, -item.size_px)):
            if all(math.dist(each.centre_px, place) > 0.1 * each.size_px + 2 for place in places):
                kept.append(each.rejected())
                places.append(each.centre_px)
            if len(kept) == MAX_REJECTED:
                break
        return tuple(kept)


def _is_inside(one: SheetCandidate, other: SheetCandidate) -> bool:
    """Check whether an outline lies in another one, so that it is what is on the sheet."""
    return cv2.pointPolygonTest(other.corners_px.astype(np.float32), one.centre_px, measureDist=False) > 0


def _contradict(one: SheetCandidate, other: SheetCandidate) -> bool:
    """Check whether two candidates would be sheets at different distances."""
    allowed = RIVAL_LOG_SIZE + RIVAL_LOG_SIZE_A_LENGTH * min(_apart(one, other), MAX_LENGTHS)
    return abs(math.log(one.longest_px / other.longest_px)) > allowed


def _apart(one: SheetCandidate, other: SheetCandidate) -> float:
    """Return the number of their lengths that lie between their centres."""
    return math.dist(one.centre_px, other.centre_px) / max(one.longest_px, other.longest_px)


def _as_refused(candidate: SheetCandidate) -> RefusedCandidate:
    reason = "fits too, but less well or smaller"
    if candidate.evidence < MIN_EVIDENCE:
        reason = f"too little speaks for it: evidence {candidate.evidence:.1f}, limit {MIN_EVIDENCE:.1f}"
    rank = KEPT_STAGE + candidate.evidence
    size_px, corners_px = candidate.longest_px, candidate.corners_px
    return RefusedCandidate(rank, KEPT_STAGE, candidate.centre_px, size_px, corners_px, lambda: reason)


# Focal lengths tried while the lens is not known, in lengths of the picture's longer side, from wide-angle to
# telephoto: so close to each other that one beside the true one changes no verdict.
FOCAL_LENGTHS = tuple(0.5 * 1.085**step for step in range(25))

# Lengths tried for the side that is not named, as multiples of the one in the options.
UNKNOWN_SIDES = (0.5, 0.65, 0.8, 1.0, 1.25, 1.55, 2.0)


class SheetFit(Struct, frozen=True, kw_only=True, eq=False):
    """Misfit of outlines to the sheet."""

    misfit_px: Values  # how far their corners are from where a sheet would have them, root mean square, shape ``(c,)``
    # What the square of a misfit in pixels is multiplied by to give the share of any outlines that fit as well, shape
    # ``(c,)``; 0 where it is not known, with only one side known.
    chance_per_square: Values


class SheetOutlines:
    """Shapes that pictures of the sheet may have, in a picture of this width and height; the lens may be unknown."""

    def __init__(self, size: SheetShape, lens: CameraModel | None, picture: tuple[int, int]) -> None:
        aspect = size.width_m / size.height_m
        one_side = size.known_side != "auto"
        self._aspects = tuple(aspect * each for each in UNKNOWN_SIDES) if one_side else (aspect,)
        long_px = float(max(picture))
        self._lenses = (
            tuple(CameraModel.with_focal_length(each * long_px, *picture) for each in FOCAL_LENGTHS)
            if lens is None
            else (lens,)
        )
        # With one side known any rectangle fits, so a fit says nothing against chance.
        self._tells_chance = not one_side

    def misfit_px(self, corners_px: Points) -> Values:
        """Measure how far outlines, ``(c, 4, 2)``, are from the sheet as they look through the best lens."""
        return np.asarray(np.min([each.misfit_px for each in self.fits(corners_px)], axis=0))

    def fits(self, corners_px: Points) -> list[SheetFit]:
        """Compare outlines, ``(c, 4, 2)``, with the sheet, through each of the possible lenses."""
        return [self._through(lens, corners_px) for lens in self._lenses]

    def _through(self, lens: CameraModel, corners_px: Points) -> SheetFit:
        # Fits are in directions, x and y per unit of depth; times the focal length they are pixels again.
        focal_px = math.sqrt(lens.fx_px * lens.fy_px)
        directions = lens.directions(corners_px.reshape(-1, 2)).reshape(-1, 4, 2)
        fits = [rectangle_fit(directions, aspect) for aspect in self._aspects]
        chance = fits[0].chance_per_square / focal_px**2
        return SheetFit(
            misfit_px=np.min([each.misfit for each in fits], axis=0) * focal_px,
            chance_per_square=chance if self._tells_chance else np.zeros_like(chance),
        )


# Derivatives are differences over this share of an outline's size.
STEP = 1e-4

_SHIFTS = np.concatenate((np.zeros((1, COORDINATES)), np.eye(COORDINATES))).reshape(-1, 1, 4, 2)


class RectangleFit(Struct, frozen=True, kw_only=True, eq=False):
    """The fit of outlines to a rectangle."""

    # How far the corners appear from where the nearest picture of the rectangle has them: root mean square of
    # the coordinates' moves, per unit of depth, shape ``(c,)``.
    misfit: Values
    # What the square of a misfit is multiplied by to give the share of all outlines that fit at least as well,
    # shape ``(c,)``. Small outlines, and those seen from far, fit nearly anything.
    chance_per_square: Values


def rectangle_fit(directions: Points, aspect: float) -> RectangleFit:
    """Compare outlines with pictures of a rectangle, whose widths may be either two sides.

    The share of outlines that fit as well is the area of the ellipse of such fits in the plane of both conditions, the
    cosine of the angle and the logarithm of the ratio: outlines of any kind are spread over about 1 in each.

    Args:
        directions: Corners of outlines, x and y per unit of depth with the lens's distortion undone, in order around
            each, shape ``(c, 4, 2)``.
        aspect: Width over height of the rectangle.
    """
    middle = np.add.reduce(directions, axis=1, keepdims=True) / 4
    size = np.abs(directions - middle).max(axis=(1, 2), initial=0.0)
    step = np.maximum(STEP * size, 1e-12)
    with np.errstate(all="ignore"):  # outlines that are no quadrilateral give NaN
        conditions = _conditions(directions + _SHIFTS * step[:, None, None])
        slopes = (conditions[:, 1:] - conditions[:, :1]) / step
        (a, c), b = np.add.reduce(slopes * slopes, axis=1), np.add.reduce(slopes[0] * slopes[1], axis=0)
        (angle, ratio), log_aspect = conditions[:, 0], math.log(aspect)
        determinant = a * c - b * b
        # The square of the shortest move of all coordinates that takes both conditions to 0, to first order.
        off = np.stack((ratio - log_aspect, ratio + log_aspect))
        # Shortest move that fulfils two linear conditions J δ = -r: |δ|² = r' (J J')⁻¹ r, here with J J' = [[a, b], [b,
        # c]] written out. Of the two aspects (upright, across) the nearer one counts.
        move = ((c * angle * angle + a * off * off - (2 * b * angle) * off) / determinant).min(axis=0)
        square = np.where(np.isfinite(move), np.maximum(move, 0.0), np.inf) / COORDINATES
        area = (COORDINATES * math.pi) * np.sqrt(np.where(determinant > 0, determinant, 0.0))
    return RectangleFit(misfit=np.sqrt(square), chance_per_square=area)


def seen_sides(directions: Points) -> tuple[float, float]:
    """Return the cosine between the sides of a rectangle in space, and their ratio, from its four corners ``(4, 2)``.

    The cosine is not 0 for what is no rectangle; NaN for no quadrilateral.
    """
    with np.errstate(all="ignore"):
        cosine, ratio = _conditions(directions[None]).tolist()
    return cosine[0], math.exp(ratio[0])


def _conditions(corners: Points) -> Values:
    """Return the cosine between both sides in space, and the logarithm of their ratio, 0 for a square: ``(2, …)``."""
    p0, p1, p2, p3 = np.ascontiguousarray(corners.transpose(-2, -1, *range(corners.ndim - 2)))
    d1, d2, total = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    across = d1[0] * d2[1] - d2[0] * d1[1]
    # Heckbert's homography of the unit square again, for arrays: g and h are its last row, `first` and `second` its
    # first two columns, parallel to the sides in space.
    g, h = (total[0] * d2[1] - d2[0] * total[1]) / across, (d1[0] * total[1] - total[0] * d1[1]) / across
    first, second = p1 - p0 + g * p1, p3 - p0 + h * p3
    one = first[0] * first[0] + first[1] * first[1] + g * g
    other = second[0] * second[0] + second[1] * second[1] + h * h
    product = first[0] * second[0] + first[1] * second[1] + g * h
    return np.stack((product / np.sqrt(one * other), np.log(one / other) / 2))
