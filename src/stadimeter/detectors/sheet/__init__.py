"""The sheet detector: a flat rectangle of known size, its four corners to a few hundredths of a pixel.

Outlines are proposed and judged in `evidence` for `search`, and their corners refined in `edges`. While a
sheet is tracked, `follow` refines the corners that are expected, without a search.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length, Paper, Tolerance, paper_sides, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.hsv import HsvRange, HsvRangeText
from stadimeter.detectors.protocol import ONE_OF_A_KIND, Remedy, check_image
from stadimeter.detectors.sampling import Region, touches_border
from stadimeter.detectors.sheet.candidates import (
    MAX_BEND_PX,
    MAX_BEND_SHARE,
    MIN_CONTRAST,
    MIN_MEAN_SUPPORT,
    MIN_SUPPORT,
    Findings,
    SheetCandidate,
    mistaken_for,
    other_paper,
)
from stadimeter.detectors.sheet.edges import OutlineSides, SheetPicture, edge_points, refine_corners
from stadimeter.detectors.sheet.evidence import slack_share
from stadimeter.detectors.sheet.search import EXPECTED_SIZES, MISFIT_FACTOR, MISFIT_SIGMAS, SLACK_SIGMAS, SheetSearch
from stadimeter.detectors.sides import diagonals_meet, grown, side_lengths, width_and_height
from stadimeter.ranging.flat import KnownSide, SheetShape
from stadimeter.ranging.plane_pose import rectangle_poses

# Reach of the search around a prediction, to each side: in longer sides and pixels.
REGION_SIDES = 0.8
REGION_MARGIN_PX = 12.0

# Tolerances to try for a sheet whose corners are too far off, as shares of its size: 1, 2 and 3 mm for A4. At more it
# may be another paper.
TOLERANCE_SHARES = (0.004, 0.008, 0.012)

# Of a sheet's shorter side, the camera's edge bias may make up this share at most.
MAX_BIAS_SHARE = 0.5

# A sheet that is expected nearer to the border is searched for: it may be cut off.
BORDER_PX = 4.0

# An expected outline that leads further out, or nowhere, is none.
MAX_COORDINATE_PX = 1e5


def _or_by_name(schema: dict[str, Any]) -> None:
    """Say in the JSON Schema that a size by name stands for both sides."""
    schema.pop("required", None)
    schema["anyOf"] = [{"required": ["size"]}, {"required": ["width", "height"]}]


class SheetOptions(DriverOptions):
    """The options of a flat rectangle, such as a sheet of paper: measured by its corners, however it is turned."""

    written_elsewhere: ClassVar[dict[str, str]] = ONE_OF_A_KIND

    size: Paper | None = None
    """A paper or card by name, such as ``"A4"`` or ``"letter"``, in place of both sides."""
    width: Length
    """The sheet's horizontal side as it hangs, such as ``"11 in"``."""
    height: Length
    """Its vertical side as it hangs."""
    known_side: KnownSide = "auto"
    """Which side the distance is computed from: ``auto``, ``width`` or ``height``."""
    min_side_px: Annotated[float, Field(ge=4)] = 8.0
    """Sheets whose shorter side, or the one that is known, is smaller than this in the picture are not accepted."""
    tolerance: Tolerance | None = None
    """One standard deviation of its sides, such as ``"1 mm"``: how well its size is known."""

    hsv: HsvRangeText | None = None
    """Its colours, such as ``"0,0,150:179,60,255"`` for white, as a ball's. They are evidence, not a condition; without
    them, the brightest or the darkest thing in the picture looks most like the sheet."""

    model_config = ConfigDict(json_schema_extra=_or_by_name)

    @model_validator(mode="before")
    @classmethod
    def _sides_by_name(cls, table: Any) -> Any:
        if not isinstance(table, Mapping) or table.get("size") is None:
            return table
        if "width" in table or "height" in table:
            raise ValueError(f"size = {table['size']!r} gives both sides; leave out width and height")
        try:
            width, height = paper_sides(table["size"])
        except ValueError:  # the key itself says what is wrong with it
            width = height = "1 m"
        return {**table, "width": width, "height": height}

    @property
    def shape(self) -> SheetShape:
        """The sheet's shape."""
        tolerance_m = 0.0 if self.tolerance is None else self.tolerance
        return SheetShape(
            width_m=self.width,
            height_m=self.height,
            known_side=self.known_side,
            relative_sigma=tolerance_m / math.sqrt(self.width * self.height),
        )

    def build(self, context: DriverContext) -> SheetDetector:
        """Return the detector."""
        return SheetDetector(context.name, self)


class SheetDetector:
    """Finds a flat rectangle, such as a sheet of paper, brighter or darker than what is behind it."""

    def __init__(self, name: str, options: SheetOptions) -> None:
        self._name = name
        self._options = options
        self._size = options.shape
        self._min_side_px = options.min_side_px
        self._colour: HsvRange | None = options.hsv

    @property
    def target_shape(self) -> SheetShape:
        """The sheet's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the outline most like the sheet, the larger the better; whole ones before those that are cut off.

        Where two outlines of different sizes are as likely, none is measured: a wrong distance is worse than none. Of
        what lies in each other the outer one is the sheet, and paper is brighter than what is around it. Where little
        speaks for the best one it is perhaps the sheet.
        """
        # Three ways, each dearer than the one before: the four sides where they are expected, a search around there,
        # and the whole picture. The first two count only without a doubt.
        check_image(frame)
        if prediction is not None and lens is not None:
            followed = follow(frame.image, prediction, self._size, self._min_side_px, lens)
            if followed is not None:
                return self._found(followed, Findings(), lens)
        search = SheetSearch(frame.image, self._size, self._min_side_px, lens, self._colour)
        near = Region.expected(prediction, frame.image, sizes=REGION_SIDES, margin_px=REGION_MARGIN_PX, outwards=True)
        if near is not None:
            findings = search.look(near, prediction)
            if findings.best is not None and findings.is_sure:
                return self._found(findings.best, findings, lens)
        findings = search.look(Region.whole(frame.image))
        if findings.rival is not None:
            return self._refused(f"ambiguous: {findings.doubt}", findings)
        if findings.best is not None and (findings.is_sure or findings.cut_off is None):
            return self._found(findings.best, findings, lens)
        return self._not_measured(findings)

    def edge_points(self, frame: Frame, found: Detection, *, lens: CameraModel | None = None) -> Points:
        """Return where steps are seen along the sides of a sheet that was found."""
        return edge_points(SheetPicture.of(frame.image, lens), found.outline_px)

    def remedies(self) -> Iterator[Remedy]:
        """Yield tolerances, the smallest first, and then papers that it may be mistaken for."""
        for share in TOLERANCE_SHARES:
            tolerance_mm = float(f"{1000 * share * math.sqrt(self._size.width_m * self._size.height_m):.1g}")
            if tolerance_mm / 1000 > (self._options.tolerance or 0.0):
                wider = self._options.model_copy(update={"tolerance": tolerance_mm / 1000})
                yield Remedy(key="tolerance", value=f"{tolerance_mm:g} mm", options=wider)
        for name in mistaken_for(self._size) if self._size.known_side == "auto" else ():
            width_m, height_m = map(parse_length, paper_sides(name))
            sides = {"size": name, "width": width_m, "height": height_m}
            yield Remedy(key="size", value=name, options=self._options.model_copy(update=sides))

    def _found(self, best: SheetCandidate, findings: Findings, lens: CameraModel | None) -> Detection:
        # Both edges of a sheet move by the bias, so it grows by twice that.
        bias_px = 0.0 if lens is None else lens.edge_bias_px
        shorter_px = min(width_and_height(best.corners_px))
        if 2 * abs(bias_px) > MAX_BIAS_SHARE * shorter_px:
            reason = f"a sheet {shorter_px:.0f} px wide; the camera's edge bias of {bias_px:.1f} px leaves too little: "
            return self._refused(f"{reason}come nearer, or calibrate the camera again", findings)
        corners = _without_bias(best, bias_px)
        remarks = ("" if lens is not None else other_paper(corners, self._size, None), _others_text(findings))
        width_px, height_px = width_and_height(corners)
        doubt = findings.doubt
        return Detection(
            target=self._name,
            status=DetectionStatus.PERHAPS if doubt else DetectionStatus.FOUND,
            reason="; ".join(filter(None, (doubt, *remarks))),
            outline_px=corners,
            centre_px=diagonals_meet(corners),
            width_px=width_px,
            height_px=height_px,
            # A side is the difference of two corners.
            size_sigma_px=math.sqrt(2) * best.corner_sigma_px,
            quality=best.quality,
            rejected=findings.rejected(),
        )

    def _refused(self, reason: str, findings: Findings) -> Detection:
        status = DetectionStatus.NOT_FOUND
        return Detection(target=self._name, status=status, reason=reason, rejected=findings.rejected())

    def _not_measured(self, findings: Findings) -> Detection:
        rejected = findings.rejected()
        cut_off = findings.cut_off
        if cut_off is not None:
            width_px, height_px = width_and_height(cut_off.corners_px)
            return Detection(
                target=self._name,
                status=DetectionStatus.TRUNCATED,
                reason=f"what may be the sheet, {width_px:.0f}x{height_px:.0f} px, is cut off by the border",
                outline_px=cut_off.corners_px,
                quality=cut_off.quality,
                rejected=rejected,
            )
        if not rejected:
            return self._refused("no contour of four corners", findings)
        likeliest = rejected[0]
        reason = f"the likeliest outline, {likeliest.size_px:.0f} px long, is refused: {likeliest.reason}"
        return self._refused(reason, findings)


def _others_text(findings: Findings) -> str:
    twin = findings.twin
    return "" if twin is None else f"several fit alike; another one is {twin.where}"


def _without_bias(best: SheetCandidate, bias_px: float) -> Points:
    """Return the corners with the camera's edge bias taken off: a bright sheet appears too large by it."""
    if not bias_px:
        return best.corners_px
    return grown(best.corners_px, -bias_px if best.is_brighter else bias_px)


# A sheet that was seen a moment ago: four short searches along where its sides are expected, and a look at its shape.
# What counts against chance in a whole picture counts little here: something with four straight sides of a sheet's
# shape, within some pixels of where the sheet was a moment ago, is the sheet. Its sides and its shape are judged in
# each frame as in the search; whatever does not pass is left to the search.


def follow(
    image: Image, expected: Prediction, size: SheetShape, min_side_px: float, lens: CameraModel
) -> SheetCandidate | None:
    """Return the sheet whose outline is expected; None where it is not found at once, or only one side is known."""
    outline_px, sigma_px = expected.outline_px, expected.sigma_px
    if outline_px is None or size.known_side != "auto" or not 0 < sigma_px < expected.size_px:
        return None
    if outline_px.shape != (4, 2) or not float(np.abs(outline_px).max()) < MAX_COORDINATE_PX:
        return None
    if touches_border(outline_px, image.shape, BORDER_PX):
        return None
    sides = refine_corners(SheetPicture.of(image, lens), outline_px, sigma_px)
    if sides is None or not _looks_whole(sides, expected, min_side_px):
        return None
    # The limit has two parts, in pixels: of the measurement, and of a sheet that is no exact rectangle.
    corner_px = sides.corner_sigma_px
    longest_px = max(side_lengths(sides.corners_px))
    limit_px = MISFIT_SIGMAS * corner_px + SLACK_SIGMAS * slack_share(size) * longest_px
    misfit_px = _misfit_px(sides.corners_px, size, lens, limit_px)
    if not misfit_px <= limit_px:
        return None
    return SheetCandidate(
        corners_px=sides.corners_px,
        corner_sigma_px=math.hypot(corner_px, MISFIT_FACTOR * misfit_px),
        is_brighter=bool(sides.contrast.sum() >= 0),
        quality=float(sides.support.mean()) * (1 - misfit_px / limit_px / 2),
    )


def _looks_whole(sides: OutlineSides, expected: Prediction, min_side_px: float) -> bool:
    """Check whether there are four straight sides that stand out all alike, about as long as expected."""
    lengths = side_lengths(sides.corners_px)
    low, high = (each * expected.size_px for each in EXPECTED_SIZES)
    if not low <= max(lengths) + 3 * expected.sigma_px or not max(lengths) - 3 * expected.sigma_px <= high:
        return False
    if min(lengths[0] + lengths[2], lengths[1] + lengths[3]) < 2 * min_side_px:
        return False
    contrasts = sides.contrast.tolist()
    stands_out = min(sides.colour_contrast.tolist()) >= MIN_CONTRAST
    is_one_kind = min(contrasts) >= 0 or max(contrasts) <= 0
    support = sides.support.tolist()
    is_seen = min(support) >= MIN_SUPPORT and sum(support) >= 4 * MIN_MEAN_SUPPORT
    is_straight = all(
        scatter <= max(MAX_BEND_PX, MAX_BEND_SHARE * length)
        for scatter, length in zip(sides.scatter_px.tolist(), lengths, strict=True)
    )
    return stands_out and is_one_kind and is_seen and is_straight


def _misfit_px(corners_px: Points, size: SheetShape, lens: CameraModel, enough_px: float) -> float:
    """Measure how far corners are from those of the sheet, hung either way; not looked further once it is enough."""
    # Root mean square of the coordinates, as in the search, but from the pose itself: for one outline that is quicker.
    seen = lens.directions(corners_px).tolist()
    focal_px = math.sqrt(lens.fx_px * lens.fy_px)
    min_px = math.inf
    for width_m, height_m in ((size.width_m, size.height_m), (size.height_m, size.width_m)):
        poses = rectangle_poses(width_m / 2, height_m / 2, seen)
        min_px = min(min_px, poses[0].misfit * focal_px) if poses else min_px
        if min_px <= enough_px:
            break
    return min_px
