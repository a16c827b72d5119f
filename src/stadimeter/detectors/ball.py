"""The ball detector: the roundest blob of a colour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import Length
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.target import BallSize
from stadimeter.detectors.border import touches_border
from stadimeter.detectors.circle_fit import RoundOutline
from stadimeter.detectors.hsv_range import HsvRangeText
from stadimeter.detectors.limb import Limb, find_limb

Mask = NDArray[np.uint8]

SEARCH_LONG_SIDE_PX = 640
"""Blobs are looked for in every k-th pixel of a larger picture; the limb is measured in all pixels."""

SMALLEST_SEARCHED_RADIUS_PX = 3.0
"""Pixels are left out only as long as the smallest accepted ball still has this radius in what remains."""

MOST_BLOBS = 8
"""How many blobs are measured: the largest."""

MOST_POINTS = 60
"""How many points of an outline are used: evenly spaced ones of a longer outline."""

LEAST_COVERAGE = 0.45
"""How much of the circumference must be seen; with less, clutter has as many circles as balls."""

LEAST_FILL = 0.3
"""How much of the circle must have the ball's colour."""

ROUGH_SHARE = 0.04
"""A limb that scatters by this share of the radius counts half: felt and fingers do so less, polygons more."""

MARGIN_PX = 1.0
"""A limb this near to the outermost pixels is cut off."""

SIGMA_FACTOR = 7.25
SIGMA_FLOOR_PX = 0.3
SIGMA_SMALL_PX2 = 1.18
"""The standard deviation of the radius r is ``hypot(7.25 s / sqrt(n), 0.3, 1.18 / r)`` pixels, for n points that
scatter by s. Points beside each other err together; on rendered balls the plain ``s / sqrt(n)`` covered 3 to 25 % of
the errors where 95 % were promised, these factors 94 %. The floor is for blur and felt, which move the whole limb."""


class BallOptions(Options):
    """What a ``[targets.…]`` table with ``driver = "ball"`` may hold.

    Attributes:
        diameter: The ball's diameter, such as ``"6.4 cm"``.
        hsv: Its colours, lower and upper limit: ``"29,86,6:64,255,255"``.
        min_radius_px: Balls that look smaller than this are not accepted.
        max_radius_px: Balls that look larger than this are not accepted; None for no limit.
    """

    diameter: Length
    hsv: HsvRangeText
    min_radius_px: Annotated[float, Field(ge=3)] = 6.0
    max_radius_px: Annotated[float, Field(gt=3)] | None = None


@dataclass(frozen=True, slots=True)
class _Blob:
    """Pixels of the ball's colour that hang together.

    Attributes:
        outline_px: Points along its outline, shape ``(n, 2)``.
        area_px2: Its area.
    """

    outline_px: Points
    area_px2: float

    @property
    def size_px(self) -> float:
        """The larger of its width and its height."""
        return float(np.ptp(self.outline_px, axis=0).max()) + 1.0

    @property
    def thinned_px(self) -> Points:
        """No more than `MOST_POINTS` points of its outline, evenly spaced."""
        return self.outline_px[:: max(1, math.ceil(len(self.outline_px) / MOST_POINTS))]


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A blob that looks like a ball."""

    limb: Limb
    quality: float

    @property
    def score(self) -> float:
        """The rounder the better; of equally round ones the larger, since noise makes small ones."""
        return self.quality * math.sqrt(self.limb.outline.circle.radius_px)


class BallDetector:
    """Finds a sphere of one colour, whole or partly hidden.

    Args:
        name: The target's name.
        options: Its size, colour and limits.
    """

    def __init__(self, name: str, options: BallOptions) -> None:
        self._name = name
        self._size = BallSize(diameter_m=options.diameter)
        self._colour = options.hsv
        self._min_radius_px = options.min_radius_px
        self._max_radius_px = options.max_radius_px or math.inf

    @property
    def target_size(self) -> BallSize:
        """The ball's size."""
        return self._size

    def detect(self, frame: Frame, prediction: Prediction | None = None) -> Detection:  # noqa: ARG002 - not needed
        """Look for the ball.

        Args:
            frame: The frame; its image is not changed.
            prediction: Not used: the whole frame is searched.

        Returns:
            The roundest blob of the ball's colour. Away from the optical axis a ball looks like an ellipse that
            points to the middle of the picture; width and height are both its smaller diameter, across that
            direction, which is the one that says how deep the ball lies.
        """
        blobs = self._blobs(frame.image)
        limit_px = 2 * self._min_radius_px
        if not blobs:
            return self._not_found(f"no pixel has the ball's colour {self._colour}")
        if blobs[0].size_px < limit_px:
            return self._not_found(f"largest blob {blobs[0].size_px:.0f} px, limit {limit_px:.0f} px")
        judged = [self._judge(frame.image, blob) for blob in blobs if blob.size_px >= limit_px]
        candidates = [each for each in judged if isinstance(each, _Candidate)]
        if not candidates:
            return self._not_found(next(each for each in judged if isinstance(each, str)))
        return self._found(max(candidates, key=lambda each: each.score), frame)

    def _blobs(self, image: Image) -> list[_Blob]:
        """Return the largest blobs of the ball's colour, the largest first."""
        step = _search_step(image, self._min_radius_px)
        smooth = cv2.GaussianBlur(np.ascontiguousarray(image[::step, ::step]), (5, 5), 0)
        mask = cv2.morphologyEx(
            self._colour.mask(np.asarray(smooth, np.uint8)), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)
        )
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        blobs = [
            _Blob(np.asarray(contour, np.float64).reshape(-1, 2) * step, float(cv2.contourArea(contour)) * step**2)
            for contour in contours
        ]
        blobs.sort(key=lambda blob: (-blob.size_px, blob.outline_px[0, 0], blob.outline_px[0, 1]))
        return blobs[:MOST_BLOBS]

    def _judge(self, image: Image, blob: _Blob) -> _Candidate | str:
        """Return the blob as a ball with its limb measured, or why it is none."""
        described = f"largest blob {blob.size_px:.0f} px"
        limb = find_limb(image, blob.thinned_px, blob.area_px2)
        if limb is None or limb.outline.coverage < LEAST_COVERAGE:
            seen = limb.outline.coverage if limb else 0.0
            return f"{described} is not round: {seen:.0%} of a circle, limit {LEAST_COVERAGE:.0%}"
        radius_px = limb.outline.circle.radius_px
        if not self._min_radius_px <= radius_px <= self._max_radius_px:
            return f"{described} lies in a circle of {2 * radius_px:.0f} px, limit {self._limits_text()}"
        fill = min(1.0, blob.area_px2 / (math.pi * radius_px**2))
        if fill < LEAST_FILL:
            return f"{described} fills {fill:.0%} of its circle, limit {LEAST_FILL:.0%}"
        return _Candidate(limb, limb.outline.coverage * math.sqrt(fill) * _smoothness(limb.outline))

    def _limits_text(self) -> str:
        most = "" if math.isinf(self._max_radius_px) else f" to {2 * self._max_radius_px:.0f}"
        return f"{2 * self._min_radius_px:.0f}{most} px"

    def _found(self, best: _Candidate, frame: Frame) -> Detection:
        circle = best.limb.outline.circle
        centre = np.array([circle.x_px, circle.y_px])
        extremes = np.array([centre - circle.radius_px, centre + circle.radius_px])
        truncated = touches_border(extremes, frame.width_px, frame.height_px, MARGIN_PX)
        off_axis = (circle.x_px - (frame.width_px - 1) / 2, circle.y_px - (frame.height_px - 1) / 2)
        diameter_px = best.limb.outline.diameter_across_px(off_axis)
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if truncated else DetectionStatus.FOUND,
            reason=f"the ball, {diameter_px:.0f} px, is cut off by the border" if truncated else "",
            outline_px=best.limb.points_px,
            centre_px=(circle.x_px, circle.y_px),
            width_px=diameter_px,
            height_px=diameter_px,
            size_sigma_px=_size_sigma_px(best.limb.outline),
            quality=best.quality,
        )

    def _not_found(self, reason: str) -> Detection:
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason)


def _search_step(image: Image, min_radius_px: float) -> int:
    """Return the k of "every k-th pixel"."""
    for_speed = math.ceil(max(image.shape[:2]) / SEARCH_LONG_SIDE_PX)
    for_small_balls = int(min_radius_px / SMALLEST_SEARCHED_RADIUS_PX)
    return int(max(1, min(for_speed, for_small_balls)))


def _smoothness(outline: RoundOutline) -> float:
    """Return 1 for a limb without scatter, 0.5 for one that scatters by `ROUGH_SHARE` of the radius."""
    return 1 / (1 + (outline.scatter_px / (ROUGH_SHARE * outline.circle.radius_px)) ** 2)


def _size_sigma_px(outline: RoundOutline) -> float:
    """Return the standard deviation of the diameter."""
    points = max(1, int(outline.on_outline.sum()))
    along_limb_px = SIGMA_FACTOR * outline.scatter_px / math.sqrt(points)
    return 2 * math.hypot(along_limb_px, SIGMA_FLOOR_PX, SIGMA_SMALL_PX2 / outline.circle.radius_px)


def _build(options: BallOptions, context: DriverContext) -> BallDetector:
    return BallDetector(context.name, options)


PLUGIN = Plugin(BallOptions, _build)
