"""The tests that a limb has to pass to be a ball's, and how well it passes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Prediction, RejectedCandidate, Values
from stadimeter.core.frame import Frame, Image, Subsampling
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.ball.limb import SHARP_PX, Limb
from stadimeter.detectors.hsv import HsvRange
from stadimeter.detectors.protocol import check_image
from stadimeter.ranging.ball import ConeFrame, with_ones

# Least share of the limb that must be seen: the first if its steps lie on it exactly, more as they scatter, up to
# the sum of both for the allowance below. Clutter has many circles with few steps near them, and some that are round by
# half, but hardly any with most of its steps close by.
MIN_SUPPORT, SUPPORT_OF_SCATTER = 0.3, 0.7

# The allowance for scatter: pixels for noise, a share of the radius for felt and fingers, a share of what blur adds to
# the width of a step; and without a camera model, another share of the radius, since how oblong the outline is away
# from the middle of the picture is then not known.
SCATTER_PX, SCATTER_SHARE, SCATTER_OF_BLUR, UNKNOWN_LENS_SHARE = 0.3, 0.07, 0.3, 0.02

# Least share of the whole limb that a ball cut off by the border must show; the rest is judged as of other balls.
MIN_CUT_OFF_SUPPORT = 0.25

# A limb this near to the outermost pixels is cut off.
MARGIN_PX = 1.0

# A limb that is off by less than these shares of the radius, in place and size, from what was expected is supported by
# that as well: a circle that chance puts together is hardly ever there and as large. A hand moves a ball by half its
# radius in a frame, but not that much nearer. So the last share of what is asked for is enough.
AGREEING_PLACE, AGREEING_SIZE, AGREEING_SHARE = 0.5, 0.08, 0.7

# A limb is that of something with four corners if waves of four to the turn have more than this share of the variance
# of its steps, and are higher than this share of the radius.
SQUARE_SHARE, SQUARE_OFF = 0.3, 0.06

# With less scatter, as a share of the radius, there are no such waves; of fewer steps they are not seen.
SQUARE_SCATTER, MIN_SQUARE_STEPS = 0.04, 12

# Least share of the ball that has its colour.
MIN_FILL = 0.3

# Circles that chance puts together from the edges of other things have less: the first, and the second over the radius
# in pixels, since chance makes small ones more often.
MIN_QUALITY, QUALITY_OF_SMALL_PX = 0.06, 0.3

# Greatest allowance without blur: steps of texture scatter more, and lie near to any large circle.
MAX_SCATTER_PX = 3.0

# A ball whose colour is not known: chance has the whole picture to put a circle together, and there are eggs and drops.
# The share of the limb that is seen, less these multiples of its scatter over what is allowed and of the share of that
# scatter which is a shape of its own, must be more than the last. In 970 empty pictures two things have that, and of
# 367 silver balls all but 34; a least quality that two have refuses 60. Of those balls none has less than this quality.
ROUND_SCATTER, ROUND_SHAPE, MIN_ROUNDNESS = 1.4, 0.4, 0.15
MIN_QUALITY_OF_ANY_COLOUR = 0.2

# The shape of something else: so many waves around it.
WAVES = np.arange(1, 5)

# With less of the limb seen than is asked for and this, twice the share outside of which the ball's colour goes on
# counts against it: an ellipse or a corner of that colour has an arc that is round, and reaches beyond it elsewhere.
CLEAR_MARGIN, OVERRUN_WEIGHT = 0.25, 2.0

# Distance outside the limb: pixels, or a share of the radius if that is more, and a share of what blur adds to the
# width of a step.
BESIDE_PX, BESIDE_SHARE, BESIDE_OF_BLUR = 2.0, 0.05, 0.5

# Points of the limb at which that is looked for.
OUTLINE_POINTS = 48

# The focal length of most cameras, as a share of their pictures' long side.
LIKELY_FOCAL_SHARE = 0.8

# Pixels each way from which the share of a circle with the ball's colour is estimated.
GRID = 16

# A ball has quality 1 if this much more of its limb is seen than needed.
FULL_QUALITY_MARGIN = 0.6

# With this quality, smaller blobs need not be looked at.
SURE_QUALITY = 0.4

# A ball further from its prediction than this, in its place or its size, may be something else.
AGREE_SIGMAS, AGREE_PX = 3.0, 1.0

MAX_REJECTED = 8


class FoundBall(Struct, frozen=True, kw_only=True, eq=False):
    """A limb that passed every test."""

    limb: Limb
    fill: float  # how much of the ball has its colour; 1 where that is known from before
    margin: float  # by how much more of the limb is seen than is asked for
    is_cut_off: bool  # whether the border of the picture cuts it off

    @property
    def quality(self) -> float:
        """From 0 for a limb that is barely enough to 1 for one that is seen all around."""
        return min(1.0, max(0.0, self.margin) / FULL_QUALITY_MARGIN) * math.sqrt(min(1.0, self.fill / 0.8))

    @property
    def score(self) -> float:
        """The rounder the better; of equally round ones the larger, since chance makes small ones."""
        return self.quality * max_score(self.limb.circle.radius_px)

    @property
    def is_sure(self) -> bool:
        """Whether nothing smaller can be more like a ball."""
        return self.quality >= SURE_QUALITY


class Refusal(NamedTuple):
    """Something that is no ball.

    Attributes:
        likeness: How much it is like one, as scores are: the tests that it passed and its share of the one that it
            failed, and more if it is large. It only tells which of many refusals to name.
    """

    likeness: float
    candidate: RejectedCandidate


class BallGates(Struct, frozen=True, kw_only=True):
    """The tests that a limb has to pass."""

    colour: HsvRange | None  # None where any colour will do
    min_radius_px: float
    max_radius_px: float  # the largest radius, perhaps infinite

    def judge(self, scene: BallScene, limb: Limb, coloured_px2: float | None = None) -> FoundBall | Refusal:
        """Return the ball, or the test that its limb failed, the cheapest first.

        A limb that agrees with where a ball is expected need not show as much of itself, and if nearly all of it is
        seen, its colour is not judged again. `coloured_px2` is the area around there that has the ball's colour.
        """
        # Tests in order of cost: size, support, corners, colour, overrun, quality. Each refusal carries how many were
        # passed, by which the closest one is named to the user.
        radius_px = limb.circle.radius_px
        if not self.min_radius_px <= radius_px <= self.max_radius_px:
            most = "" if math.isinf(self.max_radius_px) else f" to {2 * self.max_radius_px:.0f}"
            limits = f"{2 * self.min_radius_px:.0f}{most} px"
            return _refuse(limb.circle, f"lies in a circle of {2 * radius_px:.0f} px, limit {limits}", 0.0)
        agrees = scene.expected is not None and _agrees(limb.circle, scene.expected)
        needed = needed_support(scene, limb, agrees=agrees)
        cut_off = is_cut_off(limb.circle, scene.image)
        # Support is the share of spokes with a step on the limb. Of a ball at the border only the spokes inside the
        # picture count, if at least a quarter of the whole limb is seen.
        support = limb.support_inside if cut_off and limb.support >= MIN_CUT_OFF_SUPPORT else limb.support
        if support < needed:
            reason = f"is not round: {support:.0%} of a circle to {limb.scatter_px:.1f} px, limit {needed:.0%}"
            return _refuse(limb.circle, reason, 1 + support / needed)
        if not agrees and (fault := self._misshape(scene, limb, support, needed)):
            return _refuse(limb.circle, fault, 2.0)
        margin = support - needed
        # Where a ball is expected and seen all around, its colour was judged less than a second ago: see
        # stadimeter.perception.perceiver. To judge it again would take as long as a fifth of all else.
        is_known = scene.expected is not None and margin >= FULL_QUALITY_MARGIN
        colour = self.colour
        fill = 1.0 if is_known or colour is None else _fill(scene.image, limb.circle, coloured_px2, colour)
        if fill < MIN_FILL:
            return refuse_too_little_colour(limb.circle, fill, tests_passed=2)
        # Only a barely supported limb is held against the colour outside: an arc of an ellipse or the corner of a thing
        # of the ball's colour is round too, but the colour goes on where no step is seen.
        if margin < CLEAR_MARGIN and colour is not None:
            margin -= OVERRUN_WEIGHT * _overrun(scene.image, limb, scene.lens, colour)
        ball = FoundBall(limb=limb, fill=fill, margin=margin, is_cut_off=cut_off)
        least = MIN_QUALITY + QUALITY_OF_SMALL_PX / radius_px if colour is not None else MIN_QUALITY_OF_ANY_COLOUR
        if ball.quality < least and not agrees:
            reason = f"is hardly round: quality {ball.quality:.2f}, limit {least:.2f}"
            return _refuse(limb.circle, reason, 3 + ball.quality / least)
        return ball

    def _misshape(self, scene: BallScene, limb: Limb, support: float, needed: float) -> str:
        """Return how a limb's shape is none of a ball; empty if it may be one."""
        if _is_square(limb):
            return "is not round: it has corners, as four waves around it tell"
        if self.colour is not None:
            return ""
        scatter = ROUND_SCATTER * (needed - MIN_SUPPORT) / SUPPORT_OF_SCATTER
        roundness = support - scatter - ROUND_SHAPE * _shape_share(limb, scene.lens)
        return "" if roundness >= MIN_ROUNDNESS else f"is hardly round: {roundness:.2f}, limit {MIN_ROUNDNESS:.2f}"


class BallScene(NamedTuple):
    """A frame that is searched."""

    image: Image
    lens: CameraModel  # the camera at its resolution; a likely one if it is not known
    is_lens_known: bool  # whether it is
    gates: BallGates  # what a ball must pass
    refusals: list[Refusal]  # what was looked at and is no ball, filled while searching
    looks: dict[ImageCircle, Limb]  # what a second look at doubtful limbs came to, filled while searching
    found: FoundBall | None = None  # the best ball so far
    expected: ImageCircle | None = None  # where the ball is expected, while it is looked for there


def _overrun(image: Image, limb: Limb, lens: CameraModel, colour: HsvRange) -> float:
    """Return the share of the limb that shows no step, and outside of which the ball's colour goes on.

    Of what hides a ball there is none outside.
    """
    outline_px = lens.project(limb.cone.outline(OUTLINE_POINTS))
    radius_px, blur_px = limb.circle.radius_px, max(0.0, limb.width_px - SHARP_PX)
    off_px = max(BESIDE_PX, BESIDE_SHARE * radius_px) + BESIDE_OF_BLUR * blur_px
    # An outline point is unseen if no step lies within r / 12 of it, two thirds of their spacing.
    unseen_px = outline_px[_nearest_px(outline_px, limb.points_px) > 4 * radius_px / OUTLINE_POINTS]
    return colour_share_beside(image, unseen_px, outline_px.mean(0), off_px, colour) * (len(unseen_px) / OUTLINE_POINTS)


def _fill(image: Image, circle: ImageCircle, coloured_px2: float | None, colour: HsvRange) -> float:
    """Return how much of a ball has its colour."""
    if coloured_px2 is None:
        return colour_share(image, circle, colour)
    return min(1.0, coloured_px2 / (math.pi * circle.radius_px**2))


def _agrees(circle: ImageCircle, expected: ImageCircle) -> bool:
    """Return whether a circle is just where and as large as one is expected."""
    off_px = math.hypot(circle.x_px - expected.x_px, circle.y_px - expected.y_px)
    larger_px = abs(circle.radius_px - expected.radius_px)
    return off_px <= AGREEING_PLACE * expected.radius_px and larger_px <= AGREEING_SIZE * expected.radius_px


def _is_square(limb: Limb) -> bool:
    """Return whether the steps lie as on a square: nearer in the middle of each side, further away at the corners."""
    if limb.scatter_px < SQUARE_SCATTER * limb.circle.radius_px or len(limb.points_px) < MIN_SQUARE_STEPS:
        return False
    # Fourier series of the radius over the angle: wave 1 is a shift of the centre, wave 2 an ellipse, wave 4 the
    # corners of a square. In empty rooms most false balls were square.
    x, y = (limb.points_px - (limb.circle.x_px, limb.circle.y_px)).T
    radii_px, turns = np.hypot(x, y), np.outer((1, 2, 4), np.arctan2(y, x))
    waves = np.vstack([np.ones(len(x)), np.cos(turns), np.sin(turns)])
    # What a circle beside the centre and an ellipse leave is compared with what four waves to the turn leave as well.
    (_, round_px2), (fit, all_px2) = _fit_waves(waves[[0, 1, 2, 4, 5]], radii_px), _fit_waves(waves, radii_px)
    height_px = math.hypot(fit[3], fit[6])
    return height_px > SQUARE_OFF * limb.circle.radius_px and all_px2 < (1 - SQUARE_SHARE) * round_px2


def _shape_share(limb: Limb, lens: CameraModel) -> float:
    """Return the share of the squared scatter that is a few waves around the limb, as of an egg or a drop."""
    x, y = (limb.points_px - (limb.circle.x_px, limb.circle.y_px)).T
    frame = ConeFrame(with_ones(lens.directions(limb.points_px)), lens.direction(limb.circle.x_px, limb.circle.y_px))
    misses, turns = frame.misses(limb.cone), np.outer(WAVES, np.arctan2(y, x))
    _, left = _fit_waves(np.vstack([np.ones(len(x)), np.cos(turns), np.sin(turns)]), misses)
    return 1 - left / max(float(misses @ misses), 1e-12)


def _fit_waves(waves: Values, radii_px: Values) -> tuple[Values, float]:
    """Return the heights of the waves that come nearest to the radii, and the sum of the squares that they leave."""
    fit = np.asarray(np.linalg.lstsq(waves.T, radii_px, rcond=None)[0], np.float64)
    left_px = radii_px - fit @ waves
    return fit, float(left_px @ left_px)


def refuse_without_limb(start: ImageCircle) -> Refusal:
    """Return why there is no ball where no limb was found near a circle."""
    return _refuse(start, f"has no edge around it, limit {MIN_SUPPORT:.0%} of a circle", 0.0)


def refuse_too_little_colour(circle: ImageCircle, fill: float, tests_passed: int = 0) -> Refusal:
    """Return why there is no ball where this share of a circle has its colour."""
    reason = f"has the ball's colour on {fill:.0%} of it, limit {MIN_FILL:.0%}"
    return _refuse(circle, reason, tests_passed + fill / MIN_FILL)


def max_score(radius_px: float) -> float:
    """Return the score of the best ball of this size."""
    return math.sqrt(radius_px)


def is_cut_off(circle: ImageCircle, image: Image) -> bool:
    """Return whether a circle reaches the border of a picture."""
    height, width = image.shape[:2]
    reach_px = circle.radius_px + MARGIN_PX
    middle_px = min(circle.x_px, circle.y_px, width - 1 - circle.x_px, height - 1 - circle.y_px)
    return bool(middle_px < reach_px)


def _nearest_px(points_px: Points, others_px: Points) -> Values:
    """Return how far each point is from the nearest of the others."""
    apart = points_px[:, None] - others_px
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]).min(axis=1))


def needed_support(scene: BallScene, limb: Limb, *, agrees: bool = False) -> float:
    """Return how much of a limb must be seen for it to be a ball's, given how much its steps scatter."""
    # Allowed scatter in pixels: noise, a share of the radius for felt and fingers, and for blurred limbs a share of
    # what their steps are wider than 2.6 px. The needed support rises in proportion to the scatter.
    share = SCATTER_SHARE + (0.0 if scene.is_lens_known else UNKNOWN_LENS_SHARE)
    blur_px = max(0.0, limb.width_px - SHARP_PX)
    allowance_px = min(SCATTER_PX + share * limb.circle.radius_px, MAX_SCATTER_PX) + SCATTER_OF_BLUR * blur_px
    needed = MIN_SUPPORT + SUPPORT_OF_SCATTER * limb.scatter_px / allowance_px
    return needed * (AGREEING_SHARE if agrees else 1.0)


def _refuse(circle: ImageCircle, reason: str, tests_passed: float) -> Refusal:
    centre_px, size_px = (circle.x_px, circle.y_px), 2 * circle.radius_px
    candidate = RejectedCandidate(centre_px=centre_px, size_px=size_px, reason=reason)
    return Refusal(tests_passed * max_score(circle.radius_px), candidate)


def colour_share(image: Image, circle: ImageCircle, colour: HsvRange) -> float:
    """Return how much of a circle has a colour, 0 to 1, from a grid of the pixels in its inner square."""
    # The square inscribed in the circle: no pixel of the background is counted. 16 by 16 of its pixels are read,
    # whatever the size.
    half_px = max(1.0, circle.radius_px * math.sqrt(0.5))
    left, top = max(int(circle.x_px - half_px), 0), max(int(circle.y_px - half_px), 0)
    right, bottom = max(int(circle.x_px + half_px + 1), 0), max(int(circle.y_px + half_px + 1), 0)
    part = image[top:bottom, left:right]
    if part.size == 0:
        return 0.0
    grid = np.asarray(cv2.resize(part, (GRID, GRID), interpolation=cv2.INTER_NEAREST), np.uint8)
    return cv2.countNonZero(colour.mask(grid)) / (GRID * GRID)


def colour_share_beside(image: Image, points_px: Points, centre_px: Points, off_px: float, colour: HsvRange) -> float:
    """Return at how many of the points, this much further from a centre, a colour is seen: 0 to 1."""
    out = points_px - centre_px
    out *= 1 + off_px / np.maximum(np.hypot(out[:, :1], out[:, 1:]), 1.0)
    places = np.rint(np.nan_to_num(centre_px + out))
    inside = ((places >= 0) & (places < (image.shape[1], image.shape[0]))).all(axis=1)
    x, y = places[inside].astype(np.intp).T
    return cv2.countNonZero(colour.mask(image[None, y, x])) / len(points_px) if len(x) else 0.0


def list_most_alike(refusals: Sequence[Refusal]) -> tuple[RejectedCandidate, ...]:
    """Return what is no ball, most like one first."""
    ordered = sorted(refusals, key=lambda each: each.likeness, reverse=True)
    return tuple(each.candidate for each in ordered[:MAX_REJECTED])


def is_as_expected(ball: FoundBall, prediction: Prediction) -> bool:
    """Return whether a ball is where it was expected, and as large."""
    circle = ball.limb.circle
    max_px = AGREE_SIGMAS * max(prediction.sigma_px, 0.0) + AGREE_PX
    off_px = math.dist((circle.x_px, circle.y_px), prediction.centre_px)
    return off_px <= max_px and abs(2 * circle.radius_px - prediction.size_px) <= max_px


def scene_of(frame: Frame, lens: CameraModel | None, gates: BallGates) -> BallScene:
    """Return what is looked at in a frame; `PictureError` for an image that is none."""
    check_image(frame)
    return BallScene(
        image=frame.image,
        lens=lens or _likely_lens(frame.width_px, frame.height_px, frame.subsampling),
        is_lens_known=lens is not None,
        gates=gates,
        refusals=[],
        looks={},
    )


@lru_cache(maxsize=8)
def _likely_lens(width_px: int, height_px: int, subsampling: Subsampling) -> CameraModel:
    """Return a camera like those of most phones, webcams and boards: 60 to 70 degrees across the long side."""
    # 0.8 of the long side is a field of view of 64 degrees. It only serves to know how oblong the outline is away from
    # the middle; no distance is measured through it.
    focal_px = LIKELY_FOCAL_SHARE * max(width_px, height_px)
    return replace(CameraModel.with_focal_length(focal_px, width_px, height_px), subsampling=subsampling)
