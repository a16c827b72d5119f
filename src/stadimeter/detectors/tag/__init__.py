"""The tag detector: one ArUco marker or AprilTag, its four corners to a few hundredths of a pixel.

A tag says itself which one it is, so clutter is hardly ever taken for one.

The corners that OpenCV and the AprilTag library give are good to some tenths of a pixel; both part black from white
half way up in code values instead of light, which alone makes a tag of 48 pixels 1.5 % too small. Here they are the
start for `stadimeter.detectors.tag.sides`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from msgspec.structs import replace
from pydantic import Field, ValidationInfo, field_validator, model_validator

from stadimeter.config.plugins import MAX_SEVERAL, Count, DriverContext, DriverOptions, numbered
from stadimeter.config.units import Length, Tolerance
from stadimeter.core.camera_model import TONE_CURVES, CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction, RejectedCandidate
from stadimeter.core.drawing import Drawing, black_cells
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.sampling import grey_of, light_table, touches_border
from stadimeter.detectors.sides import diagonals_meet, grown, side_lengths, width_and_height
from stadimeter.detectors.tag.search import (
    MAX_OUTLINES,
    LookResult,
    SeenTag,
    TagFamilyName,
    TagSearch,
    candidate,
    tag_family,
)
from stadimeter.detectors.tag.sides import BentSides, TagSides, edge_points, measure_sides
from stadimeter.ranging.flat import TagShape

# Number of reported candidates that are not the tag.
MAX_REJECTED = 8

# A tag with a corner nearer to the border of the picture than this may be cut off.
BORDER_PX = 2.0

# The share of each side that must be seen as a straight edge.
MIN_SUPPORT = 0.5

# Least difference in light between the white around a tag and its black: a share of the most that a picture holds.
MIN_CONTRAST = 0.02

# The standard deviation of a side is `hypot(2.4 s / sqrt(n), 0.007, 0.32 (e / c)^3.5, q, 1.3 b)` pixels, for n steps
# that scatter by s, an edge that takes e pixels from black to white, cells of c pixels, and sides that are bent by b,
# as those of a tag in a hand; q is 0.02 where colour is stored at a lower resolution, as in JPEG and MJPEG, whose
# blocks move whole sides.
#
# Steps beside each other err together, hence the factor. The third term is for blurred edges that run into each other
# across a cell; e counts as 1.8 at least, since in the smallest cells it cannot be seen. Fitted on rendered tags of 16
# to 200 px, clean, with noise, JPEG and motion blur, and with a side bent by 0.5 to 3 %. A camera whose tone curve
# differs from what its model says errs by more, in all frames alike, see `CameraModel.edge_bias_sigma_px`.
SIGMA_FACTOR = 2.4
SIGMA_FLOOR_PX = 0.007
SIGMA_CROWDING_PX, CROWDING_POWER = 0.32, 3.5
SIGMA_COMPRESSED_PX = 0.02
SIGMA_BEND = 1.3
MIN_EDGE_PX = 1.8


class TagOptions(DriverOptions):
    """The options of a printed AprilTag or ArUco tag."""

    side: Length
    """The side of the black square, without the white around it, such as ``"8 cm"``."""
    tolerance: Tolerance | None = None
    """One standard deviation of its side, such as ``"0.2 mm"``; None for a side that is known exactly."""
    family: TagFamilyName = "apriltag-36h11"
    """Such as ``apriltag-36h11`` or ``aruco-4x4-50``."""
    id: Annotated[int | None, Field(ge=0)] = None
    """Which tag of the family; without it, the largest one in view."""
    ids: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1, max_length=MAX_SEVERAL)] | None = None
    """Several tags of the family, each a target of its own."""
    count: Count | None = None
    """How many tags there are at most, whatever their numbers, each a target of its own."""
    min_side_px: Annotated[float, Field(ge=8)] = 10.0
    """Tags whose longest side is smaller than this in the picture are not looked for. The larger, the sooner a picture
    without a tag is done with."""
    inverted: bool = False
    """Whether tags with a white border on black count as well."""

    @field_validator("id", "ids")
    @classmethod
    def _in_family(cls, value: int | list[int] | None, info: ValidationInfo) -> int | list[int] | None:
        name = info.data.get("family")
        numbers = value if isinstance(value, list) else [] if value is None else [value]
        for number in numbers:
            if name is not None and number >= tag_family(name).members:
                last = tag_family(name).members - 1
                raise ValueError(f"{number} is not in {name}, whose tags are numbered 0 to {last}")
            if numbers.count(number) > 1:
                raise ValueError(f"{number} is given twice; each number is one target, so write it once")
        return value

    @model_validator(mode="after")
    def _one_choice(self) -> Self:
        given = [key for key in ("id", "ids", "count") if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} are given; write id for one tag, ids for these, or count for any")
        return self

    @property
    def members(self) -> tuple[str, ...]:
        """The numbers of the tags, or those from 1 to `count`."""
        return tuple(map(str, self.ids)) if self.ids else numbered(self.count)

    def build(self, context: DriverContext) -> TagDetector:
        """Return the detector."""
        return TagDetector(context.name, self)

    def draw(self) -> Drawing:
        """Return the tag upright with a white rim of one cell."""
        family = tag_family(self.family)
        black = np.pad(np.pad(family.cells_of(self.id or next(iter(self.ids or ()), 0)), 1, constant_values=True), 1)
        return black_cells(black.tolist(), self.side / family.cells)


class TagDetector:
    """Finds one tag, or several."""

    def __init__(self, name: str, options: TagOptions) -> None:
        self._name = name
        self._size = TagShape(side_m=options.side, relative_sigma=(options.tolerance or 0.0) / options.side)
        self._number = options.id
        self._numbers = frozenset(options.ids or ([] if options.id is None else [options.id]))
        self._ids = tuple(options.ids or ())
        self._family = tag_family(options.family)
        self._min_side_px = options.min_side_px
        self._searches = {
            tone_curve: TagSearch(
                family=self._family,
                light=light_table(tone_curve),
                min_side_px=options.min_side_px,
                inverted=options.inverted,
            )
            for tone_curve in TONE_CURVES
        }

    @property
    def target_shape(self) -> TagShape:
        """The tag's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the tag; without a number, the one nearest to the prediction or else the largest in view."""
        check_image(frame)
        # Where it is expected first, which takes a fraction of the time; only a tag that is whole there counts.
        near = None if prediction is None else self._near(frame, lens, prediction)
        return near or self._anywhere(frame, lens)

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:
        """Look for every tag of the family, in the order of their numbers; only the one that was named, if one was."""
        check_image(frame)
        found: dict[int, Detection] = {}
        looks = () if self._number is not None else self._search(lens).quickly(grey_of(frame.image))
        for seen in looks:
            for tag in self._tags_of_target(seen):
                if tag.number not in found:
                    each = self._measured(frame, lens, seen, tag)
                    if each.status is DetectionStatus.FOUND:
                        found[tag.number] = replace(each, reason="")
        if len(found) < 2:
            return (self.detect(frame, lens=lens),)
        return tuple(found[number] for number in sorted(found))

    @property
    def numbers(self) -> tuple[int, ...]:
        """Those of the tags that were named, if several were."""
        return self._ids

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: CameraModel | None = None) -> Detection:
        """Look for a tag where it is expected, and nowhere else."""
        check_image(frame)
        missing = Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason="not where it was expected")
        return self._near(frame, lens, prediction) or missing

    def edge_points(self, frame: Frame, found: Detection, *, lens: CameraModel | None = None) -> Points:
        """Return where steps are seen along the sides of a tag that was found."""
        bent = BentSides(camera=lens, left_top_px=np.zeros(2)) if lens and lens.distortion else None
        light = self._search(lens).light
        return edge_points(grey_of(frame.image), found.outline_px, self._family.cells, light, bent)

    def _search(self, lens: CameraModel | None) -> TagSearch:
        return self._searches["srgb" if lens is None else lens.tone_curve]

    def _near(self, frame: Frame, lens: CameraModel | None, prediction: Prediction) -> Detection | None:
        seen = self._search(lens).around(frame.image, prediction)
        wanted = self._tags_of_target(seen)
        if seen is None or not wanted:
            return None
        found = self._measured(frame, lens, seen, _nearest(wanted, prediction.centre_px - seen.left_top_px))
        return self._explained(found, seen) if found.status is DetectionStatus.FOUND else None

    def _anywhere(self, frame: Frame, lens: CameraModel | None) -> Detection:
        answer = None
        seen = None
        refused: list[RejectedCandidate] = []
        # Each look is harder than the last. The first tag that can be measured ends the search; of those that cannot,
        # the reasons of the last look are reported.
        for seen in self._search(lens).everywhere(frame.image):
            refused.clear()
            for tag in self._tags_of_target(seen):
                answer = self._measured(frame, lens, seen, tag)
                if answer.status is not DetectionStatus.NOT_FOUND:
                    return self._explained(answer, seen, refused)
                refused.append(candidate(tag.corners_px + seen.left_top_px, answer.reason))
        if answer is None:
            answer = Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=self._missing(seen))
        return answer if seen is None else self._explained(answer, seen, refused)

    def _explained(self, answer: Detection, seen: LookResult, refused: Sequence[RejectedCandidate] = ()) -> Detection:
        """Add what else was looked at: tags that could not be measured, other tags, outlines without a tag."""
        if not (refused or seen.unread or len(seen.tags) > 1 or answer.status is DetectionStatus.NOT_FOUND):
            return answer
        others = [
            candidate(tag.corners_px + seen.left_top_px, f"is tag {tag.number}, not {self._named}")
            for tag in seen.tags
            if self._numbers and tag.number not in self._numbers
        ]
        rejected = [*refused, *others, *seen.rejected(MAX_REJECTED)]
        return replace(answer, rejected=tuple([each for each in rejected if not _is_at(each, answer)][:MAX_REJECTED]))

    def _tags_of_target(self, seen: LookResult | None) -> list[SeenTag]:
        tags = () if seen is None else seen.tags
        return [tag for tag in tags if not self._numbers or tag.number in self._numbers]

    @property
    def _named(self) -> str:
        return " or ".join(map(str, sorted(self._numbers)))

    def _missing(self, seen: LookResult | None) -> str:
        """Describe what was seen instead of the tag, in words."""
        if seen is not None and seen.tags:
            others = ", ".join(str(number) for number in sorted({tag.number for tag in seen.tags}))
            return f"no tag {self._named} of {self._family.name}, only {others}"
        outlines = 0 if seen is None else seen.outlines
        of_which = f" among {outlines} four-cornered outlines" if outlines else ""
        min_px = max(self._min_side_px, 0.0 if seen is None else seen.left_out_px)
        missing = f"no tag of {self._family.name} of at least {min_px:.3g} px{of_which}"
        if seen is None or min_px == self._min_side_px:
            return missing
        why = f"more than {MAX_OUTLINES} outlines" if seen.is_crowded else "the picture is searched at a smaller size"
        return f"{missing}; smaller ones were not looked for: {why}"

    def _measured(self, frame: Frame, lens: CameraModel | None, seen: LookResult, tag: SeenTag) -> Detection:
        """Measure a tag's sides, in the part of the picture in which it was seen."""
        bent = BentSides(camera=lens, left_top_px=seen.left_top_px) if lens and lens.distortion else None
        sides = measure_sides(seen.grey, tag.corners_px, self._family.cells, self._search(lens).light, bent)
        # Sides are measured in the coordinates of the part that was searched.
        corners = (tag.corners_px if sides is None else sides.corners_px) + seen.left_top_px
        if touches_border(corners, frame.image.shape, BORDER_PX):
            cut_off = self._unmeasured(tag, "is cut off by the border", DetectionStatus.TRUNCATED)
            return replace(cut_off, outline_px=corners)
        trouble = "has no straight sides" if sides is None else self._trouble(sides)
        if sides is None or trouble:
            return self._unmeasured(tag, trouble)
        if lens and lens.edge_bias_px:
            corners = _without_bias(corners, sides, lens.edge_bias_px)
        compressed = (frame.chroma_pitch_px if lens is None else lens.chroma_pitch_px) != (1, 1)
        sigma_px = _size_sigma_px(sides, min(width_and_height(corners)) / self._family.cells, compressed=compressed)
        return self._found(tag, sides, corners, sigma_px, seen.tags)

    def _trouble(self, sides: TagSides) -> str:
        """Return why the sides are not those of a tag; an empty string if they are."""
        longest = max(side_lengths(sides.corners_px))
        if longest < self._min_side_px:
            return f"is too small: {longest:.1f} px, limit {self._min_side_px:g} px"
        # Contrast is a share of the light that a picture can hold; its sign tells a white border on black, so it must
        # be the same on all four sides.
        weakest = min(abs(each) for each in sides.contrast)
        if weakest < MIN_CONTRAST or not all((each > 0) == (sides.contrast[0] > 0) for each in sides.contrast):
            return f"does not stand out on all four sides: {weakest:.1%} of full light, limit {MIN_CONTRAST:.0%}"
        straight = min(sides.lines.support)
        if straight < MIN_SUPPORT:
            return f"has a side of which {straight:.0%} is straight, limit {MIN_SUPPORT:.0%}"
        return ""

    def _found(
        self, tag: SeenTag, sides: TagSides, corners: Points, sigma_px: float, tags: Sequence[SeenTag]
    ) -> Detection:
        width_px, height_px = width_and_height(corners)
        return Detection(
            target=self._name,
            status=DetectionStatus.FOUND,
            reason=self._choice(tag, tags),
            number=tag.number,
            outline_px=corners,
            centre_px=diagonals_meet(corners),
            width_px=width_px,
            height_px=height_px,
            size_sigma_px=sigma_px,
            quality=min(sides.lines.support) * (1 - tag.errors / (2 * self._family.max_errors + 1)),
        )

    def _choice(self, tag: SeenTag, tags: Sequence[SeenTag]) -> str:
        """Return a remark that there was a choice, if there was one."""
        if self._numbers or len(tags) < 2:
            return ""
        return f"tag {tag.number}, one of {len(tags)} of {self._family.name} in view; name one with id"

    def _unmeasured(self, tag: SeenTag, why: str, status: DetectionStatus = DetectionStatus.NOT_FOUND) -> Detection:
        return Detection(target=self._name, status=status, reason=f"tag {tag.number}, {tag.side_px:.0f} px, {why}")


def _is_at(rejected: RejectedCandidate, found: Detection) -> bool:
    """Check whether a candidate is the tag itself: OpenCV sees one border from both its sides."""
    if not len(found.outline_px):
        return False
    x, y = (rejected.centre_px - found.outline_px.mean(axis=0)).tolist()
    return math.hypot(x, y) < rejected.size_px / 4


def _nearest(tags: Sequence[SeenTag], expected_px: Points) -> SeenTag:
    if len(tags) == 1:
        return tags[0]
    return min(tags, key=lambda tag: float(np.abs(tag.corners_px.mean(axis=0) - expected_px).max()))


def _without_bias(corners: Points, sides: TagSides, edge_bias_px: float) -> Points:
    """Return the corners with the camera's edge bias taken off: a black tag appears too small by it."""
    # The bias makes what is bright larger: the paper around a black tag, so its edges move outwards again.
    outwards_px = edge_bias_px if sides.contrast[0] > 0 else -edge_bias_px
    return grown(corners, outwards_px)


def _size_sigma_px(sides: TagSides, cell_px: float, *, compressed: bool) -> float:
    # The mean variance of the four lines, in px^2; see the constants above for the other terms.
    variances_px2 = [
        scatter**2 / max(steps, 1) for scatter, steps in zip(sides.lines.scatter_px, sides.lines.steps, strict=True)
    ]
    of_steps = SIGMA_FACTOR * math.sqrt(sum(variances_px2) / len(variances_px2))
    of_crowding = SIGMA_CROWDING_PX * (max(*sides.edge_px, MIN_EDGE_PX) / cell_px) ** CROWDING_POWER
    of_bends = SIGMA_BEND * sides.lines.bend_px
    return math.hypot(of_steps, SIGMA_FLOOR_PX, of_crowding, SIGMA_COMPRESSED_PX * compressed, of_bends)
