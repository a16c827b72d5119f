"""The limb of a ball: the cone of rays that touches it, fitted to the steps around an expected circle.

Some of the steps are not the ball's: a finger hides part of it, what lies behind it is as bright. The cone is fitted
robustly, and where too many steps miss it, started anew from the best of many circles through three steps each.
`stadimeter.detectors.ball.evidence` weighs whether the limb is that of a ball.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle, find_common_circle
from stadimeter.detectors.ball.colours import BallColours
from stadimeter.detectors.ball.limb_edges import LimbEdges, limb_edges
from stadimeter.ranging.ball import MIN_RAYS, ConeFrame, SphereCone, with_ones

# Pixels read in the first look beyond where the limb may be, for the levels beside it.
BEYOND_PX = 2.5

# Least and greatest reach on either side of the circle of the last fit.
MIN_REACH_PX, MAX_REACH_PX = 6.0, 24.0

# Half of a step, and some room, must be within reach on either side of it.
REACH_OF_WIDTH = 0.6

# Pixels that must be left of the reach beside the step: the pixels that its levels are read from, and the rounding.
REACH_SPARE_PX = 4.0

# Once a circle was fitted, the limb is looked for so near to it: pixels, a share of the radius for an oblong outline,
# and a share of how wide the steps are. Further away is the edge of a hand or of what lies behind.
WITHIN_PX, WITHIN_SHARE, WITHIN_OF_WIDTH = 2.0, 0.06, 0.3

# Once it was fitted to steps between the ball's colours and others, so near: pixels, and a share of the radius.
NEAR_PX, NEAR_SHARE = 2.0, 0.02

# A limb is doubtful where a smaller share of the spokes has a step on it, or where these scatter by more: pixels, and a
# share of what blur adds to their width. The second share is that of a limb that is beyond doubt a ball's: a look by
# colour at those of which more is seen lowered no error of 900 rendered balls, and took a fifth of the mean time.
LOOK_SUPPORT, LOOK_SUPPORT_OF_SURE, LOOK_SCATTER_PX, LOOK_SCATTER_OF_BLUR = 0.85, 0.7, 0.25, 0.2

# A limb is as rough as any ball's if its steps scatter by this: pixels for noise, a share of the radius for felt and
# fingers, and a share of what blur adds to the width of a step. And how much of a limb is as good as less roughness.
ROUGH_PX, ROUGH_SHARE, ROUGH_OF_BLUR, WORTH_OF_ROUGH = 0.3, 0.07, 0.3, 1.2

# Greatest number of looks, each around the last fit, until the same steps are found.
MAX_LOOKS = 4

# Greatest number of reweighted fits of the cone; they end once the limit for outliers shrinks by less, nor
# where all steps are so near that they count fully.
ROUNDS, SETTLED_SHARE = 5, 0.8

# Steps no further from the cone than this always count fully: noise alone puts them there.
MIN_OUTLIER_PX = 0.25

# Steps further from the cone than this many of their usual distances are outliers.
OUTLIER_SIGMAS = 4.0

# Nor do steps further away than this, however far they usually are: pixels, a share of the radius for felt, and a
# share of what blur adds to their width.
OFF_PX, OFF_SHARE, OFF_OF_WIDTH = 1.0, 0.015, 0.6

# Of normal errors, 30 % are smaller than 0.385 standard deviations; more than half of the steps may be outliers.
RANK, RANK_SIGMAS = 0.3, 0.385

# A usual distance above the one, or a share of steps on the cone below the other, may be a fit to the wrong steps.
DOUBTFUL_PX = 0.3
DOUBTFUL_SHARE = 0.75

# Pieces of the limb, compared with each other to see how far the errors of neighbouring steps reach.
BLOCKS = 8

# Points of the outline from which its circle follows where the lens distorts.
OUTLINE_POINTS = 16

# Spokes cross the limb at up to 45 degrees, so steps are wider along them; this is the mean.
SQUARENESS = 1.11

# Width of a sharp step.
SHARP_PX = 2.6

# The standard deviation of a radius r is ``hypot(1.6 s, 0.01, 0.35 / r, (0.7 + u) e, 0.8 c)`` pixels. s is what the fit
# gives, with how far the errors of neighbouring steps reach taken from the frame itself; small balls suffer from what
# is behind them; felt, sharpening and a tone curve other than the assumed one move all steps alike, the more the more
# they scatter, e, and where a share u of the limb is not seen, a hand or what else hides it draws the rest to itself;
# colour that is stored more coarsely than brightness does so by 0.9 + u; and where looking by colour changed the radius
# by c, either may be wrong. Fitted to 3,700 rendered balls, with markings on floors and in hands, and plain ones on
# clutter under twenty troubles; the factors of e to 165 real ones, whose limbs err half as much again.
SIGMA_FACTOR = 1.6
SIGMA_FLOOR_PX = 0.01
SIGMA_SMALL_PX2 = 0.35
SIGMA_OF_SCATTER, SIGMA_OF_COARSE_CHROMA, SIGMA_OF_UNSEEN = 0.7, 0.9, 1.0
SIGMA_OF_CHANGE = 0.8


class Limb(Struct, frozen=True, kw_only=True, eq=False):
    """The limb of a ball."""

    cone: SphereCone  # the rays that touch the ball
    circle: ImageCircle  # the circle that comes nearest to the outline, as wide as its smaller diameter
    straight_radius_px: float  # that radius if the lens bent no lines
    points_px: Points  # the steps on it, shape ``(n, 2)``
    support: float  # the share of the spokes that have a step on it: how much of the limb is seen
    support_inside: float  # the same share of the spokes that do not leave the picture
    scatter_px: float  # standard deviation of these steps about it
    width_px: float  # how many pixels the steps take from inside to outside, the median, across the limb
    # Standard deviation of `straight_radius_px` if steps err by as much as they scatter, neighbouring ones alike as far
    # as is seen.
    sigma_px: float
    is_chroma_coarse: bool  # whether the camera stores colour more coarsely than brightness
    change_px: float = 0.0  # how far apart the radii of several looks are

    def is_doubtful(self, *, is_sure: bool = False) -> bool:
        """Check whether its steps may be those of a pattern, of the floor or of a hand.

        Args:
            is_sure: Whether it is beyond doubt a ball's.
        """
        usual_px = LOOK_SCATTER_PX + LOOK_SCATTER_OF_BLUR * max(0.0, self.width_px - SHARP_PX)
        return self.scatter_px > usual_px or self.support_inside < (LOOK_SUPPORT_OF_SURE if is_sure else LOOK_SUPPORT)

    @property
    def roughness(self) -> float:
        """Scatter of its steps, as a share of what is usual at most: 0 for a perfect outline."""
        usual_px = ROUGH_PX + ROUGH_SHARE * self.circle.radius_px
        return self.scatter_px / (usual_px + ROUGH_OF_BLUR * max(0.0, self.width_px - SHARP_PX))

    @property
    def worth(self) -> float:
        """Strength of its support: the share of the spokes with a step on it, less for those that lie beside it."""
        return self.support - WORTH_OF_ROUGH * self.roughness

    @property
    def radius_sigma_px(self) -> float:
        """Standard deviation of the radius."""
        of_scatter = SIGMA_OF_COARSE_CHROMA if self.is_chroma_coarse else SIGMA_OF_SCATTER
        return math.hypot(
            SIGMA_FACTOR * self.sigma_px,
            SIGMA_FLOOR_PX,
            SIGMA_SMALL_PX2 / self.circle.radius_px,
            (of_scatter + SIGMA_OF_UNSEEN * (1 - self.support_inside)) * self.scatter_px,
            SIGMA_OF_CHANGE * self.change_px,
        )


def find_limb(
    image: Image, circle: ImageCircle, within_px: float, lens: CameraModel, colours: BallColours | None = None
) -> Limb | None:
    """Fit the limb near an expected circle, then around where the fit put it; None with too few steps.

    Without colours it goes by brightness alone. Where that is doubtful, since steps scatter or too few are on one limb,
    `look_again.look_by_colour` may know better.
    """
    # Invariant: the result does not depend on where the search began. So the spokes are laid again around each fit
    # until the part of the picture that they cover holds the whole of every step.
    limb, reach_px = None, within_px + BEYOND_PX
    for looks in range(MAX_LOOKS):
        edges = limb_edges(image, circle, reach_px, within_px, lens, colours)
        found = None if edges is None else _fit_limb(edges, circle, lens)
        if edges is None or found is None:
            # Of a ball that the border cuts off, the oblong outline may be lost around the circle of its fit.
            break
        limb = found
        # How far the spokes that were read are now from where they should be, in place and radius together; a pixel to
        # spare.
        moved_px = math.hypot(limb.circle.x_px - circle.x_px, limb.circle.y_px - circle.y_px) + abs(
            limb.circle.radius_px - circle.radius_px
        )
        needed_px = _reach_px(edges, limb)
        # Nor are there more where a fit is rough and of little of a circle: it wanders among other edges, and looks a
        # little more like a limb by chance at one of many places.
        if moved_px + needed_px <= reach_px + 1.0 or (looks and limb.support_inside < WORTH_OF_ROUGH * limb.roughness):
            break
        circle, reach_px = limb.circle, min(max(needed_px + 1.0, MIN_REACH_PX), MAX_REACH_PX)
        within_px = min(reach_px, within(circle) + WITHIN_OF_WIDTH * limb.width_px)
    return limb


def near_px(limb: Limb) -> float:
    """Return the largest distance of steps from a limb that was fitted by colour."""
    felt_px = NEAR_SHARE * limb.circle.radius_px
    return NEAR_PX + felt_px + _oblong_px(limb) + WITHIN_OF_WIDTH * max(0.0, limb.width_px - SHARP_PX)


def within(circle: ImageCircle) -> float:
    """Return the largest distance of the limb from a circle that was fitted to it."""
    return WITHIN_PX + WITHIN_SHARE * circle.radius_px


def _reach_px(edges: LimbEdges, limb: Limb) -> float:
    """Return the distance to look from the limb to see its steps whole, on an outline that is no circle."""
    return min(REACH_SPARE_PX + REACH_OF_WIDTH * edges.wide_width_px + _oblong_px(limb), MAX_REACH_PX)


def _oblong_px(limb: Limb) -> float:
    """Return the reach of the outline, which is an ellipse away from the optical axis, beyond its circle."""
    # The ellipse's axes differ by the factor 1 / cos θ to first order, θ off the optical axis; z is cos θ.
    z = limb.cone.axis[2]
    return limb.circle.radius_px * (1 / z - 1) if z > 0 else 0.0


def _fit_limb(edges: LimbEdges, circle: ImageCircle, lens: CameraModel) -> Limb | None:
    count = edges.places.shape[1]
    if count < MIN_RAYS:
        return None
    frame = _cone_frame(edges, circle, lens)
    max_px = _max_miss_px(circle, edges)
    # Least squares first: with few outliers, reweighting finds them. Where too many steps miss the cone, least squares
    # may have settled between the limb and another edge; then the fit starts again from the circle of most votes.
    fit = _fit_robustly(frame, frame.fit(), lens, max_px)
    if fit is None or fit.usual_px > DOUBTFUL_PX or fit.steps < DOUBTFUL_SHARE * count:
        points = edges.points_px
        common = find_common_circle(points)
        if common is not None:
            # Weights of 1 near the circle of most votes and 0 elsewhere; 5 % of the radius allow for the ellipse off
            # the axis.
            near = np.abs(np.hypot(points[:, 0] - common.x_px, points[:, 1] - common.y_px) - common.radius_px)
            again = _fit_robustly(
                frame, frame.fit(np.where(near < 0.05 * common.radius_px + 1.0, 1.0, 0.0)), lens, max_px
            )
            fit = _pick_better(fit, again)
    return None if fit is None else _limb(fit, edges, lens)


def _cone_frame(edges: LimbEdges, circle: ImageCircle, lens: CameraModel) -> ConeFrame:
    """Return the rays to the steps, as seen along the one to the middle of the circle."""
    # Directions are x and y per unit of depth. Without distortion rays are linear in pixels, so the pixels go in as
    # they are and one small matrix takes them to the frame of the cone; with distortion each has to be undone first.
    towards = lens.direction(circle.x_px, circle.y_px)
    if lens.distortion:
        return ConeFrame(with_ones(lens.directions(edges.points_px)), towards)
    return ConeFrame(edges.places, towards, lens)


def _max_miss_px(circle: ImageCircle, edges: LimbEdges) -> float:
    """Return the largest distance that steps may have from the cone: felt and blur spread them."""
    return OFF_PX + OFF_SHARE * circle.radius_px + OFF_OF_WIDTH * max(0.0, edges.usual_width_px - 3.0)


class _ConeFit(NamedTuple):
    """A cone, how far outside it each step lies, which steps are on it, how many, and how far they usually are."""

    cone: SphereCone
    misses_px: Values
    on_it: Flags
    steps: int
    usual_px: float


def _fit_robustly(frame: ConeFrame, cone: SphereCone | None, lens: CameraModel, max_px: float) -> _ConeFit | None:
    """Fit a cone again with Tukey's weights, until what belongs to it is settled."""
    last_px = math.inf
    for _ in range(ROUNDS):
        if cone is None:
            return None
        misses = frame.misses(cone, _pixels_a_radian(cone, lens))
        # Iteratively reweighted least squares: the limit follows from the scatter of the last fit.
        usual, limit, furthest = _limits(misses, max_px)
        if limit > SETTLED_SHARE * last_px or furthest < MIN_OUTLIER_PX:
            break
        last_px = limit
        # Tukey's biweight: (1 - (miss / limit)²)², and nothing beyond the limit.
        weights = misses * (1 / limit)
        weights *= weights
        np.subtract(1.0, weights, out=weights)
        np.maximum(weights, 0.0, out=weights)
        weights *= weights
        cone = frame.fit(weights)
    if cone is None:
        return None
    on_it = np.abs(misses) < limit
    return _ConeFit(cone, misses, on_it, int(np.count_nonzero(on_it)), usual)


def _limits(misses: Values, max_px: float) -> tuple[float, float, float]:
    """Return the usual distance of steps from the cone, that from which on they are not of it, and the largest."""
    # Robust scale: the 30th percentile of |miss| in place of the median, so that more than half of the steps may lie
    # elsewhere; 0.385 makes it a standard deviation for normal errors.
    ordered = np.abs(misses)
    ordered.sort()
    usual = float(ordered[int(RANK * len(ordered))]) / RANK_SIGMAS
    return usual, min(max(OUTLIER_SIGMAS * usual, MIN_OUTLIER_PX), max_px), float(ordered[-1])


def _pick_better(one: _ConeFit | None, other: _ConeFit | None) -> _ConeFit | None:
    """Return the fit with more steps that lie closer to it."""
    if one is None or other is None:
        return one or other

    def worth(fit: _ConeFit) -> float:
        return float(np.maximum(1 - (fit.misses_px / 1.0) ** 2, 0.0).sum())

    return one if worth(one) >= worth(other) else other


def _pixels_a_radian(cone: SphereCone, lens: CameraModel) -> float:
    """Return the pixels that an angle across the cone takes in the picture: away from the optical axis more."""
    # An angle dα moves a place at θ off the axis by f dα / cos² θ radially and f dα / cos θ across: the geometric mean
    # is f / cos^1.5 θ. z below 0.1 (84 degrees off) is beyond any lens here.
    return math.sqrt(lens.fx_px * lens.fy_px) / math.pow(max(cone.axis[2], 0.1), 1.5)


def _limb(fit: _ConeFit, edges: LimbEdges, lens: CameraModel) -> Limb | None:
    steps, cone = fit.steps, fit.cone
    if steps < MIN_RAYS or not (math.isfinite(cone.half_across) and cone.axis[2] > 0.1):
        return None
    # Scatter with n - 3 degrees of freedom: the cone has three unknowns. Misses are in pixels, outside positive.
    misses = fit.misses_px.compress(fit.on_it)
    squared = float(misses.dot(misses))
    scatter = math.sqrt(squared / max(1, steps - 3))
    circle = _outline_circle(cone, lens)
    straight_radius_px = cone.half_across * math.sqrt(lens.fx_px * lens.fy_px)
    return Limb(
        cone=cone,
        circle=circle,
        straight_radius_px=straight_radius_px,
        points_px=edges.places[:2].compress(fit.on_it, axis=1).T,
        # Spokes beyond the border count in `support`, not in `support_inside`.
        support=steps / edges.spokes,
        support_inside=steps / edges.inside,
        scatter_px=scatter,
        width_px=edges.usual_width_px / SQUARENESS,
        # σ of the radius: `sine_share` is that of sin α for rays that err by one radian each on its own, so times the
        # radius (in pixels) and the scatter (in radians: pixels over pixels a radian), times the root of how much
        # neighbours err together. Residual over root n alone held 3 to 25 % of errors in its 95 % interval.
        sigma_px=cone.sine_share
        * straight_radius_px
        * scatter
        * math.sqrt(_correlation(misses, squared))
        / _pixels_a_radian(cone, lens),
        is_chroma_coarse=lens.chroma_pitch_px != (1, 1),
    )


def _correlation(misses: Values, squared: float) -> float:
    """Return the variance of the mean of the steps, as a multiple of that of independent ones; no less than 1.

    A finger, a stripe or the grain of a floor moves neighbouring steps the same way. So the sums over `BLOCKS` pieces
    of the limb vary more than those of independent steps would. Three of them are taken by the fit.
    """
    # Of B sums of independent steps, the fit of three unknowns takes three: E[Σ sum²] = Σ miss² (B - 3) / B.
    blocks = min(BLOCKS, len(misses) // 2)
    if blocks <= 3 or squared <= 0:
        return 1.0
    sums = np.add.reduceat(misses, _block_starts(len(misses), blocks))
    return max(1.0, float(sums.dot(sums)) / squared * blocks / (blocks - 3))


@lru_cache(maxsize=128)
def _block_starts(steps: int, blocks: int) -> Indices:
    return np.arange(blocks) * steps // blocks


def _outline_circle(cone: SphereCone, lens: CameraModel) -> ImageCircle:
    """Return the circle that comes nearest to the outline in the picture."""
    if not lens.distortion:
        x, y = cone.outline_centre
        return ImageCircle(
            x_px=x * lens.fx_px + lens.cx_px,
            y_px=y * lens.fy_px + lens.cy_px,
            radius_px=cone.half_across * math.sqrt(lens.fx_px * lens.fy_px),
        )
    x_px, y_px = lens.project(np.array([cone.outline_centre]))[0].tolist()
    # Distorted, the outline is no ellipse: the nearest of 16 points stands for the smaller half axis.
    points = lens.project(cone.outline(OUTLINE_POINTS))
    radius_px = float(np.hypot(points[:, 0] - x_px, points[:, 1] - y_px).min())
    return ImageCircle(x_px=x_px, y_px=y_px, radius_px=radius_px)
