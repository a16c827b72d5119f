"""The likelihood that a limb is that of the ball: one figure, to which all that is seen of it adds.

No single test tells a ball from what chance puts together out of edges: a felt ball on a carpet scatters, a hand hides
half of another, a third is as bright as the wall. But hardly any circle of chance is seen all around, and round, and
parts what looks different on both sides, at once. So each of these adds to the logarithm of how much likelier a limb is
the ball's than another thing's. The weights are those of logistic regressions on 12,500 limbs: of real balls of three
kinds in rooms, of a hundred real rooms without one, and of rendered balls and clutter.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Prediction, RejectedCandidate
from stadimeter.core.frame import Frame, Image, Subsampling
from stadimeter.detectors.ball.blobs import ImageCircle, separate
from stadimeter.detectors.ball.limb import SHARP_PX, Limb
from stadimeter.detectors.hsv import HsvRange
from stadimeter.detectors.protocol import check_image

# From the first evidence on a limb is the ball's, which one to three of 100 rooms without a ball reach; from the second
# on it is perhaps, which six do. With the third it need not be searched for elsewhere; beyond the fourth more says no
# more, and of two balls the larger is taken. The last has quality 1.
LIKELY, POSSIBLE, SURE, DOUBTLESS, BEST = 0.0, -2.0, 4.0, 6.0, 9.0

# Of a ball with a radius below this, in pixels, no limb has much evidence, so it may be one with less: of 120 rendered
# ones 96 are found in place of 89. A square of 12 px has a little less.
SMALL_PX, POSSIBLE_SMALL = 10.0, -2.7


class Weights(NamedTuple):
    """The amount that each thing that is seen of a limb adds to its evidence."""

    start: float
    seen: float  # the share of it that shows steps
    rough: float  # its roughness, up to `MAX_ROUGHNESS`
    apart: float  # how many standard deviations inside and outside look apart, up to `MAX_APART`
    large: float  # the logarithm of its radius, up to `LARGE_PX`: chance makes small circles
    cornered: float  # the share of its scatter that is four waves around it, as of a square
    vivid: float  # by how many levels of 8 bits the inside is more vivid, between the two `VIVID_LEVELS`


COLOUR = Weights(start=-17.0, seen=12.1, rough=-11.5, apart=2.28, large=2.27, cornered=-2.4, vivid=0.0)
ANY_COLOUR = Weights(start=-11.5, seen=15.7, rough=-15.5, apart=0.72, large=0.64, cornered=-2.5, vivid=0.009)
MAX_ROUGHNESS, MAX_APART, LARGE_PX, VIVID_LEVELS = 1.5, 4.0, 100.0, (-50.0, 100.0)

# With a colour: the logarithm of the share of the inside that has it, up to the second figure, since the rest may be in
# the shade or printed on; the third keeps it finite. And the share of the directions in which it goes on outside.
FILLED, FILLED_ENOUGH, FILLED_ANYHOW, GOES_ON = 2.63, 0.6, 0.03, -6.6

# What shows less of the ball's colour than this is another thing, whatever else speaks for it; of the colours that it
# may have in other light pale walls show some, a ball a half.
MIN_FILL, MIN_FILL_OF_OTHER = 0.02, 0.3

# Among the colours that it may have in other light, chance has more to choose from: with this cost, three real balls in
# a glare or in the shade are found, and no more alarms are raised in a hundred rooms.
OTHER_LIGHT = 1.5

# Of fewer steps, or with less roughness, corners are not seen.
MIN_CORNERED_STEPS, MIN_CORNERED_ROUGHNESS = 12, 0.08

# A limb just where and as large as one is expected has this much more: a circle that chance puts together is hardly
# ever there and as large. It is off by less than these shares of the radius; a hand moves a ball by half its radius in
# a frame, but not that much nearer.
EXPECTED, AGREEING_PLACE, AGREEING_SIZE = 4.0, 0.5, 0.08

# Of a limb of which so much is seen, what is inside and outside is not looked at where that is known: where the ball is
# expected, it was less than a second ago (see `stadimeter.perception.perceiver`). It would take as long as all else.
SEEN_ALL_AROUND = 0.8

# Of a ball cut off by the border, what is missing of this share of the limb counts as unseen.
MIN_INSIDE = 0.5

# A limb this near to the outermost pixels is cut off.
MARGIN_PX = 1.0

# Directions in which inside and outside are looked at, more where few are in the picture; how far from the limb, in
# pixels, as a share of the radius, and of what blur adds to the width of a step; and where, as shares of the last
# place inside and of the first outside.
DIRECTIONS, DIRECTIONS_CUT_OFF = 32, 128
BESIDE_PX, BESIDE_SHARE, BESIDE_OF_BLUR = 1.5, 0.08, 0.5
INSIDE, OUTSIDE = np.array([0.3, 0.6, 0.85]), np.array([1.0, 1.12])
MIN_BESIDE, MIN_DIRECTIONS = 0.3, 6

# The focal length of most cameras, as a share of their pictures' long side.
LIKELY_FOCAL_SHARE = 0.8

# A ball further from its prediction than this, in its place or its size, may be something else.
AGREE_SIGMAS, AGREE_PX = 3.0, 1.0


class FoundBall(Struct, frozen=True, kw_only=True, eq=False):
    """A limb, and how likely it is the ball's."""

    limb: Limb
    evidence: float
    fault: str  # what speaks against it most, in words
    is_cut_off: bool  # whether the border of the picture cuts it off

    @property
    def quality(self) -> float:
        """From 0 for a limb that may just be the ball's to 1 for one that hardly any other is more like."""
        return float(min(1.0, max(0.0, (self.evidence - POSSIBLE) / (BEST - POSSIBLE))))

    @property
    def is_possible(self) -> bool:
        """True if it may be the ball."""
        return self.evidence >= self.limit

    @property
    def limit(self) -> float:
        """The least evidence with which it may be the ball; that of one that the border cuts off is of little of it."""
        if self.is_cut_off:
            return LIKELY
        return POSSIBLE_SMALL if self.limb.circle.radius_px < SMALL_PX else POSSIBLE

    @property
    def rank(self) -> float:
        """The likelier the better; of those beyond doubt the larger, since chance makes small ones."""
        return max_rank(self.limb.circle.radius_px) - max(0.0, DOUBTLESS - self.evidence)

    @property
    def rejected(self) -> RejectedCandidate:
        """The candidate that it is where it is not taken for the ball."""
        circle = self.limb.circle
        figures = "" if math.isinf(self.evidence) else f": evidence {self.evidence:.1f}, limit {self.limit:.1f}"
        return RejectedCandidate(
            centre_px=(circle.x_px, circle.y_px), size_px=2 * circle.radius_px, reason=self.fault + figures
        )


class BallScene(NamedTuple):
    """A frame that is searched."""

    image: Image
    lens: CameraModel  # the camera at its resolution; a likely one if it is not known
    is_lens_known: bool  # whether it is
    colour: HsvRange | None  # the ball's; None where any will do
    radii_px: tuple[float, float]  # the least and the largest radius that is accepted, the latter perhaps infinite
    seen: list[FoundBall]  # every limb that was looked at, filled while searching
    expected: ImageCircle | None = None  # where the ball is expected, while it is looked for there

    @property
    def weights(self) -> Weights:
        """The weights that count."""
        return COLOUR if self.colour else ANY_COLOUR

    @property
    def ranked(self) -> list[FoundBall]:
        """Candidates seen so far, the most like the ball first."""
        return sorted(self.seen, key=lambda each: -each.rank)

    @property
    def best(self) -> FoundBall | None:
        """The candidate most like the ball so far."""
        return max(self.seen, key=lambda each: each.rank, default=None)

    @property
    def is_likely(self) -> bool:
        """True if there is a ball that is likely."""
        return self.best is not None and self.best.evidence >= LIKELY

    def is_settled(self, radius_px: float = 0.0) -> bool:
        """Check whether there is a ball beyond doubt, and nothing of up to this radius could be more like it."""
        best = self.best
        return best is not None and best.evidence >= SURE and (not radius_px or best.rank >= max_rank(radius_px))


def max_rank(radius_px: float) -> float:
    """Return the rank of a ball of this size beyond doubt."""
    return DOUBTLESS + math.log(radius_px)


def hope(scene: BallScene, limb: Limb) -> float:
    """Return the evidence of a limb if all that is inside and outside were as it should be."""
    weights, circle = scene.weights, limb.circle
    evidence = weights.start + weights.seen * seen_share(limb) + weights.rough * min(limb.roughness, MAX_ROUGHNESS)
    evidence += weights.apart * MAX_APART + weights.large * math.log(min(circle.radius_px, LARGE_PX))
    evidence += weights.vivid * VIVID_LEVELS[1]
    if scene.expected is not None and _agrees(circle, scene.expected):
        evidence += EXPECTED
    return evidence


def seen_share(limb: Limb) -> float:
    """Return the share of the limb that is seen, of what the border of the picture leaves of it."""
    return min(limb.support_inside, limb.support / MIN_INSIDE)


def weigh(scene: BallScene, limb: Limb, *, is_alike: bool = False) -> FoundBall:
    """Weigh how likely a limb is the ball's, and what speaks against it most.

    Args:
        is_alike: Whether it is known that what is inside looks like the ball, and what is outside does not.
    """
    weights, seen, evidence = scene.weights, seen_share(limb), hope(scene, limb)
    is_cut_off, (least_px, most_px) = touches_border(limb.circle, scene.image), scene.radii_px
    # Its radius is known to its standard deviation only.
    if not least_px - limb.radius_sigma_px <= limb.circle.radius_px <= most_px:
        limits = f"{2 * least_px:.0f} to {2 * most_px:.0f} px"
        fault = f"lies in a circle of {2 * limb.circle.radius_px:.0f} px, limit {limits}"
        return FoundBall(limb=limb, evidence=-math.inf, fault=fault, is_cut_off=is_cut_off)
    # What each fault takes from the evidence, by the words for it.
    costs = {
        f"is not round: {seen:.0%} of a circle to {limb.scatter_px:.1f} px": weights.seen * (1 - seen)
        - weights.rough * min(limb.roughness, MAX_ROUGHNESS)
    }
    if limb.support < SEEN_ALL_AROUND or not (is_alike or scene.expected is not None):
        around = _look_around(scene, limb)
        evidence -= sum(around.values())
        costs |= around
        if evidence >= POSSIBLE_SMALL and (corners := _corners(limb)):
            costs["is not round: it has corners"] = -weights.cornered * corners
            evidence += weights.cornered * corners
    fault = max(costs, key=lambda each: costs[each])
    return FoundBall(limb=limb, evidence=evidence, fault=fault, is_cut_off=is_cut_off)


def _look_around(scene: BallScene, limb: Limb) -> dict[str, float]:
    """Return the amounts that inside and outside take from the evidence, by the words for it."""
    pixels, weights = _sample(scene, limb), scene.weights
    if len(pixels) < MIN_DIRECTIONS:
        return {"shows too little of itself": weights.apart * MAX_APART}
    inner = len(INSIDE)
    inside, outside = pixels[:, :inner].reshape(-1, 3), pixels[:, inner:].reshape(-1, 3)
    apart = min(separate(inside.astype(np.float32), outside.astype(np.float32))[1], MAX_APART)
    costs = {f"looks like what is around it, {apart:.1f} σ apart": weights.apart * (MAX_APART - apart)}
    if scene.colour is None:
        more = min(max(median_chroma(inside) - median_chroma(outside), VIVID_LEVELS[0]), VIVID_LEVELS[1])
        what = f"is no more vivid than what is around it, by {more:.0f} levels"
        return costs | {what: weights.vivid * (VIVID_LEVELS[1] - more)}
    in_other_light = _cost_of_colour(scene.colour.in_other_light.mask(pixels) > 0, MIN_FILL_OF_OTHER)
    in_other_light["has the ball's colour in other light only"] = OTHER_LIGHT
    own = _cost_of_colour(scene.colour.mask(pixels) > 0, MIN_FILL)
    return costs | min(own, in_other_light, key=lambda each: sum(each.values()))


def _cost_of_colour(has_colour: Flags, min_fill: float) -> dict[str, float]:
    """Return the amounts that the places of a colour, shape ``(n, 5)``, take from the evidence."""
    inner = len(INSIDE)
    fill, goes_on = float(has_colour[:, :inner].mean()), float(has_colour[:, inner:].any(axis=1).mean())
    filled = min(1.0, (fill + FILLED_ANYHOW) / (FILLED_ENOUGH + FILLED_ANYHOW))
    return {
        f"has the ball's colour on {fill:.0%} of it, limit {min_fill:.0%}": -FILLED * math.log(filled)
        if fill >= min_fill
        else math.inf,
        f"goes on in its colour beyond {goes_on:.0%} of its limb": -GOES_ON * goes_on,
    }


def median_chroma(pixels: Image) -> int:
    """Return the median of how far the channels of pixels, shape ``(n, 3)``, are apart."""
    chroma = pixels.max(axis=1) - pixels.min(axis=1)
    chroma.partition(len(chroma) // 2)
    return int(chroma[len(chroma) // 2])


def _sample(scene: BallScene, limb: Limb) -> Image:
    """Return colours inside and outside in the directions in which the picture shows the limb, shape ``(n, 5, 3)``."""
    circle, (height, width) = limb.circle, scene.image.shape[:2]
    blur_px = BESIDE_OF_BLUR * max(0.0, limb.width_px - SHARP_PX)
    beside = max(BESIDE_PX / circle.radius_px, BESIDE_SHARE) + blur_px / circle.radius_px
    shares = np.concatenate([max(1 - beside, MIN_BESIDE) * INSIDE, (1 + beside) * OUTSIDE])
    is_cut_off = touches_border(circle, scene.image)
    directions = DIRECTIONS_CUT_OFF if is_cut_off else DIRECTIONS
    out = scene.lens.project(limb.cone.outline(directions)) - (circle.x_px, circle.y_px)
    places = np.rint(out[:, None] * shares[:, None] + (circle.x_px, circle.y_px))
    beside = places[:, len(INSIDE) - 1 :]
    places = places[((beside >= 0) & (beside < (width, height))).all(axis=(1, 2))]
    if is_cut_off:
        # What is at the border stands for what is beyond.
        places = np.clip(places, 0, (width - 1, height - 1))
    x, y = np.moveaxis(places.astype(np.intp), -1, 0)
    return np.asarray(scene.image[y, x])


def _corners(limb: Limb) -> float:
    """Return the share of the squared scatter about the nearest ellipse that is four waves around the limb: 0 to 1."""
    if len(limb.points_px) < MIN_CORNERED_STEPS or limb.roughness < MIN_CORNERED_ROUGHNESS:
        return 0.0
    # Fourier series of the radius over the angle: wave 1 is a shift of the centre, wave 2 an ellipse, wave 4 the
    # corners of a square.
    x, y = (limb.points_px - (limb.circle.x_px, limb.circle.y_px)).T
    radii_px, turns = np.hypot(x, y), np.outer((1, 2, 4), np.arctan2(y, x))
    waves = np.vstack([np.ones(len(x)), np.cos(turns[:2]), np.sin(turns[:2]), np.cos(turns[2]), np.sin(turns[2])])
    # One after another, each orthogonal to those before it: what is left without the last two, and what with them.
    found_px2 = (radii_px @ np.linalg.qr(waves.T)[0]) ** 2
    elliptic = max(float(radii_px @ radii_px - found_px2[:5].sum()), 1e-12)
    return float(found_px2[5:].sum()) / elliptic


def _agrees(circle: ImageCircle, expected: ImageCircle) -> bool:
    """Check whether a circle is just where and as large as one is expected."""
    off_px = math.hypot(circle.x_px - expected.x_px, circle.y_px - expected.y_px)
    larger_px = abs(circle.radius_px - expected.radius_px)
    return off_px <= AGREEING_PLACE * expected.radius_px and larger_px <= AGREEING_SIZE * expected.radius_px


def touches_border(circle: ImageCircle, image: Image) -> bool:
    """Check whether a circle reaches the border of a picture."""
    height, width = image.shape[:2]
    reach_px = circle.radius_px + MARGIN_PX
    middle_px = min(circle.x_px, circle.y_px, width - 1 - circle.x_px, height - 1 - circle.y_px)
    return bool(middle_px < reach_px)


def is_as_expected(ball: FoundBall, prediction: Prediction) -> bool:
    """Check whether a ball is where it was expected, and as large."""
    circle = ball.limb.circle
    max_px = AGREE_SIGMAS * max(prediction.sigma_px, 0.0) + AGREE_PX
    off_px = math.dist((circle.x_px, circle.y_px), prediction.centre_px)
    return off_px <= max_px and abs(2 * circle.radius_px - prediction.size_px) <= max_px


def scene_of(
    frame: Frame, lens: CameraModel | None, colour: HsvRange | None, radii_px: tuple[float, float]
) -> BallScene:
    """Return the scene that is looked at in a frame; `PictureError` for an image that is none."""
    check_image(frame)
    return BallScene(
        image=frame.image,
        lens=lens or _likely_lens(frame.width_px, frame.height_px, frame.subsampling),
        is_lens_known=lens is not None,
        colour=colour,
        radii_px=radii_px,
        seen=[],
    )


@lru_cache(maxsize=8)
def _likely_lens(width_px: int, height_px: int, subsampling: Subsampling) -> CameraModel:
    """Return a camera like those of most phones, webcams and boards: 60 to 70 degrees across the long side."""
    # 0.8 of the long side is a field of view of 64 degrees. It only serves to know how oblong the outline is away from
    # the middle; no distance is measured through it.
    focal_px = LIKELY_FOCAL_SHARE * max(width_px, height_px)
    return replace(CameraModel.with_focal_length(focal_px, width_px, height_px), subsampling=subsampling)
