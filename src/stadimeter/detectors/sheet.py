"""The sheet detector: the largest plausible outline of four corners in a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import Length
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.target import KnownSide, SheetSize
from stadimeter.detectors.border import side_on_border, touches_border
from stadimeter.detectors.quad_edges import QuadEdges, measure_edges
from stadimeter.detectors.quad_shape import (
    corner_angles_rad,
    diagonals_meet,
    is_convex,
    polygon_area,
    side_lengths,
    width_and_height,
)
from stadimeter.detectors.quadrilaterals import find_quadrilaterals
from stadimeter.detectors.sampling import reduced, to_full_scale

SEARCH_LONG_SIDE_PX = 800
"""Candidates are looked for in a picture of this size; their sides are measured in the full one."""

MOST_OUTLINES = 150
"""How many outlines are looked at: the largest. A picture full of clutter has thousands."""

MOST_MEASURED = 24
"""How many candidates of a sheet's shape have their sides measured: the largest."""

GREATEST_TILT_RAD = math.radians(60)
"""A sheet turned away further is not accepted: a side would be seen at less than half its length."""

GREATEST_SIDE_RATIO = 2.5
"""Opposite sides may differ this much: a sheet tilted by 60 degrees as far away as it is wide (1.43 to 0.57)."""

SMALLEST_ANGLE_RAD = math.radians(35)
"""The sharpest corner: perspective makes a right angle sharper, but not a spike."""

HOPELESS = 1.1
"""Outlines come largest first; once the best one's score is above this share of the next one's size, none can win."""

LEAST_CONTRAST = 8.0
"""How much each side must stand out from what is behind it, in levels of 8 bits."""

LEAST_SUPPORT = 0.6
"""The share of each side that must be seen as a straight edge; fingers or a curl may hide the rest."""

LEAST_QUALITY = 0.25
"""The least quality: a whole sheet, face on, must stand out from the darkest part behind it 1/16 as much as from the
brightest; one that is turned by 50 degrees 1/7 as much."""

GREATEST_BEND_PX = 0.6
GREATEST_BEND_SHARE = 0.015
"""How far the edge may scatter about a straight line: curled paper stays below 1.5 % of a side, a ball does not."""

SIGMA_FLOOR_PX = 0.2
SIGMA_FACTOR = 8.0
"""The standard deviation of where a line lies is ``hypot(8 s / sqrt(n), 0.2)`` pixels, for n steps that scatter by s.

Steps beside each other err together, so the plain ``s / sqrt(n)`` is far too small: on rendered tags it covered 6 % of
the errors where 95 % were promised, eight times as much covered 97 %. The floor is for the camera's tone curve and
for blur, which move an edge by some tenths of a pixel.
"""


class SheetOptions(Options):
    """What a ``[targets.…]`` table with ``driver = "sheet"`` may hold.

    Attributes:
        width: The sheet's horizontal side as it hangs, such as ``"11 in"``.
        height: Its vertical side as it hangs.
        known_side: Which side the distance is computed from: ``auto``, ``width`` or ``height``.
        min_side_px: Sheets whose shorter side is smaller than this in the picture are not accepted.
    """

    width: Length
    height: Length
    known_side: KnownSide = "auto"
    min_side_px: Annotated[float, Field(ge=8)] = 20.0


@dataclass(frozen=True, slots=True)
class _Candidate:
    """An outline that looks like a sheet."""

    edges: QuadEdges
    quality: float
    truncated: bool

    @property
    def score(self) -> float:
        """The larger and the more like a sheet, the better."""
        return self.quality * math.sqrt(polygon_area(self.edges.corners_px))

    @property
    def rank(self) -> tuple[bool, float]:
        """What a better candidate has more of: a whole one comes before any that the border cuts off."""
        return not self.truncated, self.score


class SheetDetector:
    """Finds a flat rectangle, such as a sheet of paper, on a background that differs from it on all four sides.

    Args:
        name: The target's name.
        options: Its size and limits.
    """

    def __init__(self, name: str, options: SheetOptions) -> None:
        self._name = name
        self._size = SheetSize(width_m=options.width, height_m=options.height, known_side=options.known_side)
        self._min_side_px = options.min_side_px
        longer, shorter = max(options.width, options.height), min(options.width, options.height)
        self._aspect = longer / shorter

    @property
    def target_size(self) -> SheetSize:
        """The sheet's size."""
        return self._size

    def detect(self, frame: Frame, prediction: Prediction | None = None) -> Detection:  # noqa: ARG002 - not needed
        """Look for the sheet.

        Args:
            frame: The frame; its image is not changed.
            prediction: Not used: the whole frame is searched.

        Returns:
            The outline that looks most like the sheet, the larger the better; whole ones before those that the border
            cuts off.
        """
        small, scale = reduced(frame.image, SEARCH_LONG_SIDE_PX)
        least_px = max(self._min_side_px * scale / 2, 6.0)
        found = [to_full_scale(each, scale) for each in find_quadrilaterals(small, least_px, MOST_OUTLINES)]
        outlines = [each for each in found if sum(_on_border(each, frame.image, scale)) <= 2]
        if not outlines:
            return self._not_found("no contour of four corners")
        shaped = [each for each in outlines if not self._shape_trouble(each)]
        if not shaped:
            return self._not_found(self._shape_trouble(outlines[0]))
        reasons: list[str] = []
        best: _Candidate | None = None
        for corners in shaped[:MOST_MEASURED]:
            if best is not None and not best.truncated and best.score > HOPELESS * math.sqrt(polygon_area(corners)):
                break
            judged = self._judge(frame.image, corners, scale)
            if isinstance(judged, str):
                reasons.append(judged)
            elif best is None or judged.rank > best.rank:
                best = judged
        return self._not_found(reasons[0]) if best is None else self._found(best)

    def _judge(self, image: Image, corners: Points, scale: float) -> _Candidate | str:
        """Return the candidate with its sides measured, or why it is no sheet."""
        on_border = _on_border(corners, image, scale)
        described = f"largest four-cornered contour, {_size_text(corners)},"
        edges = measure_edges(image, corners, 3.0 + 2.0 / scale, on_border)
        if edges is None:
            return f"{described} has no straight sides"
        trouble = self._shape_trouble(edges.corners_px) or _side_trouble(edges, on_border, described)
        if trouble:
            return trouble
        quality = self._quality(edges)
        if quality < LEAST_QUALITY:
            return f"{described} looks little like the sheet: quality {quality:.2f}, limit {LEAST_QUALITY:.2f}"
        height, width = image.shape[:2]
        truncated = any(on_border) or touches_border(edges.corners_px, width, height, _margin_px(scale))
        return _Candidate(edges, quality, truncated)

    def _found(self, best: _Candidate) -> Detection:
        corners = best.edges.corners_px
        width_px, height_px = width_and_height(corners)
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if best.truncated else DetectionStatus.FOUND,
            reason=f"the sheet, {_size_text(corners)}, is cut off by the border" if best.truncated else "",
            outline_px=corners,
            centre_px=diagonals_meet(corners),
            width_px=width_px,
            height_px=height_px,
            size_sigma_px=_size_sigma_px(best.edges),
            quality=best.quality,
        )

    def _shape_trouble(self, corners: Points) -> str:
        """Say why an outline cannot be the sheet, whatever its sides look like; an empty string if it can."""
        sides = side_lengths(corners)
        means = sorted(width_and_height(corners))
        described = f"largest four-cornered contour, {_size_text(corners)},"
        if means[0] < self._min_side_px:
            return f"largest four-cornered contour is {means[0]:.0f} px wide, limit {self._min_side_px:.0f} px"
        if not is_convex(corners):
            return f"{described} is not convex"
        ratio = max(max(sides[i], sides[i + 2]) / max(min(sides[i], sides[i + 2]), 1e-9) for i in (0, 1))
        if ratio > GREATEST_SIDE_RATIO:
            return f"{described} has opposite sides of {ratio:.1f} to 1, limit {GREATEST_SIDE_RATIO:.1f} to 1"
        sharpest = min(corner_angles_rad(corners))
        if sharpest < SMALLEST_ANGLE_RAD:
            limit = math.degrees(SMALLEST_ANGLE_RAD)
            return f"{described} has a corner of {math.degrees(sharpest):.0f} degrees, limit {limit:.0f}"
        aspect, limit = means[1] / means[0], self._aspect / math.cos(GREATEST_TILT_RAD)
        if aspect > limit:
            return f"{described} is too long for the sheet: {aspect:.1f} to 1, limit {limit:.1f} to 1"
        return ""

    def _quality(self, edges: QuadEdges) -> float:
        """Return how much it looks like the sheet: seen whole, standing out evenly, and facing the camera."""
        shorter, longer = sorted(width_and_height(edges.corners_px))
        turned = min(longer / shorter, self._aspect) / max(longer / shorter, self._aspect)
        contrast = np.abs(edges.contrast[edges.steps > 0])
        return float(edges.support.min()) * turned * math.sqrt(float(contrast.min() / contrast.max()))

    def _not_found(self, reason: str) -> Detection:
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason)


def _margin_px(scale: float) -> float:
    """Return how near to the border a candidate cannot be told from one that is cut off."""
    return 1.0 + 1.0 / scale


def _on_border(corners: Points, image: Image, scale: float) -> tuple[bool, ...]:
    """Say for each side whether it runs along the border of the picture; with more than two, it is the picture."""
    height, width = image.shape[:2]
    return tuple(
        side_on_border(corners[side], corners[(side + 1) % 4], width, height, _margin_px(scale)) for side in range(4)
    )


def _side_trouble(edges: QuadEdges, on_border: tuple[bool, ...], described: str) -> str:
    """Say why the sides are not those of a sheet; an empty string if they are."""
    seen = ~np.array(on_border)
    contrast = edges.contrast[seen]
    polarity = 1.0 if float(np.median(contrast)) >= 0 else -1.0
    limit = max(LEAST_CONTRAST, edges.noise)
    standing_out = int((polarity * contrast >= limit).sum())
    if standing_out < len(contrast):
        return (
            f"{described} stands out on {standing_out} of its {len(contrast)} sides "
            f"(weakest {float((polarity * contrast).min()):.0f} levels, limit {limit:.0f})"
        )
    weakest = float(edges.support[seen].min())
    if weakest < LEAST_SUPPORT:
        return f"{described} has a side of which {weakest:.0%} is straight, limit {LEAST_SUPPORT:.0%}"
    bend = max(
        scatter_px / max(GREATEST_BEND_PX, GREATEST_BEND_SHARE * length_px)
        for scatter_px, length_px in zip(edges.scatter_px, side_lengths(edges.corners_px), strict=True)
    )
    return f"{described} has bent sides: {bend:.1f} times the limit" if bend > 1 else ""


def _size_text(corners: Points) -> str:
    width_px, height_px = width_and_height(corners)
    return f"{width_px:.0f}x{height_px:.0f} px"


def _size_sigma_px(edges: QuadEdges) -> float:
    """Return the standard deviation of a side's length: it lies between two lines, each of which may be off."""
    of_lines = np.hypot(SIGMA_FACTOR * edges.scatter_px / np.sqrt(np.maximum(edges.steps, 1)), SIGMA_FLOOR_PX)
    return float(max(np.hypot(of_lines[0], of_lines[2]), np.hypot(of_lines[1], of_lines[3])))


def _build(options: SheetOptions, context: DriverContext) -> SheetDetector:
    return SheetDetector(context.name, options)


PLUGIN = Plugin(SheetOptions, _build)
