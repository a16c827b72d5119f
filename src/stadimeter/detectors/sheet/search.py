"""The search for a sheet in one picture: candidates, their sides, and what each must pass to be the sheet.

Cheap tests come first and are made on all candidates at once. What decides is the last one: how much speaks for a
candidate being the sheet and not one of the other outlines of the picture, see `stadimeter.detectors.sheet.evidence`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Points, Prediction, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange, Mask
from stadimeter.detectors.sampling import Region, corners_on_border, reduced, sides_on_border, to_full_scale
from stadimeter.detectors.sheet.candidates import (
    MIN_CONTRAST,
    MIN_CUT_SUPPORT,
    SURE_EVIDENCE,
    Findings,
    SheetCandidate,
    SheetFit,
    SheetOutlines,
    Test,
    even_limits,
    other_paper,
    other_shape,
    side_tests,
    small_text,
)
from stadimeter.detectors.sheet.edges import (
    SUPPORTED,
    QuadEdges,
    SheetPicture,
    measure_cut_off,
    refine_corners,
    refine_each,
)
from stadimeter.detectors.sheet.evidence import (
    COARSE_PX,
    CUT_PX,
    FINE_PX,
    MAX_LOG_RATIO,
    Looks,
    SearchedPicture,
    cut_off_evidence,
    facing_evidence,
    find_quadrilaterals,
    not_seen_before,
    other_masks,
    pale_masks,
    quick_masks,
    ratio_evidence,
    shape_evidence,
    sides_evidence,
    slack_share,
)
from stadimeter.detectors.sides import longest_sides_px, quad_shapes, width_and_height
from stadimeter.ranging.flat import SheetShape

# Candidates are looked for at half the resolution; least and most pixels of the long side of what is searched.
SEARCH_SCALE = 0.5
SEARCH_LONG_SIDES_PX = (320, 800)

# Long side of the coarse picture in which a sheet is looked for as a region.
REGIONS_LONG_SIDE_PX = 360

# Shortest side of outlines that are looked for, in pixels of the reduced picture, and of the coarse one: with less,
# hundreds of stripes and letters come before a page; and, in pixels of the picture, of the side that the distance does
# not come from: a strip of lit tape is read by its length where its height is 4 px.
MIN_SEARCHED_PX = 5.0
MIN_REGION_PX = 8.0
MIN_OTHER_SIDE_PX = 3.0

# A sheet turned away further from the line of sight is not looked for: it appears at a third of its length.
MAX_TILT_RAD = math.radians(70)

# Opposite sides may differ this much: a sheet tilted by 60 degrees as far away as it is wide (1.43 to 0.57).
MAX_SIDE_RATIO = 4.0

# The sharpest corner: perspective makes a right angle sharper, but not a spike.
MIN_ANGLE_RAD = math.radians(12)

# How far corners are off as found in the reduced picture, in its pixels.
START_OFF_PX = 1.0

# Candidates that passed this many tests had their sides measured.
SERIOUS_STAGE = 2

# Outlines of another shape, of each kind of masks, of which one may be a page of another size: the largest ones.
PAGES_LOOKED_AT = 3

# Outlines on the border that are looked at, the largest first.
MAX_CUT_OFF = 64

# Share of each side that is seen of a sheet of which the border cuts a corner.
MIN_CUT_CORNER_SUPPORT = 0.6

# Up to this many candidates are measured as they come, which is quicker than to put them in order.
FEW = 3

# Candidates of a mask that are measured, the likeliest first by what is seen of them in the reduced picture, and how
# much speaks for them there at least. Of 60 sheets, on pictures of tables and in rendered clutter, 50 come first, and
# none later than seventh.
MEASURED = (0, 3, 10)
LEAST_LIKELY = -6.5

# Greatest misfit of the corners to those of the sheet, in standard deviations of the measurement and of its shape:
# noise has no bound, but what is cut worse than this is another thing. Of 120 rendered A4 sheets of a named colour, cut
# with rough edges, 75 are found; 64 with 2.0 of the shape and no part of it in pixels. 4.0 and 0.3 px found 77, but no
# more of them within 2 %.
MISFIT_SIGMAS = 4.0
SLACK_SIGMAS = 3.0

# Standard deviation of the shape, as a share of the size, while one side is one of a few that are tried.
UNKNOWN_SIDE_SHARE = 0.005

# Where a sheet is expected, only one of about the expected size, between these factors, counts. This much more speaks
# for it, less half the square of the logarithm of its size by that expected, in these standard deviations.
EXPECTED_EVIDENCE = 2.0
EXPECTED_SIZES = (0.4, 1.4)
EXPECTED_LOG_SIZE = 0.2

# How many sheets of which one side is named have the other one as stated, so that their shape tells as much as of any.
AS_STATED = 0.5

# While one side is not known, what fits badly is not taken for the sheet.
MIN_QUALITY = 0.5

# The stated standard deviation adds this multiple of the misfit: two of the eight coordinates are known beforehand, and
# where these are wrong the others are too. All of these were fitted on rendered sheets, on plain walls and on clutter,
# with noise, JPEG, motion blur and too little light.
MISFIT_FACTOR = 1.5


class SheetSearch:
    """Looks for a sheet in one picture; the lens is None if it is not known."""

    def __init__(
        self,
        image: Image,
        size: SheetShape,
        min_side_px: float,
        lens: CameraModel | None,
        colour: HsvRange | None = None,
    ) -> None:
        self._image = image
        self._colour = colour
        self._lens, self._size = lens, size
        self._picture = SheetPicture.of(image, lens)
        self._min_side_px = min_side_px
        self._aspect = max(size.width_m, size.height_m) / min(size.width_m, size.height_m)
        self._shape = SheetOutlines(size, lens, (image.shape[1], image.shape[0]))
        self._is_strict = size.known_side == "auto"
        self._least_px = min_side_px if self._is_strict else min(min_side_px, MIN_OTHER_SIDE_PX)
        self._stated = SheetOutlines(replace(size, known_side="auto"), lens, (image.shape[1], image.shape[0]))
        self._slack = slack_share(size, by_hand=self._is_strict)
        if not self._is_strict:
            self._slack = math.hypot(self._slack, UNKNOWN_SIDE_SHARE)

    def look(self, region: Region, expected: Prediction | None = None) -> Findings:
        """Look for the sheet in a part of the picture; where one is expected, only what is about as large counts."""
        part = region.of(self._image)
        least, most = SEARCH_LONG_SIDES_PX
        small, scale = reduced(part, int(min(max(SEARCH_SCALE * max(part.shape[:2]), least), most)))
        picture = SearchedPicture.of(small)
        looks = Looks(self._image, picture, scale, region.left_top_px, self._colour)
        findings = Findings()
        outlines = np.empty((0, 4, 2))
        seen: set[tuple[float, ...]] = set()
        # Cheap masks first. The later ones follow only while nothing found is beyond doubt.
        for masks in (self._first_masks, pale_masks, other_masks):
            is_first = masks == self._first_masks
            if masks is pale_masks and max(picture.image.shape) > REGIONS_LONG_SIDE_PX:
                small, scale = reduced(part, REGIONS_LONG_SIDE_PX)
                picture = SearchedPicture.of(small)
            # Half of the smallest side, in pixels of the reduced picture: an outline found there is rough, and the
            # limit itself is tested once its sides are measured.
            least_px = min(MIN_SEARCHED_PX if is_first else MIN_REGION_PX, self._least_px)
            smallest_px = max(self._min_side_px * scale / 2, least_px)
            outlines = find_quadrilaterals(masks(picture), smallest_px, FINE_PX if is_first else COARSE_PX)
            outlines = to_full_scale(outlines, scale) + region.left_top_px
            if is_first:
                looks.note_others(outlines, self._aspect)
            on_border = sides_on_border(outlines, self._image.shape, _margin_px(scale))
            # The same outline shows in many masks; it is judged in the first.
            unseen = not_seen_before(outlines * scale, seen)
            self._judge(findings, outlines[unseen & ~on_border.any(axis=1)], scale, expected, looks)
            if findings.is_sure:
                break
        if not findings.is_sure:
            self._judge_cut_off(findings, outlines, on_border, scale, looks)
        if findings.best is None and findings.cut_off is None and expected is None:
            self._note_page(findings, scale)
        return findings

    def _first_masks(self, picture: SearchedPicture) -> Iterator[Mask]:
        yield from quick_masks(picture)
        if self._colour is not None:
            yield self._colour.mask(picture.image)

    def _judge(
        self, findings: Findings, outlines: Points, scale: float, expected: Prediction | None, looks: Looks
    ) -> None:
        outlines = self._of_the_shape(findings, outlines)
        # A single outline is measured before it is compared with the sheet: it will be compared again once it is.
        if len(outlines) > 1:
            outlines = self._likeliest(self._fitting(findings, outlines, START_OFF_PX / scale), scale, looks)
        for start, end in pairwise(MEASURED):
            if len(outlines) > start and not findings.is_sure:
                edges = refine_each(self._picture, outlines[start:end], START_OFF_PX / scale)
                if edges is not None:
                    self._choose(findings, edges, scale, expected, looks)

    def _likeliest(self, outlines: Points, scale: float, looks: Looks) -> Points:
        """Return the outlines that may be the sheet, the likeliest first, by how they look in the reduced picture."""
        outlines = looks.clearest(outlines)
        if len(outlines) <= FEW:
            return outlines
        longest_px, sigmas = longest_sides_px(outlines), np.full(len(outlines), START_OFF_PX / scale)
        evidence = self._shape_evidence(outlines, self._shape.fits(outlines), sigmas, longest_px)
        evidence = evidence + looks.evidence(outlines)
        order = np.argsort(-evidence, kind="stable")
        return np.asarray(outlines[order[evidence[order] > LEAST_LIKELY]])

    def _of_the_shape(self, findings: Findings, outlines: Points) -> Points:
        """Return the outlines that the sheet may have, whatever their sides look like."""
        shapes = quad_shapes(outlines)
        longest = self._aspect / math.cos(MAX_TILT_RAD)
        tests: tuple[Test, ...] = (
            (shapes.shorter_px >= 0.8 * self._least_px, lambda i: small_text(shapes, i, self._least_px)),
            (
                shapes.side_ratio <= MAX_SIDE_RATIO,
                lambda i: f"opposite sides of {shapes.side_ratio[i]:.1f} to 1, limit {MAX_SIDE_RATIO:.1f} to 1",
            ),
            (
                shapes.sharpest_rad >= MIN_ANGLE_RAD,
                lambda i: (
                    f"a corner of {math.degrees(shapes.sharpest_rad[i]):.0f} degrees, "
                    f"limit {math.degrees(MIN_ANGLE_RAD):.0f}"
                ),
            ),
            (
                shapes.aspect <= longest,
                lambda i: f"too long for the sheet: {shapes.aspect[i]:.1f} to 1, limit {longest:.1f} to 1",
            ),
        )
        good = np.ones(len(outlines), np.bool_)
        for test in tests:
            good = findings.sift(0, outlines, good, test)
        return outlines[good]

    def _fitting(self, findings: Findings, outlines: Points, off_px: float) -> Points:
        """Return the outlines that fit the sheet about as well as they were found."""
        # An error of `off_px` square to two sides that meet at an angle moves their corner by up to off_px / sine.
        misfit_px = self._shape.misfit_px(outlines)
        slack_px = SLACK_SIGMAS * self._slack * longest_sides_px(outlines)
        limits = off_px / np.sin(quad_shapes(outlines).sharpest_rad) + slack_px

        def why(i: int) -> str:
            text = f"corners about {misfit_px[i]:.1f} px from those of the sheet, limit {limits[i]:.1f} px"
            return text + self._other_text(outlines[i])

        every, likely = np.ones(len(outlines), np.bool_), 2 * limits / np.maximum(misfit_px, limits)
        findings.misfits += list(outlines[misfit_px >= limits][:PAGES_LOOKED_AT])
        return outlines[findings.sift(1, outlines, every, (misfit_px < limits, why), likely)]

    def _note_page(self, findings: Findings, scale: float) -> None:
        """Note the largest outline whose sides stand out, where it is a page of another size than the sheet's."""
        sizes_px = [float(longest_sides_px(each[None])[0]) for each in findings.misfits]
        largest_px = findings.largest_refused_px(SERIOUS_STAGE)
        for number in sorted(range(len(sizes_px)), key=lambda number: -sizes_px[number]):
            if sizes_px[number] < largest_px or not self._is_strict:
                return
            sides = refine_corners(self._picture, findings.misfits[number], START_OFF_PX / scale)
            if sides is None or sides.support.min() < SUPPORTED or sides.colour_contrast.min() < MIN_CONTRAST:
                continue
            other = other_shape(sides.corners_px, self._size, self._lens)
            if other:
                findings.refuse_first(sides.corners_px, other)
                return

    def _misfit_limits(self, edges: QuadEdges) -> Values:
        slack_px = self._slack * longest_sides_px(edges.corners_px)
        return MISFIT_SIGMAS * edges.corner_sigmas_px + SLACK_SIGMAS * np.hypot(slack_px, CUT_PX)

    def _misfit_text(self, misfit_px: float, limit_px: float, corners: Points) -> str:
        text = f"corners {misfit_px:.2f} px from those of the sheet, limit {limit_px:.2f} px"
        return text + self._other_text(corners)

    def _other_text(self, corners: Points) -> str:
        other = other_paper(corners, self._size, self._lens)
        return f"; {other}" if other else ""

    def _choose(
        self, findings: Findings, edges: QuadEdges, scale: float, expected: Prediction | None, looks: Looks
    ) -> None:
        """Put the candidates through the last tests, and keep those that may be the sheet."""
        # Quality goes from 0 to 1: the share of the sides that is seen, halved where the shape only just passes.
        fits, sigmas, limits = self._shape.fits(edges.corners_px), edges.corner_sigmas_px, self._misfit_limits(edges)
        misfit_px: Values = np.min([each.misfit_px for each in fits], axis=0)
        quality = np.add.reduce(edges.support, axis=1) / 4 * (1 - np.minimum(misfit_px / limits, 1.0) / 2)
        min_quality = 0.0 if self._is_strict else MIN_QUALITY
        evidence = self._evidence(edges, fits, expected, looks)
        # A corner may lie beyond the border, where the lines of two sides meet that are seen for the most part.
        on_border = corners_on_border(edges.corners_px, self._image.shape, 1.0)
        good = ~sides_on_border(edges.corners_px, self._image.shape, _margin_px(scale)).any(axis=1)
        good &= ~on_border | (edges.support.min(axis=1) >= MIN_CUT_CORNER_SUPPORT)
        tests: tuple[Test, ...] = (
            *_size_test(edges, expected),
            *side_tests(edges, self._least_px),
            *self._known_side_tests(edges.corners_px),
            (misfit_px <= limits, lambda i: self._misfit_text(misfit_px[i], limits[i], edges.corners_px[i])),
            (
                quality >= min_quality,
                lambda i: f"looks little like the sheet: quality {quality[i]:.2f}, limit {min_quality:.2f}",
            ),
        )
        # In order: the first test that a candidate fails is the reason that is given for it.
        for stage, test in enumerate(tests, SERIOUS_STAGE):
            good = findings.sift(stage, edges.corners_px, good, test, evidence / 2)
        # The median of the four contrasts: one side may lie before something brighter than the sheet.
        is_brighter = np.median(edges.contrast, axis=1) >= 0
        is_paper = (self._colour is not None) | is_brighter
        if self._colour is None and good.any():
            is_paper = is_brighter & ~looks.in_frames(edges.corners_px)
        for number in np.nonzero(good)[0].tolist():
            off_px = MISFIT_FACTOR * misfit_px[number] * self._is_strict
            findings.keep(
                SheetCandidate(
                    corners_px=edges.corners_px[number],
                    corner_sigma_px=math.hypot(sigmas[number], off_px),
                    is_brighter=bool(is_brighter[number]),
                    is_paper=bool(is_paper[number]),
                    quality=float(quality[number]),
                    evidence=float(evidence[number]),
                )
            )

    def _evidence(
        self, edges: QuadEdges, fits: Sequence[SheetFit], expected: Prediction | None, looks: Looks
    ) -> Values:
        """Return the evidence for each candidate; while the lens is not known, through that which says most."""
        longest_px = longest_sides_px(edges.corners_px)
        shape = self._shape_evidence(edges.corners_px, fits, edges.corner_sigmas_px, longest_px)
        evidence = shape + looks.evidence(edges.corners_px, edges.inside) + sides_evidence(edges)
        if expected is None:
            return np.asarray(evidence)
        # A normal distribution of the logarithm of the size about the expected one, against an even one elsewhere.
        off = np.log(longest_px / max(expected.size_px, 1.0)) / EXPECTED_LOG_SIZE
        return np.asarray(evidence + EXPECTED_EVIDENCE - off**2 / 2)

    def _shape_evidence(
        self, corners_px: Points, fits: Sequence[SheetFit], sigmas: Values, longest_px: Values
    ) -> Values:
        """Return the evidence of the shapes of outlines whose corners have these standard deviations."""
        fits = fits if self._is_strict else self._stated.fits(corners_px)
        shape: Values = np.max([shape_evidence(fit, sigmas, longest_px, self._size) for fit in fits], axis=0)
        if self._is_strict:
            return shape
        facing = facing_evidence(corners_px, np.hypot(np.hypot(sigmas, CUT_PX), self._slack * longest_px))
        facing += ratio_evidence(self._off_ratio(corners_px))
        return np.asarray(np.logaddexp(math.log(AS_STATED) + shape, math.log(1 - AS_STATED) + facing))

    def _known_sides_px(self, corners_px: Points) -> tuple[Values, Values]:
        """Return the lengths of the named sides of outlines, and of the other ones."""
        sides = np.array([width_and_height(each) for each in corners_px]).reshape(-1, 2).T
        return (sides[0], sides[1]) if self._size.known_side == "width" else (sides[1], sides[0])

    def _off_ratio(self, corners_px: Points) -> Values:
        """Return by how much the ratios of the sides of outlines are off that of the sheet, as logarithms."""
        known_px, other_px = self._known_sides_px(corners_px)
        stated = self._size.width_m / self._size.height_m
        return np.asarray(
            np.log(known_px / other_px) - math.log(stated if self._size.known_side == "width" else 1 / stated)
        )

    def _known_side_tests(self, corners_px: Points) -> tuple[Test, ...]:
        """Return tests of the side that is named, where one is: how long it is, and how long the other one is by it."""
        if self._is_strict:
            return ()
        known_px, _ = self._known_sides_px(corners_px)
        factors = np.exp(np.abs(self._off_ratio(corners_px)))
        limit = math.exp(MAX_LOG_RATIO)
        return (
            (
                known_px >= self._min_side_px,
                lambda i: f"{known_px[i]:.0f} px by its known side, limit {self._min_side_px:.0f} px",
            ),
            (factors <= limit, lambda i: f"sides off the stated ratio {factors[i]:.2f} times, limit {limit:.2f}"),
        )

    def _judge_cut_off(
        self, findings: Findings, outlines: Points, on_border: Flags, scale: float, looks: Looks
    ) -> None:
        """Look for a sheet that the border cuts: its sides inside the picture are those of one."""
        # Of its shape two angles are seen, so what is left must leave no doubt.
        shapes, larger_px = quad_shapes(outlines), findings.largest_refused_px(SERIOUS_STAGE)
        cuts = on_border.sum(axis=1)
        may_be = (cuts > 0) & (cuts <= 2) & (shapes.shorter_px >= self._min_side_px)
        outlines, free = outlines[may_be][:MAX_CUT_OFF], on_border[may_be][:MAX_CUT_OFF]
        if not len(outlines):
            return
        likely = np.nan_to_num(cut_off_evidence(outlines, free) + looks.evidence(outlines, None, free), nan=-np.inf)
        for number in np.nonzero((likely >= 0) & (longest_sides_px(outlines) > larger_px))[0].tolist():
            sides = measure_cut_off(self._picture, outlines[number], 2.0 + 2.0 / scale, free[number])
            edges = None if sides is None else QuadEdges.of([sides])
            if edges is None:
                continue
            cut, seen = free[number : number + 1], ~free[number]
            evidence = cut_off_evidence(edges.corners_px, cut) + looks.evidence(edges.corners_px, edges.inside, cut)
            if (
                edges.support[0, seen].min() >= MIN_CUT_SUPPORT
                and edges.colour_contrast[0, seen].min() >= MIN_CONTRAST
                and edges.unevenness[0, seen].max() <= even_limits(edges)[0]
                and evidence[0] >= SURE_EVIDENCE
            ):
                findings.cut_off = SheetCandidate(
                    corners_px=edges.corners_px[0],
                    corner_sigma_px=float(edges.corner_sigmas_px[0]),
                    is_brighter=bool(np.median(edges.contrast[0]) >= 0),
                    quality=float(edges.support[0].mean()) / 2,
                    evidence=float(evidence[0]),
                )
                return


def _margin_px(scale: float) -> float:
    """Return the distance from the border within which a whole candidate looks like one that is cut off."""
    return 1.0 + 1.0 / scale


def _size_test(edges: QuadEdges, expected: Prediction | None) -> tuple[Test, ...]:
    """Return a test whether candidates are about as large as is expected, if that is known."""
    if expected is None:
        return ()
    sizes = longest_sides_px(edges.corners_px)
    low, high = (expected.size_px * each for each in EXPECTED_SIZES)
    low, high = low - 3 * expected.sigma_px, high + 3 * expected.sigma_px
    passed = (sizes >= low) & (sizes <= high)
    return ((passed, lambda i: f"{sizes[i]:.0f} px long, expected {max(low, 0):.0f} to {high:.0f} px"),)
