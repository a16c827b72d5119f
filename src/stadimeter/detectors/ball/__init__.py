"""The ball detector: a sphere of one colour, or of any, by the cone of rays that touches it.

Blobs of the ball's colour and circles of edges say where to look (`search`). Around each, the steps from ball to
background are found along spokes, between the pixels (`limb`), and the cone of a sphere is fitted to them
(`limb`, `stadimeter.ranging.ball`). All that is seen of a limb is weighed together (`evidence`): the likeliest is the
ball, perhaps the ball, or no ball for the reason that speaks against it most. Where a ball is expected, only the
ring around its predicted limb is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from stadimeter.config.plugins import MAX_SEVERAL, Count, DriverContext, DriverOptions, numbered
from stadimeter.config.units import BallDiameter, Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball.blobs import Blob, ImageCircle, find_blobs, search_step
from stadimeter.detectors.ball.colour_proposal import propose, view
from stadimeter.detectors.ball.evidence import (
    FILLED_ENOUGH,
    LIKELY,
    SURE,
    BallScene,
    FoundBall,
    is_as_expected,
    scene_of,
)
from stadimeter.detectors.ball.search import FIRST_REACH_PX, are_same, search_at, search_blobs, search_circles
from stadimeter.detectors.hsv import HsvRange, HsvRangeText, parse_hsv_range
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView
from stadimeter.detectors.sampling import REGION_SIGMAS, Region
from stadimeter.ranging.ball import BallShape

# A search of more pixels than these looks at a quarter of them first.
COARSE_STEP = 8
COARSE_FROM_PIXELS = 10_000

# Least width of a ball in those, in cells.
COARSE_CELLS = 3

# A ball is no narrower than this share of the blob that shows it, unless that shows more than the ball.
MIN_SHARE_EXPLAINED = 0.7

# With a prediction that is less sure, the blobs near the expected place are looked at instead.
CERTAIN_PX, REACH_SIGMAS = 2.0, 2.5
MAX_RING_PX = 16.0

# What lies beside the best limb may be the ball as well if it is no smaller than this share of it, and has no less than
# this much less evidence, or is beyond doubt.
RIVAL_SIZE, RIVAL_EVIDENCE = 0.6, 1.0

# Something cut off by the border that is likely, and so many times as large, is the ball before something whole.
MUCH_LARGER = 3.0

MAX_REJECTED = 8

# Channels that differ by no more are those of a picture without colour, which compression leaves with a trace of it.
GREY_MAX = 4


class BallOptions(DriverOptions):
    """The options of a ball. With `hsv` it is found by its colour: `stadimeter colour` finds out which."""

    diameter: BallDiameter
    """The ball's diameter, such as ``"6.4 cm"``, or its name, such as ``"tennis ball"``."""
    tolerance: Tolerance | None = None
    """One standard deviation of the diameter, such as ``"1 mm"``; None if it is known well."""
    hsv: HsvRangeText | None = None
    """Its colours, lower and upper limit: ``"29,86,6:64,255,255"``; None if any round outline may be the ball."""
    min_radius_px: Annotated[float, Field(ge=3)] = 5.0
    """Balls that look smaller than this are not accepted."""
    max_radius_px: Annotated[float, Field(gt=3)] | None = None
    """Balls that look larger than this are not accepted; None for no limit."""
    count: Count | None = None
    """How many there are at most, each a target of its own; None for one."""

    @model_validator(mode="after")
    def _several_have_a_colour(self) -> Self:
        if self.count is not None and self.hsv is None:
            raise ValueError("several balls are known by their colour from other round things: add hsv beside count")
        return self

    @property
    def members(self) -> tuple[str, ...]:
        """The numbers from 1 to `count`."""
        return numbered(self.count)

    def build(self, context: DriverContext) -> BallDetector:
        """Return the detector."""
        if self.count is None:
            return BallDetector(context.name, self)
        return SeveralBalls(context.name, self)

    @staticmethod
    def propose_colour(samples: Sequence[ColourSample]) -> ColourProposal | None:
        """Return a range for all the pictures; None if nothing stands out."""
        return propose(samples, _detect_colour)

    @staticmethod
    def view_colour(frame: Frame, colour: str) -> ColourView:
        """Return the view that a range gives of a frame; raises ValueError if it is none."""
        return view(frame, parse_hsv_range(colour), _detect_colour)


class BallDetector:
    """Finds a sphere of one colour, whole or partly hidden.

    Args:
        around_px: For a quick trial of a range of colours: look only at blobs that reach to this place (x, y), and
            only with this range. None to look everywhere, and with more or less of the range as well.
    """

    def __init__(self, name: str, options: BallOptions, *, around_px: tuple[float, float] | None = None) -> None:
        self._name = name
        self._around_px = around_px
        self._size = BallShape(
            diameter_m=options.diameter, relative_sigma=(options.tolerance or 0.0) / options.diameter
        )
        self._colour = options.hsv
        self._radii_px = (options.min_radius_px, options.max_radius_px or math.inf)
        self._step = search_step(options.min_radius_px)

    def edge_points(self, frame: Frame, found: Detection, *, lens: CameraModel | None = None) -> Points:  # noqa: ARG002
        """Return the edges along the limb of a ball that was found: its outline."""
        return found.outline_px

    @property
    def target_shape(self) -> BallShape:
        """The ball's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the ball: the roundest blob of its colour.

        Away from the optical axis a ball looks like an ellipse that points to the middle of the picture; width and
        height are both its smaller diameter, across that direction, which is the one that says how deep the ball lies.
        """
        scene = self._scene_of(frame, lens)
        if prediction is not None:
            # Tracking: only the ring around the predicted limb is read, so its cost does not grow with the picture: 21
            # to 38 times as fast as the tutorial, the whole search 11 to 14 times (docs/benchmarks/report.md).
            expected = self._find_expected(scene, prediction)
            if expected is not None:
                return self._report_found(scene, expected)
            # What was refused near a prediction says nothing of the rest of the picture.
            scene.seen.clear()
        if (colour := self._colour) is None:
            search_circles(scene)
            return self._report(scene, "no circle of edges")
        if self._around_px is None and self._has_large(scene, colour):
            return self._report(scene, "")
        self._search_colour(scene, colour)
        is_grey = not scene.ranked and np.ptp(scene.image[::16, ::16], axis=2).max() <= GREY_MAX
        grey = "the picture is grey, as a camera's are at night, so " if is_grey else ""
        return self._report(scene, f"{grey}no pixel has the ball's colour {colour}")

    def _search_colour(self, scene: BallScene, colour: HsvRange) -> None:
        """Search blobs of the ball's colour, and unless one is the ball, circles of edges."""
        blobs = self._list_blobs(scene, colour) or self._list_blobs(scene, colour.in_other_light)
        if (place_px := self._around_px) is not None:
            search_blobs(scene, [blob for blob in blobs if _reaches(blob, place_px)])
            return
        search_blobs(scene, blobs)
        if blobs and not scene.is_settled():
            # Beside a likely ball, another one is no larger than what has its colour.
            search_circles(scene, blobs[0].size_px if scene.is_likely else math.inf)

    def _scene_of(self, frame: Frame, lens: CameraModel | None) -> BallScene:
        # An arc of a circle that is wider than the picture is hardly told from a line.
        least_px, most_px = self._radii_px
        return scene_of(frame, lens, self._colour, (least_px, min(most_px, max(frame.image.shape[:2]))))

    def _list_blobs(self, scene: BallScene, colour: HsvRange, region: Region | None = None) -> list[Blob]:
        return find_blobs(scene.image, colour, self._step, region)

    def _has_large(self, scene: BallScene, own: HsvRange) -> bool:
        """Check whether there is a large ball beyond doubt, found in few pixels."""
        height, width = scene.image.shape[:2]
        if width * height <= COARSE_FROM_PIXELS * self._step**2 or self._step >= COARSE_STEP:
            return False
        # Every eighth pixel instead of every fourth: a quarter of the reading. What is found is measured in all pixels
        # all the same, so only a ball of few cells would be less sure, and that goes to the full search.
        blobs = find_blobs(scene.image, own, COARSE_STEP)
        if not blobs or blobs[0].size_px < COARSE_CELLS * COARSE_STEP or blobs[0].fill < FILLED_ENOUGH:
            return False
        search_blobs(scene, blobs[:1])
        if scene.is_settled(MIN_SHARE_EXPLAINED * blobs[0].circle.radius_px):
            return True
        scene.seen.clear()
        return False

    def _find_expected(self, scene: BallScene, prediction: Prediction) -> FoundBall | None:
        """Look where the ball is expected: at the ring around its limb, or else at the blobs around it."""
        (x_px, y_px), radius_px = prediction.centre_px, prediction.size_px / 2
        if not all(map(math.isfinite, (x_px, y_px, radius_px, prediction.sigma_px))):
            return None
        # The ring: its width follows from the prediction's standard deviation, beyond the 2 px that a still target has
        # anyway. A ring of more than 16 px either side holds edges of other things.
        start = ImageCircle(x_px=x_px, y_px=y_px, radius_px=max(radius_px, self._radii_px[0]))
        scene = scene._replace(expected=start)
        reach_px = FIRST_REACH_PX + REACH_SIGMAS * max(0.0, prediction.sigma_px - CERTAIN_PX)
        if reach_px <= MAX_RING_PX:
            in_ring = search_at(scene, start, reach_px)
            if in_ring is not None and in_ring.evidence >= LIKELY and is_as_expected(in_ring, prediction):
                return in_ring
        # Half the side of the square that is searched, in pixels: the ball, half as much again for blobs that reach
        # beyond it, and four standard deviations of the place.
        half_px = 1.5 * start.radius_px + REGION_SIGMAS * prediction.sigma_px + FIRST_REACH_PX
        region = Region.around((x_px, y_px), half_px, scene.image)
        if region is None or self._colour is None:
            return None
        search_blobs(scene, self._list_blobs(scene, self._colour, region))
        ball = scene.best
        is_it = ball is not None and ball.evidence >= LIKELY and is_as_expected(ball, prediction)
        return ball if is_it else None

    def _report(self, scene: BallScene, nothing: str) -> Detection:
        """Return the best of what was seen: the ball, perhaps the ball, or why there is none."""
        ranked = scene.ranked
        if not ranked:
            return self._refuse(nothing, scene)
        best = next((each for each in ranked if each.is_possible), ranked[0])
        nearer = next((each for each in ranked if each.is_possible and _is_nearer(each, best)), None)
        if nearer is not None:
            return self._report_found(scene, nearer)
        size_px = 2 * best.limb.circle.radius_px
        if not best.is_possible:
            return self._refuse(f"outline of {size_px:.0f} px {best.rejected.reason}", scene)
        rivals = [each for each in ranked if _is_rival(best, each)]
        if rivals and (self._colour is None or best.evidence < LIKELY):
            places = " and ".join(
                f"{x:.0f},{y:.0f}" for x, y in (each.rejected.centre_px for each in (best, rivals[0]))
            )
            return self._refuse(f"what is round at {places} is as much like a ball; give its colours, hsv", scene)
        return self._report_found(scene, best)

    def _refuse(self, reason: str, scene: BallScene) -> Detection:
        rejected = tuple(each.rejected for each in scene.ranked[:MAX_REJECTED])
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected)

    def _report_found(self, scene: BallScene, ball: FoundBall) -> Detection:
        circle = ball.limb.circle
        # The apparent size is the ellipse's smaller axis with the lens's distortion undone: that axis alone gives the
        # depth, at any place in the picture (see `stadimeter.ranging.ball`). Diameter and its standard deviation are
        # both twice those of the radius.
        diameter_px = 2 * ball.limb.straight_radius_px
        status, reason = DetectionStatus.FOUND, ""
        if ball.is_cut_off:
            status, reason = DetectionStatus.TRUNCATED, f"the ball, {diameter_px:.0f} px, is cut off by the border"
        elif ball.evidence < LIKELY:
            status, reason = DetectionStatus.PERHAPS, f"perhaps another thing: it {ball.fault}"
        return Detection(
            target=self._name,
            status=status,
            reason=reason,
            outline_px=ball.limb.points_px,
            centre_px=(circle.x_px, circle.y_px),
            width_px=diameter_px,
            height_px=diameter_px,
            size_sigma_px=2 * ball.limb.radius_sigma_px,
            quality=ball.quality,
            rejected=tuple(each.rejected for each in scene.ranked[:MAX_REJECTED] if each is not ball),
            measured_with=scene.lens if scene.is_lens_known else None,
        )


def _is_nearer(other: FoundBall, best: FoundBall) -> bool:
    """Check whether something round that the border cuts off may be the ball, so that a speck is not its distance."""
    is_larger = other.limb.circle.radius_px > MUCH_LARGER * best.limb.circle.radius_px
    return is_larger and other.is_cut_off


def _is_rival(best: FoundBall, other: FoundBall) -> bool:
    """Check whether something that lies beside the best limb, and not on it or around it, is as much like a ball."""
    first, second = best.limb.circle, other.limb.circle
    apart_px = math.hypot(first.x_px - second.x_px, first.y_px - second.y_px)
    is_apart = apart_px > max(first.radius_px, second.radius_px) and second.radius_px > RIVAL_SIZE * first.radius_px
    return is_apart and other.evidence > min(best.evidence, SURE) - RIVAL_EVIDENCE


def _reaches(blob: Blob, place_px: tuple[float, float]) -> bool:
    """Check whether the circle around a blob reaches to a place."""
    return math.dist((blob.circle.x_px, blob.circle.y_px), place_px) <= blob.circle.radius_px + blob.step


def _detect_colour(frame: Frame, colour: HsvRange, around_px: tuple[float, float] | None = None) -> Detection:
    options = BallOptions.model_validate({"diameter": "1 m", "hsv": colour})  # the size changes nothing in a picture
    return BallDetector("ball", options, around_px=around_px).detect(frame)


# Several balls of one colour: all of them in one search, and each where it is expected ----------------------


class SeveralBalls(BallDetector):
    """Finds every sphere of one colour, as many as there are."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """None: balls are all alike."""
        return ()

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:
        """Look for every ball of the colour."""
        scene = self._scene_of(frame, lens)
        balls = [] if self._colour is None else self._find_all(scene, self._colour)
        scene.seen.clear()  # what is left over between balls is not worth a word
        return tuple(self._report_found(scene, ball) for ball in balls) or (self.detect(frame, lens=lens),)

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: CameraModel | None = None) -> Detection:
        """Look for a ball where it is expected, and nowhere else."""
        scene = self._scene_of(frame, lens)
        found = self._find_expected(scene, prediction)
        return self._refuse("not where it was expected", scene) if found is None else self._report_found(scene, found)

    def _find_all(self, scene: BallScene, colour: HsvRange) -> list[FoundBall]:
        """Return every ball of the colour: one in each blob, those in what these leave of the blobs, and other circles.

        Balls that touch are one blob. So what was found is taken out of the mask, until nothing more is found.
        """
        balls: list[FoundBall] = []
        while len(balls) < MAX_SEVERAL:
            known = [each.limb.circle for each in balls]
            for blob in find_blobs(scene.image, colour, self._step, without=known, most=MAX_SEVERAL):
                here = scene._replace(seen=[])
                search_blobs(here, [blob])
                _add(balls, here)
            if len(balls) == len(known):
                break
        around = scene._replace(seen=[])
        search_circles(around)
        _add(balls, around)
        return balls[:MAX_SEVERAL]


def _add(balls: list[FoundBall], scene: BallScene) -> None:
    """Add the likely balls of a search that are not known yet, the best first."""
    for ball in scene.ranked:
        circle = ball.limb.circle
        if ball.evidence >= LIKELY and not any(are_same(circle, each.limb.circle) for each in balls):
            balls.append(ball)
