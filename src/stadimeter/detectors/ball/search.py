"""The search for a ball in a picture: in blobs of its colour, in circles of edges, and where it is expected.

What is found says nothing yet: every limb is weighed (`evidence`), and the best of all is the ball. Searches are branch
and bound: they end where nothing that is left could be better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace

from stadimeter.core.detection import Flags, Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import Blob, ImageCircle, find_common_circle, learn_colours, thin_out
from stadimeter.detectors.ball.evidence import (
    FILLED_ENOUGH,
    LIKELY,
    POSSIBLE_SMALL,
    SURE,
    BallScene,
    FoundBall,
    hope,
    touches_border,
    weigh,
)
from stadimeter.detectors.ball.limb import Limb, find_limb, near_px, within
from stadimeter.detectors.sampling import Region
from stadimeter.ranging.ball import MIN_RAYS

# Circles of edges anywhere in a picture: where a ball of unknown colour may be.
#
# Each edge votes for the centres that lie along its gradient, to both sides (the Hough transform with gradients: C.
# Kimme, D. Ballard and J. Sklansky, 1975). Edges are those of brightness or of saturation, whichever are steeper: a
# silver ball on grass is as bright as that, and grey. Each level of a picture pyramid has votes for one octave of
# radii, so that cells and the number of votes fit the size of the circle, and the grain of a floor is averaged out
# for larger balls. The highest counts are fitted to their edges and ranked by how many directions show one.

# Longer side to which a larger picture is reduced, and the least shorter side of the last level.
VOTING_WIDTH_PX, MIN_LEVEL_PX = 320, 24

# Share and number of the pixels of a level that vote at most, and least steepness of their edges, in levels of 8 bits a
# pixel. With half of the share, 9 of 400 silver balls fewer were proposed, most of them before clutter.
VOTING_SHARE, MAX_VOTING, MIN_STEEPNESS = 0.12, 4600, 1.5

# One pixel of so many is looked at to tell how steep the steepest edges are: prime, so that no column is preferred.
SAMPLED = 7

# Added to the brightest channel when the saturation is taken: noise of dark pixels has any.
DARK = 32

# Radii in pixels of a level that are voted for: an octave, each within a cell of the next. With five, as many balls
# were proposed. And the largest that is fitted, as a multiple of the last.
RADII_PX = np.array([5.4, 6.7, 8.3], np.float32)
FITTED_REACH = 1.2

# Width of the border around a level in which there may be centres.
BORDER = 10

# Half the side of the square whose votes are what chance brings.
AROUND = 9

# Number of the highest counts of each level that circles are fitted to.
PEAKS = 3

# An edge is on a circle if its gradient is this near to radial (a cosine), and it is this near to it, in pixels of the
# level and as a share of the radius: first, and once the circle is fitted.
RADIAL, NEAR_PX, NEAR_SHARES = 0.92, 0.5, (0.14, 0.04)

# Directions from the centre in which edges are counted, and the least number of them that the share of edges near the
# circle that are radial leaves. With 9 in place of 7.5 a circle less was proposed in an empty picture, and of 400
# silver balls 9 fewer.
SECTORS, MIN_LIKENESS = 24, 7.5

# With fewer edges near it a circle is left as it was.
MIN_FITTED = 4

# Circles with their centres nearer than this share of the radius and with radii as alike are the same one.
SAME_SHARE = 0.3


class Octave(NamedTuple):
    """A level of the pyramid, for circles of radii up to twice the smallest."""

    picture: Image
    step: float  # the side of its pixels, in pixels of the whole picture

    @property
    def min_radius_px(self) -> float:
        """The radius of the smallest circle that is meant, in pixels of the whole picture."""
        return float(RADII_PX[0]) / FITTED_REACH * self.step

    @property
    def max_radius_px(self) -> float:
        """The radius of the largest circle that is meant, in pixels of the whole picture."""
        return float(RADII_PX[-1]) * FITTED_REACH * self.step


class CircleProposal(NamedTuple):
    """A circle, and how much it is like an outline: up to `SECTORS`."""

    likeness: float
    circle: ImageCircle


class _Edges(NamedTuple):
    """Edges of a level, shape ``(n,)`` each: places, and directions of their gradients of length 1."""

    x: Profiles
    y: Profiles
    across: Profiles
    down: Profiles


def list_octaves(image: Image) -> list[Octave]:
    """Return the levels of the pyramid, that of the largest circles first."""
    # Leaving out pixels first costs less than their mean, which the reduction to the first level takes.
    step, found = max(1.0, max(image.shape[:2]) / VOTING_WIDTH_PX), list[Octave]()
    picture = thin_out(image, max(1, int(step / 2)))
    height, width = (round(side / step) for side in image.shape[:2])
    while min(height, width) >= MIN_LEVEL_PX:
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        found.append(Octave(picture, step))
        picture = picture[: height // 2 * 2, : width // 2 * 2]
        height, width, step = height // 2, width // 2, 2 * step
    return found[::-1]


def propose_circles(octave: Octave) -> list[CircleProposal]:
    """Return the circles of an octave that are like an outline, the best first."""
    edges = _find_edges(octave.picture)
    if len(edges.x) < SECTORS:
        return []
    circles, likeness = _fit(edges, _highest(edges, octave.picture.shape))
    # Pixels of a level are the means of `step` by `step` others.
    circles = circles * octave.step + np.array([octave.step - 1, octave.step - 1, 0.0]) / 2
    found: list[CircleProposal] = []
    for like, (x, y, radius) in sorted(zip(likeness.tolist(), circles.tolist(), strict=True), reverse=True):
        circle = ImageCircle(x_px=x, y_px=y, radius_px=radius)
        if like >= MIN_LIKENESS and not any(are_same(circle, each.circle) for each in found):
            found.append(CircleProposal(like, circle))
    return found


def _find_edges(picture: Image) -> _Edges:
    """Return the strongest edges of a level, each where it is steepest."""
    across, down, squared = _gradients(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8))
    of_saturation = _gradients(_saturation(picture))
    steeper = (of_saturation[2] > squared).view(np.uint8)
    for plane, other in zip((across, down, squared), of_saturation, strict=True):
        cv2.copyTo(other, steeper, plane)
    width, flat = squared.shape[1], squared.ravel()
    is_edge, inner = _steepest(across, down, squared), flat[width:-width]
    # A sample tells how steep the edges are that many of all are steeper than.
    some, most = inner[::SAMPLED][is_edge[::SAMPLED]], min(int(VOTING_SHARE * len(flat)), MAX_VOTING) // SAMPLED
    if len(some) > most:
        is_edge &= inner > np.partition(some, len(some) - 1 - most)[len(some) - 1 - most]
    at = np.flatnonzero(is_edge) + width
    per_length = (1 / np.sqrt(flat[at])).astype(np.float32)
    y, x = np.divmod(at.astype(np.int32), width)
    x, y = x.astype(np.float32), y.astype(np.float32)
    return _Edges(x, y, across.ravel()[at] * per_length, down.ravel()[at] * per_length)


def _saturation(picture: Image) -> Image:
    blue, green, red = cv2.split(picture)
    most, least = cv2.max(blue, cv2.max(green, red)), cv2.min(blue, cv2.min(green, red))
    brightness = cv2.convertScaleAbs(most, beta=DARK)
    return np.asarray(cv2.divide(cv2.subtract(most, least), brightness, scale=255), np.uint8)


def _gradients(plane: Image) -> tuple[Profiles, Profiles, Profiles]:
    """Return eight times the steepness across and down, and the square of both; 0 at the border."""
    across, down = (each.astype(np.float32) for each in cv2.spatialGradient(plane))
    squared = across * across
    squared += down * down
    squared[0] = squared[-1] = 0
    squared[:, 0] = squared[:, -1] = 0
    return across, down, squared


def _steepest(across: Profiles, down: Profiles, squared: Profiles) -> Flags:
    """Return which pixels are steeper than those before and behind them, all rows but the first and the last, flat."""
    width, flat = squared.shape[1], squared.ravel()
    here, count = flat[width:-width], len(flat)
    # Masks are joined by bits: to choose by one of them takes twenty times as long.
    is_upright = (np.abs(across[1:-1]) > np.abs(down[1:-1])).ravel()
    beside = (here >= flat[width - 1 : count - width - 1]) & (here > flat[width + 1 : count - width + 1])
    above = (here >= flat[: -2 * width]) & (here > flat[2 * width :])
    return ((beside & is_upright) | (above & ~is_upright)) & (here > (8 * MIN_STEEPNESS) ** 2)


def _highest(edges: _Edges, shape: tuple[int, ...]) -> Values:
    """Return the circles with the most votes as x, y, radius, shape ``(PEAKS, 3)``."""
    height, width = shape[0] + 2 * BORDER, shape[1] + 2 * BORDER
    off = np.rint(RADII_PX[:, None] * edges.down) * width + np.rint(RADII_PX[:, None] * edges.across)
    middle = (edges.y + BORDER) * width + edges.x + BORDER
    cells = np.concatenate([middle + off, middle - off], axis=1).astype(np.intp)
    votes = [np.bincount(each, minlength=height * width).astype(np.uint8).reshape(height, width) for each in cells]
    sums = np.stack([cv2.boxFilter(each, -1, (3, 3), normalize=False) for each in votes])
    # What the middle radius shows around there is expected of all; its root is the standard deviation of counts.
    around = (2 * AROUND + 1, 2 * AROUND + 1)
    usual = 9 * np.asarray(cv2.boxFilter(votes[len(votes) // 2], cv2.CV_32F, around), np.float32)
    worth = (sums.max(axis=0) - usual) / np.sqrt(usual + 0.9)
    worth = worth[BORDER:-BORDER, BORDER:-BORDER]
    found = []
    for _ in range(PEAKS):
        _, _, _, (column, row) = cv2.minMaxLoc(worth)
        radius = RADII_PX[sums[:, row + BORDER, column + BORDER].argmax()]
        found.append((column, row, radius))
        worth[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = -np.inf
    return np.array(found, np.float64)


def _fit(edges: _Edges, circles: Values) -> tuple[Values, Values]:
    """Return circles fitted to the edges near them, and how much each is like an outline."""
    x, y = edges.x - circles[:, :1].astype(np.float32), edges.y - circles[:, 1:2].astype(np.float32)
    squared, radii = x * x + y * y, circles[:, 2:].astype(np.float32)
    reach = NEAR_SHARES[0] * radii + NEAR_PX
    row, near_it = np.nonzero((squared > (radii - reach) ** 2) & (squared < (radii + reach) ** 2))
    edge_x, edge_y, across, down = (each[near_it].astype(np.float64) for each in edges)
    for share in NEAR_SHARES:
        centre_x, centre_y, radius = circles.T.take(row, axis=1)
        x, y = edge_x - centre_x, edge_y - centre_y
        apart = np.hypot(x, y)
        near = np.abs(apart - radius) < share * radius + NEAR_PX
        on_it = near & (np.abs(x * across + y * down) > RADIAL * apart)
        circles = _fit_kasa(circles, np.where(on_it & (row == np.arange(len(circles))[:, None]), 1.0, 0.0), x, y)
    turns = np.arctan2(y[on_it], x[on_it]) / (2 * np.pi) + 0.5
    cells = row[on_it] * SECTORS + (turns * SECTORS).astype(np.intp) % SECTORS
    seen = (np.bincount(cells, minlength=len(circles) * SECTORS).reshape(-1, SECTORS) > 0).sum(axis=1)
    on_it_each, near_each = (np.bincount(row[each], minlength=len(circles)) for each in (on_it, near))
    return circles, np.asarray(seen * on_it_each / np.maximum(near_each, 1), np.float64)


def _fit_kasa(circles: Values, on_it: Values, x: Values, y: Values) -> Values:
    """Fit each circle to its edges, with weights, by least squares of ``x² + y² = a x + b y + c`` (I. Kåsa, 1976)."""
    design = np.stack([x, y, np.ones(len(x))])
    # All sums of the normal equations of all circles are one product.
    products = np.concatenate([(design[:, None] * design).reshape(9, -1), design * (x * x + y * y)])
    sums = on_it @ products.T
    matrix = sums[:, :9].reshape(-1, 3, 3) + 1e-3 * np.eye(3)
    a, b, c = np.linalg.solve(matrix, sums[:, 9:, None])[..., 0].T
    radius = np.sqrt(np.maximum(c + (a * a + b * b) / 4, 1.0))
    fitted = np.stack([circles[:, 0] + a / 2, circles[:, 1] + b / 2, radius], axis=1)
    return np.where(sums[:, 8:9] >= MIN_FITTED, fitted, circles)


def are_same(one: ImageCircle, other: ImageCircle) -> bool:
    """Check whether two circles are of one outline."""
    off_px = max(abs(one.x_px - other.x_px), abs(one.y_px - other.y_px), abs(one.radius_px - other.radius_px))
    return off_px < SAME_SHARE * max(one.radius_px, other.radius_px)


# Looks at limbs: a first one by steps alone, and others by colour where that leaves doubt -----------

# Greatest number of looks for steps between the ball's colours and others at a doubtful limb, and the most evidence
# that they add: where that would not be enough, no look is worth its time.
LOOKS_BY_COLOUR, MAX_GAIN = 2, 4.0

# A look that is supported nearly as well as the best one may be right as well.
RIVAL_WORTH = 0.2


def look_again(scene: BallScene, ball: FoundBall, within_px: float) -> FoundBall:
    """Return a doubtful ball by colour; as it is where that can make it neither possible nor better than the best."""
    best = scene.best
    if ball.evidence + MAX_GAIN < POSSIBLE_SMALL or (best is not None and ball.rank + MAX_GAIN < best.rank):
        return ball
    return weigh(scene, look_by_colour(scene, ball.limb, within_px))


def look_by_colour(scene: BallScene, best: Limb, within_px: float) -> Limb:
    """Return the best supported limb of the first one and those found by colour, and how much they differ."""
    limb, looks = best, [best]
    for _ in range(LOOKS_BY_COLOUR):
        # Colours are learnt anew around each limb that was found: the first one may include a finger or the shadow.
        # Looks by colour brought the 95th percentile of the error on marked balls from 4.6 to 2.8 %, and cost nothing
        # where the first limb is beyond doubt.
        colours = learn_colours(scene.image, limb.circle)
        found = None if colours is None else find_limb(scene.image, limb.circle, within_px, scene.lens, colours)
        if found is None:
            break
        limb, within_px = found, near_px(found)
        looks.append(limb)
        best = limb if limb.worth >= best.worth else best
        if not limb.is_doubtful() or max(hope(scene, each) for each in looks) < POSSIBLE_SMALL:
            break
    # Looks that are nearly as well supported but disagree: their spread becomes part of σ (0.8 of it, see
    # `Limb.radius_sigma_px`).
    radii_px = [each.straight_radius_px for each in looks if each.worth >= best.worth - RIVAL_WORTH]
    return replace(best, change_px=max(radii_px) - min(radii_px))


# The search: from blobs, from circles, and from where the ball is expected --------------------------------------------

# Reach of the search for the limb on either side of a blob's circle: pixels, or cells and a half of the search.
FIRST_REACH_PX, REACH_OF_STEP = 8.0, 1.5

# Greatest radius of a ball that a blob leads to, in half sizes of the blob.
WITHIN_REACH = 1.2

# A blob that covers a smaller share of the circle around it is the grain of wood, a joint or a rim.
MIN_FILL = 0.2

# Half the side of the square within a circle, as a share of its radius, and half of how many cells it is looked at in.
WITHIN_SQUARE, FEW_CELLS = 0.7, 12

# Number of points of an outline, evenly spaced, that tell its circle.
MAX_POINTS = 60

# A blob whose circle is wider than a limb by no more than these cells to either side is the ball and nothing else.
MAX_CELLS_MORE = 0.75


def search_blobs(scene: BallScene, blobs: Sequence[Blob]) -> None:
    """Weigh the limb around each blob, the largest first, and look again at those that leave doubt."""
    doubts: list[tuple[FoundBall, float]] = []
    for blob in blobs:
        if scene.is_settled(WITHIN_REACH * blob.circle.radius_px):
            break
        reach_px = max(FIRST_REACH_PX, REACH_OF_STEP * blob.step)
        is_worth_it = blob.fill >= MIN_FILL or touches_border(blob.circle, scene.image)
        limb = find_limb(scene.image, _start(scene, blob), reach_px, scene.lens) if is_worth_it else None
        if limb is None:
            continue
        # A second look takes several times as long as the first, so what is sure without comes first.
        is_alike = (
            blob.fill >= FILLED_ENOUGH and limb.circle.radius_px > blob.circle.radius_px - MAX_CELLS_MORE * blob.step
        )
        ball = weigh(scene, limb, is_alike=is_alike)
        if limb.is_doubtful(is_sure=ball.evidence >= SURE):
            doubts.append((ball, reach_px))
        else:
            scene.seen.append(ball)
    for ball, reach_px in sorted(doubts, key=lambda doubt: -doubt[0].rank):
        scene.seen.append(look_again(scene, ball, reach_px))


def _start(scene: BallScene, blob: Blob) -> ImageCircle:
    """Return the circle around a blob; of one that the border cuts off, the circle through most of its outline."""
    if not touches_border(blob.circle, scene.image):
        return blob.circle
    height, width = scene.image.shape[:2]
    outline_px = blob.outline_px
    outline_px = outline_px[
        ((outline_px >= blob.step) & (outline_px < np.array((width, height)) - 2 * blob.step)).all(1)
    ]
    # In cells of the search, since the outline is known to a cell.
    few_px = outline_px[:: max(1, len(outline_px) // MAX_POINTS)]
    found = find_common_circle(few_px / blob.step) if len(few_px) >= MIN_RAYS else None
    if found is None:
        return blob.circle
    x_px, y_px, radius_px = (each * blob.step for each in (found.x_px, found.y_px, found.radius_px))
    return ImageCircle(x_px=x_px, y_px=y_px, radius_px=radius_px)


def search_circles(scene: BallScene, max_radius_px: float = math.inf) -> None:
    """Weigh the circles of edges in all the picture that no limb was found at yet, the largest first."""
    for octave in list_octaves(scene.image):
        if scene.is_settled(octave.max_radius_px):
            break
        if octave.min_radius_px > max_radius_px:
            continue
        for circle in (each.circle for each in propose_circles(octave)):
            is_known = any(are_same(circle, ball.limb.circle) for ball in scene.seen if ball.evidence >= LIKELY)
            if not is_known and _has_colour(scene, circle):
                search_at(scene, circle, within(circle))


def _has_colour(scene: BallScene, circle: ImageCircle) -> bool:
    """Check whether the square within a circle shows some of the ball's colour; whether it is in the picture."""
    inside = Region.around((circle.x_px, circle.y_px), WITHIN_SQUARE * circle.radius_px, scene.image)
    if inside is None or scene.colour is None:
        return inside is not None
    few = thin_out(inside.of(scene.image), max(1, int(circle.radius_px / FEW_CELLS)))
    return cv2.countNonZero(scene.colour.in_other_light.mask(few)) > 0


def search_at(scene: BallScene, start: ImageCircle, reach_px: float) -> FoundBall | None:
    """Weigh the limb near a circle; None if there is none."""
    limb: Limb | None = find_limb(scene.image, start, reach_px, scene.lens)
    if limb is None:
        return None
    ball = weigh(scene, limb)
    scene.seen.append(look_again(scene, ball, reach_px) if limb.is_doubtful(is_sure=ball.evidence >= SURE) else ball)
    return scene.seen[-1]
