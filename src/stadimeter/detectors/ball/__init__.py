"""The ball detector: a sphere of one colour, by the cone of rays that touches it.

Blobs of the ball's colour say where to look (`blobs`). Around each, the steps from ball to background are found along
spokes, between the pixels (`limb_edges`), and the cone of a sphere is fitted to them (`limb`,
`stadimeter.ranging.ball`). Where a blob is not round, since part of the ball is in the shade or hidden, the
circle of edges around it is the start (`find_edge_circle`); where other things of its colour touch the ball, the
largest circle within. What does not look like a ball then is refused, with the test that it failed (`BallGates`). Where
a ball is expected, only the ring around its predicted limb is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Self

from msgspec.structs import replace
from pydantic import Field, model_validator

from stadimeter.config.named_sizes import BallDiameter
from stadimeter.config.plugins import Count, DriverContext, DriverOptions, numbered
from stadimeter.config.units import Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball.any_colour import pick_circles
from stadimeter.detectors.ball.blobs import Blob, find_blobs, join_patches, search_step, thin_out
from stadimeter.detectors.ball.choice import BestBall, RangeSearch, best_and_rival, explains, is_found_again, look_again
from stadimeter.detectors.ball.circles import ImageCircle, find_edge_circle
from stadimeter.detectors.ball.colour_proposal import propose, view
from stadimeter.detectors.ball.gates import (
    MIN_FILL,
    BallGates,
    BallScene,
    FoundBall,
    is_as_expected,
    list_most_alike,
    refuse_too_little_colour,
    refuse_without_limb,
    scene_of,
)
from stadimeter.detectors.ball.limb import Limb, find_limb, within
from stadimeter.detectors.ball.setup import ball_kinds
from stadimeter.detectors.hsv import HsvRange, HsvRangeText, other_ranges, parse_hsv_range
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView, Exercise
from stadimeter.detectors.sampling import REGION_SIGMAS, Region
from stadimeter.ranging.ball import BallShape

# Reach of the search for the limb on either side of a blob's circle: pixels, or cells and a half of the search.
FIRST_REACH_PX, REACH_OF_STEP = 8.0, 1.5

# A search of more pixels than these looks at a quarter of them first.
COARSE_STEP = 8
COARSE_FROM_PIXELS = 10_000

# Least width of a ball in those, in cells.
COARSE_CELLS = 3

# With a prediction that is less sure, the blobs near the expected place are looked at instead.
CERTAIN_PX, REACH_SIGMAS = 2.0, 2.5
MAX_RING_PX = 16.0

# Greatest radius of a ball that the search within and around a blob finds, in half sizes of the blob.
WITHIN_REACH, AROUND_REACH = 1.2, 2.0

# Number of blobs tried of another range than the ball's own, and least quality there: chance has had its turn.
MAX_OTHER_BLOBS, QUALITY_OF_OTHERS = 4, 0.2

# The largest circle within a blob says no more than the one around it unless it is narrower by this factor.
NARROWER = 0.85

# No circle of edges is looked for around a blob that covers a smaller share of its own circle: it is the grain of wood,
# a joint or a rim. Of 635 balls with markings, on textured floors and in hands none showed so little.
MIN_FILL_AROUND = 0.2

# Number of blobs around which the circle of edges is looked for, which is slow.
MAX_SEARCHED_AROUND = 3


class BallOptions(DriverOptions):
    """What a ``[targets.…]`` table with ``driver = "ball"`` may hold."""

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

    setup_kinds = staticmethod(ball_kinds)

    def build(self, context: DriverContext) -> BallDetector:
        """Return the detector."""
        if self.count is None:
            return BallDetector(context.name, self)
        from stadimeter.detectors.ball.several import SeveralBalls  # noqa: PLC0415 - most look for one ball

        return SeveralBalls(context.name, self)

    @staticmethod
    def exercise() -> Exercise:
        """Return the green ball of the simulated room."""
        return Exercise(options={"diameter": "20 cm", "hsv": "29,86,6:64,255,255"})

    @staticmethod
    def propose_colour(samples: Sequence[ColourSample]) -> ColourProposal | None:
        """Return a range for all the pictures; None if nothing stands out."""
        return propose(samples, _detect_colour)

    @staticmethod
    def view_colour(frame: Frame, colour: str) -> ColourView:
        """Return what a range shows in a frame; raises ValueError if it is none."""
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
        self._gates = BallGates(
            colour=options.hsv,
            min_radius_px=options.min_radius_px,
            max_radius_px=options.max_radius_px or math.inf,
        )
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
        scene = scene_of(frame, lens, self._gates)
        if prediction is not None:
            # Tracking: only the ring around the predicted limb is read, so its cost does not grow with the picture: 21
            # to 38 times as fast as the tutorial, the whole search 11 to 14 times (docs/benchmarks/report.md).
            expected = self._find_expected(scene, prediction)
            if expected is not None:
                return self._report_found(scene, expected)
            # What was refused near a prediction says nothing of the rest of the picture.
            scene.refusals.clear()
        if (colour := self._colour) is None:
            return self._find_any_colour(scene)
        if self._around_px is None and (large := self._find_large(scene, colour)) is not None:
            return self._report_found(scene, large)
        blobs = find_blobs(frame.image, colour, self._step)
        if (place_px := self._around_px) is None:
            ball = self._search_ranges(scene, colour, blobs)
        else:
            ball = self._finish(self._begin(scene, [blob for blob in blobs if _reaches(blob, place_px)]))
        return self._report_not_found(scene, blobs) if ball is None else self._report_found(scene, ball)

    def _find_any_colour(self, scene: BallScene) -> Detection:
        """Return the ball among the circles of edges; none if there are two that are as much like one."""
        choice, balls = BestBall(), list[FoundBall | None]()
        for circle in pick_circles(scene, choice):
            balls.append(self._search_at(choice.beside(scene), circle, within(circle)))
            choice.take(balls[-1])
        best, rival = best_and_rival(balls)
        if rival:
            return self._refuse(f"what is round at {rival} is as much like a ball; give its colours, hsv", scene)
        if best is not None:
            return self._report_found(scene, best)
        rejected = list_most_alike(scene.refusals)
        seen = f"outline of {rejected[0].size_px:.0f} px {rejected[0].reason}" if rejected else "no circle of edges"
        return self._refuse(seen, scene)

    def _refuse(self, reason: str, scene: BallScene) -> Detection:
        rejected = list_most_alike(scene.refusals)
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected)

    def _find_large(self, scene: BallScene, own: HsvRange) -> FoundBall | None:
        """Return a large ball beyond doubt, found in few pixels; None if it takes more of them to tell."""
        height, width = scene.image.shape[:2]
        if width * height <= COARSE_FROM_PIXELS * self._step**2 or self._step >= COARSE_STEP:
            return None
        # Every eighth pixel instead of every fourth: a quarter of the reading. What is found is measured in all pixels
        # all the same, so only a ball of few cells would be less sure, and that goes to the full search.
        blobs = find_blobs(scene.image, own, COARSE_STEP)
        if not blobs or blobs[0].size_px < COARSE_CELLS * COARSE_STEP:
            return None
        ball = self._begin(scene, blobs[:1]).choice.ball
        if explains(ball, blobs[0]):
            return ball
        scene.refusals.clear()
        return None

    def _find_expected(self, scene: BallScene, prediction: Prediction) -> FoundBall | None:
        """Look where the ball is expected: at the ring around its limb, or else at the blobs around it."""
        (x_px, y_px), radius_px = prediction.centre_px, prediction.size_px / 2
        if not all(map(math.isfinite, (x_px, y_px, radius_px, prediction.sigma_px))):
            return None
        # The ring: its width follows from the prediction's standard deviation, beyond the 2 px that a still target has
        # anyway. A ring of more than 16 px either side holds edges of other things.
        start = ImageCircle(x_px=x_px, y_px=y_px, radius_px=max(radius_px, self._gates.min_radius_px))
        scene = scene._replace(expected=start)
        reach_px = FIRST_REACH_PX + REACH_SIGMAS * max(0.0, prediction.sigma_px - CERTAIN_PX)
        if reach_px <= MAX_RING_PX:
            in_ring = self._search_at(scene, start, reach_px)
            if in_ring is not None and is_as_expected(in_ring, prediction):
                return in_ring
        # Half the side of the square that is searched, in pixels: the ball, half as much again for blobs that reach
        # beyond it, and four standard deviations of the place.
        half_px = 1.5 * start.radius_px + REGION_SIGMAS * prediction.sigma_px + FIRST_REACH_PX
        region = Region.around((x_px, y_px), half_px, scene.image)
        if region is None or self._colour is None:
            return None
        ball = self._finish(self._begin(scene, find_blobs(scene.image, self._colour, self._step, region)))
        return ball if ball is not None and is_as_expected(ball, prediction) else None

    def _search_ranges(self, scene: BallScene, own: HsvRange, blobs: Sequence[Blob]) -> FoundBall | None:
        """Return the ball by its range of colours, or by more or less of it; what was refused there is not reported."""
        searches = [self._begin(scene, blobs)]
        if searches[0].choice.ball is None:
            # A range given by hand may hold the floor or a hand as well, so that the blob is no ball; the more
            # saturated or brighter part of it may be the ball alone. A sure one saves the slower searches.
            for colour in other_ranges(thin_out(scene.image, self._step), own):
                narrowed = scene._replace(gates=replace(scene.gates, colour=colour), refusals=[])
                searches.append(self._begin(narrowed, find_blobs(scene.image, colour, self._step)[:MAX_OTHER_BLOBS]))
                if searches[-1].choice.has_sure:
                    return searches[-1].choice.ball
        for search in searches:
            ball = self._finish(search)
            if ball is not None and (search is searches[0] or ball.quality >= QUALITY_OF_OTHERS):
                return ball
        return None

    def _begin(self, scene: BallScene, blobs: Sequence[Blob]) -> RangeSearch:
        """Try the circle around each blob, the largest first, and look again at what is round enough without that."""
        large = [blob for blob in blobs if blob.size_px >= 2 * self._gates.min_radius_px - self._step]
        # Branch and bound. A second look takes several times as long as the first, so what is sure without comes first.
        search = RangeSearch(scene, large, BestBall(), [])
        for blob in large:
            if search.choice.is_better_than(WITHIN_REACH * blob.circle.radius_px):
                break
            self._search_within(search, blob)
        search.doubts.sort(key=lambda doubt: doubt.margin)
        self._look_again(search, 0.0)
        return search

    def _finish(self, search: RangeSearch) -> FoundBall | None:
        """Take the looks that are left, and the slower searches unless a ball is sure then; return the best ball."""
        self._look_again(search, -math.inf)
        # Slower searches beside a sure ball changed 2 of 540 results, by 0.1 and by 0.6 %.
        for try_at, blob in () if search.choice.has_sure else self._slower_searches(search.large):
            if not search.choice.is_better_than(AROUND_REACH * blob.circle.radius_px):
                search.choice.take(try_at(search.choice.beside(search.scene), blob))
        return search.choice.ball

    def _look_again(self, search: RangeSearch, least_margin: float) -> None:
        """Look again, by colour, at the limbs that leave doubt and are as well supported, the best first."""
        while search.doubts and search.doubts[-1].margin >= least_margin:
            blob, limb, reach_px, _ = search.doubts.pop()
            if not search.choice.is_better_than(WITHIN_REACH * blob.circle.radius_px):
                again = look_again(search.choice.beside(search.scene), limb, reach_px)
                search.choice.take(self._judge(search.scene, blob.circle, again, blob.coloured_px2))

    def _slower_searches(
        self, blobs: Sequence[Blob]
    ) -> Iterator[tuple[Callable[[BallScene, Blob], FoundBall | None], Blob]]:
        """Yield slower searches around the largest blobs."""
        for blob in blobs[:MAX_SEARCHED_AROUND]:
            yield self._search_inscribed, blob
        for blob in [*join_patches(blobs, MAX_SEARCHED_AROUND), *blobs[:MAX_SEARCHED_AROUND]]:
            yield self._search_around, blob

    def _search_within(self, search: RangeSearch, blob: Blob) -> None:
        """Try the circle around a blob, unless that could not show enough of the ball's colour."""
        if blob.fill < MIN_FILL:
            search.scene.refusals.append(refuse_too_little_colour(blob.circle, blob.fill))
            return
        reach_px = max(FIRST_REACH_PX, REACH_OF_STEP * blob.step)
        limb = find_limb(search.scene.image, blob.circle, reach_px, search.scene.lens)
        if limb is not None and limb.is_doubtful:
            search.put_off(blob, limb, reach_px)
        else:
            search.choice.take(self._judge(search.scene, blob.circle, limb, blob.coloured_px2))

    def _search_inscribed(self, scene: BallScene, blob: Blob) -> FoundBall | None:
        """Return the ball by the largest circle in a blob, which is wider since other things of its colour touch it."""
        circle = blob.inscribed
        if not self._gates.min_radius_px <= circle.radius_px < NARROWER * blob.circle.radius_px:
            return None
        return self._search_at(scene, circle, max(FIRST_REACH_PX, REACH_OF_STEP * blob.step))

    def _search_at(self, scene: BallScene, start: ImageCircle, reach_px: float) -> FoundBall | None:
        """Return the ball near a circle; None, and a note of why, if there is none."""
        limb = find_limb(scene.image, start, reach_px, scene.lens)
        if limb is not None and limb.is_doubtful:
            limb = look_again(scene, limb, reach_px)
        return self._judge(scene, start, limb)

    def _judge(
        self, scene: BallScene, start: ImageCircle, limb: Limb | None, coloured_px2: float | None = None
    ) -> FoundBall | None:
        """Return the ball that a limb near a circle is; None, and a note of why, if it is none."""
        if limb is None:
            scene.refusals.append(refuse_without_limb(start))
            return None
        judged = scene.gates.judge(scene, limb, coloured_px2)
        if isinstance(judged, FoundBall):
            return judged
        scene.refusals.append(judged)
        return None

    def _search_around(self, scene: BallScene, blob: Blob) -> FoundBall | None:
        """Return the ball by the circle of edges around a blob, unless that is too thin to be part of a ball."""
        if blob.fill < MIN_FILL_AROUND:
            return None
        circle = find_edge_circle(scene.image, blob.thinned_px, blob.area_px2)
        if circle is None or is_found_again(scene, circle):
            return None
        return self._search_at(scene, circle, within(circle))

    def _report_found(self, scene: BallScene, ball: FoundBall) -> Detection:
        circle = ball.limb.circle
        # The apparent size is the ellipse's smaller axis with the lens's distortion undone: that axis alone gives the
        # depth, at any place in the picture (see `stadimeter.ranging.ball`). Diameter and its standard deviation are
        # both twice those of the radius.
        diameter_px = 2 * ball.limb.straight_radius_px
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if ball.is_cut_off else DetectionStatus.FOUND,
            reason=f"the ball, {diameter_px:.0f} px, is cut off by the border" if ball.is_cut_off else "",
            outline_px=ball.limb.points_px,
            centre_px=(circle.x_px, circle.y_px),
            width_px=diameter_px,
            height_px=diameter_px,
            size_sigma_px=2 * ball.limb.radius_sigma_px,
            quality=ball.quality,
            rejected=list_most_alike(scene.refusals),
            measured_with=scene.lens if scene.is_lens_known else None,
        )

    def _report_not_found(self, scene: BallScene, blobs: Sequence[Blob]) -> Detection:
        rejected = list_most_alike(scene.refusals)
        if not blobs:
            reason = f"no pixel has the ball's colour {self._colour}"
        elif not rejected:
            reason = f"largest blob {blobs[0].size_px:.0f} px, limit {2 * self._gates.min_radius_px:.0f} px"
        else:
            reason = f"blob of {rejected[0].size_px:.0f} px {rejected[0].reason}"
        return self._refuse(reason, scene)


def _reaches(blob: Blob, place_px: tuple[float, float]) -> bool:
    """Return whether the circle around a blob reaches to a place."""
    return math.dist((blob.circle.x_px, blob.circle.y_px), place_px) <= blob.circle.radius_px + blob.step


def _detect_colour(frame: Frame, colour: HsvRange, around_px: tuple[float, float] | None = None) -> Detection:
    options = BallOptions.model_validate({"diameter": "1 m", "hsv": colour})  # the size changes nothing in a picture
    return BallDetector("ball", options, around_px=around_px).detect(frame)
