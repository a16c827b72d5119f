"""The place of the camera, from tags whose places are known: one estimate from all corners, with its covariance.

Each tag has two poses that its corners allow, mirrored about the line of sight; each of them puts the camera somewhere.
From there Gauss and Newton's method leads to the camera's pose that explains all corners of all tags best. Of two such
minima the likelier is taken, if it is likelier by far.

The corners are off by the noise of their edges and by how well each tag was placed: three coordinates and three turns,
each with its standard deviation. To first order such a tag's own error adds ``B P B'`` to the covariance of its
corners, which is the same as to estimate it beside the camera (B. Triggs et al., "Bundle adjustment: a modern
synthesis", 2000, section 6.1). What all tags have in common (the lens, the edge bias, the scale of the printer) is
estimated with the camera, each with a prior of its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import CameraPose, Landmarks, PlacedTag
from stadimeter.core.detection import Detection, Values
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.ranging.plane_pose import COORDINATES, plane_poses, rectangle

# Tags of known places as a picture shows them: where their corners are, and by what these may be off ---


class SeenLandmark(NamedTuple):
    """A tag of known place, and where it is in the picture."""

    tag: PlacedTag
    found: Detection


class LandmarkViews(NamedTuple):
    """Tags in a picture, ``n`` of them, with ``k`` things that they have in common."""

    corners_m: Values  # in the room, shape (n, 4, 3)
    arms_m: Values  # from the tag's centre, likewise
    seen: Values  # where the corners appear, x and y per unit of depth, shape (n, 8)
    noise: Values  # the covariance of these, shape (n, 8, 8)
    common: Values  # how these change with what is common to all tags, by a standard deviation each, shape (n, 8, k)
    size_sigma: float
    place_variances: Values  # of a tag's three coordinates and three turns

    def of(self, chosen: Sequence[int]) -> LandmarkViews:
        """Return some of the tags."""
        which = list(chosen)
        return self._replace(**{name: getattr(self, name)[which] for name in self._fields[:5]})


def tag_axes(tag: PlacedTag) -> Values:
    """Return a tag's axes in the room as columns: to its right, to its top, and its normal."""
    normal = np.array(tag.normal)
    sine = math.sin(tag.tilt_rad)
    up = np.array((-sine * math.cos(tag.facing_rad), -sine * math.sin(tag.facing_rad), math.cos(tag.tilt_rad)))
    right = np.cross(up, normal)
    roll_sine, roll_cosine = math.sin(tag.roll_rad), math.cos(tag.roll_rad)
    return np.column_stack((roll_cosine * right - roll_sine * up, roll_cosine * up + roll_sine * right, normal))


def views_of(seen: Sequence[SeenLandmark], landmarks: Landmarks, camera: CameraModel) -> LandmarkViews:
    """Return tags as a picture shows them, through a camera model at its resolution."""
    corners_px = np.array([each.found.outline_px for each in seen])
    arms_m = np.array([rectangle(each.tag.side_m, each.tag.side_m) @ tag_axes(each.tag).T for each in seen])
    per_px = np.tile((1 / camera.fx_px, 1 / camera.fy_px), 4)
    moved, turned = _moved_by_sides(corners_px)
    # The length of a tag's side is the difference of two lines, so each is off by its part of the square root of two.
    # The ends of a line that is fitted to evenly spread steps are off by √3 times as much as its middle, besides.
    sigmas_px = np.array([max(each.found.size_sigma_px, 1e-3) / math.sqrt(2) for each in seen])
    spread = np.concatenate((moved, math.sqrt(3) * turned), axis=2) * sigmas_px[:, None, None] * per_px[:, None]
    edge_bias = (moved.sum(axis=2) * per_px * camera.edge_bias_sigma_px)[:, :, None]
    place = [landmarks.place_sigma_m**2] * 3 + [landmarks.facing_sigma_rad**2] * 3
    return LandmarkViews(
        corners_m=arms_m + np.array([each.tag.position_m for each in seen])[:, None],
        arms_m=arms_m,
        seen=camera.directions(corners_px.reshape(-1, 2)).reshape(-1, 8),
        noise=spread @ spread.transpose(0, 2, 1),
        common=np.concatenate((_of_lens(corners_px, camera), edge_bias), axis=2),
        size_sigma=landmarks.size_relative_sigma,
        place_variances=np.array(place),
    )


def _moved_by_sides(corners_px: Values) -> tuple[Values, Values]:
    """Return the motion of corners, shape (n, 4, 2), as a side moves out by a pixel, and as it turns about its middle.

    A corner is where two sides meet: when one moves, it slides along the other. Shapes (n, 8, 4).
    """
    sides = np.roll(corners_px, -1, axis=1) - corners_px
    sides = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-9)
    outwards = np.stack((sides[:, :, 1], -sides[:, :, 0]), axis=2)
    ends: Values = np.zeros((2, len(corners_px), 4, 2, 4))  # end of a side, tag, corner, x and y, side
    side = np.arange(4)
    for end, corner in ((0, side), (1, (side + 1) % 4)):
        along = np.roll(sides, -1 if end else 1, axis=1)
        sine = (outwards * along).sum(axis=2, keepdims=True)
        ends[end][:, corner, :, side] = (along / sine).swapaxes(0, 1)
    first, second = ends.reshape(2, -1, 8, 4)
    return first + second, first - second


def _of_lens(corners_px: Values, camera: CameraModel) -> Values:
    """Return the change of directions with each part of the lens that is unsure by itself, by a standard deviation."""
    slopes = camera.sensitivities(corners_px.reshape(-1, 2))[:, 1:]
    if camera.uncertainty is None:  # only the share by which both focal lengths may be wrong is known
        both = slopes[:, :, 0] * camera.fx_px + slopes[:, :, 1] * camera.fy_px
        return np.asarray((both * camera.focal_relative_sigma).reshape(-1, 8, 1))
    values, vectors = np.linalg.eigh(camera.uncertainty.covariance())
    return np.asarray((slopes @ (vectors * np.sqrt(values.clip(0.0)))).reshape(-1, 8, len(values)))


def starts_of(seen: SeenLandmark, camera: CameraModel) -> list[tuple[Values, Values]]:
    """Return the positions and turns of the camera that the two poses of a tag give."""
    tag, axes = seen.tag, tag_axes(seen.tag)
    found = []
    for pose in plane_poses(rectangle(tag.side_m, tag.side_m), camera.directions(seen.found.outline_px)):
        # The tag's axes are known in the room and in the camera's frame; what takes one to the other is the turn.
        turn = axes @ np.array((pose.right, pose.up, pose.normal))
        found.append((np.array(tag.position_m) - turn @ np.array(pose.position_m), turn))
    return found


# The pose of the camera, from all tags in sight but for those that have moved -----------------------------------------

# Steps of the fit, and halvings of a step that makes things worse. The last step takes less than this off chi-square;
# of a bad fit, off chi-square per coordinate.
MAX_STEPS, MAX_HALVINGS, SETTLED = 12, 4, 1e-4

# The fit starts from the two poses of the largest tag, and of the next if these lead to no good fit.
TAGS_TO_START_FROM = 2

# Chi-squares of a good fit lie below this many standard deviations of their distribution, and those of one tag below
# the second: by chance they are beyond once in 44, and once in 100,000 times.
SUSPECT, MOVED = 2.0, 4.26

# Chi-square per degree of freedom from which tags contradict each other: corners off by three times what is known.
CONTRADICTION = 9.0

# Another pose counts as possible from this probability on, and as another one if it is further away, in standard
# deviations.
POSSIBLE, APART = 0.01, 3.0

# Fits that end nearer to each other, in standard deviations, are one.
SAME = 0.5

# How far from its stated height and tilt a camera is, on wheels and grass; and how fast it may move and turn.
HEIGHT_SIGMA_M, TILT_SIGMA_RAD = 0.05, math.radians(3)
SPEED_MPS, TURN_RADPS, BEFORE_MAX_S = 1.0, 1.0, 0.5


# Takes x, y and z to the matrix of the cross product, row by row.
SKEW = np.array(((0, 0, 0, 0, 0, -1, 0, 1, 0), (0, 0, 1, 0, 0, 0, -1, 0, 0), (0, -1, 0, 1, 0, 0, 0, 0, 0)), np.float64)


class ExpectedPose(NamedTuple):
    """The camera's pose as known before a picture: it chooses between mirrored poses and does nothing else."""

    viewpoint: Viewpoint
    before: CameraPose | None = None  # the last pose that was known

    def misfit(self, fit: _Fit, at_s: float) -> float:
        """Return the misfit of a pose to what is expected, as a chi-square."""
        square = 0.0
        if self.viewpoint.height_m is not None:
            off_m = fit.position_m[2] - self.viewpoint.height_m
            off_rad = math.asin(max(-1.0, min(1.0, fit.turn[2, 2]))) - self.viewpoint.tilt_rad
            square += (off_m / HEIGHT_SIGMA_M) ** 2 + (off_rad / TILT_SIGMA_RAD) ** 2
        before = self.before
        if before is None or before.position_m is None or not 0 < at_s - before.captured_at_s <= BEFORE_MAX_S:
            return square
        since_s = at_s - before.captured_at_s
        moved = np.diag([(SPEED_MPS * since_s) ** 2] * 3 + [(TURN_RADPS * since_s) ** 2] * 3)
        off = _apart(np.array(before.position_m), _matrix(before), fit)
        covariance = np.reshape(before.covariance, (6, 6)) + fit.covariance + moved
        return square + float(off @ np.linalg.solve(covariance, off))


class _Fit(NamedTuple):
    """A camera's pose that explains corners best."""

    position_m: Values
    turn: Values  # the columns are the camera's axes (x right, y down, z forward) in the room
    covariance: Values  # of the position and the turns about the room's axes
    chi_square: float
    freedom: int


class _Linear(NamedTuple):
    slopes: Values  # how seen corners change with the pose and with what is common, shape (n, 8, 6 + k + 1)
    off: Values  # where corners are seen, less where the pose has them, shape (n, 8)
    weights: Values  # the inverse of their covariance, shape (n, 8, 8)

    def chi_square(self, off: Values, common: Values) -> float:
        rest = off - self.slopes[:, :, 6:] @ common
        return float(np.einsum("ni,nij,nj->", rest, self.weights, rest) + common @ common)


def locate_camera(
    seen: Sequence[SeenLandmark], landmarks: Landmarks, camera: CameraModel, expected: ExpectedPose, at_s: float
) -> CameraPose:
    """Return where the camera is, or why that is not known.

    Args:
        camera: The camera model at the picture's resolution.
        at_s: When the picture was taken.
    """
    if not seen:
        return CameraPose(captured_at_s=at_s, reason="no tag of a known place is in sight")
    largest_first = sorted(seen, key=lambda each: -each.found.width_px * each.found.height_px)
    numbers = [each.tag.number for each in largest_first]
    views = views_of(largest_first, landmarks, camera)
    starts = [starts_of(each, camera) for each in largest_first]
    try:
        used, minima = _without_moved(views, starts)
    except np.linalg.LinAlgError:  # corners on a line
        used, minima = [], []
    moved = tuple(sorted(numbers[each] for each in range(len(numbers)) if each not in used))
    tags = tuple(sorted(numbers[each] for each in used))
    if not minima or len(moved) >= len(tags) or _contradicts(minima[0]):
        return CameraPose(captured_at_s=at_s, reason=_why_no_pose(tuple(sorted(numbers)), has_fit=bool(minima)))
    fit = _likeliest(minima, expected, at_s)
    if fit is None:
        return CameraPose(captured_at_s=at_s, tags=tags, moved=moved, reason=_why_ambiguous(tags))
    return _pose(fit, at_s, tags, moved)


def _why_no_pose(numbers: tuple[int, ...], *, has_fit: bool) -> str:
    named = f"{', '.join(map(str, numbers[:-1]))} and {numbers[-1]}" if len(numbers) > 1 else str(numbers[0])
    if len(numbers) == 1 or not has_fit:
        return f"the corners of tag{'s' if len(numbers) > 1 else ''} {named} are not those of a flat square"
    return f"tags {named} contradict each other: one is not where the configuration says, or the picture is blurred"


def _why_ambiguous(tags: tuple[int, ...]) -> str:
    named = f"tag{'s' if len(tags) > 1 else ''} {', '.join(map(str, tags))}"
    return f"{named} may be seen from two places; another tag in sight, or height and tilt in [camera], tells which"


def _pose(fit: _Fit, at_s: float, tags: tuple[int, ...], moved: tuple[int, ...]) -> CameraPose:
    # The body has x forward, y left and z up: the camera's z, -x and -y.
    body = np.column_stack((fit.turn[:, 2], -fit.turn[:, 0], -fit.turn[:, 1]))
    vector = cv2.Rodrigues(body)[0].ravel()
    angle = float(np.linalg.norm(vector))
    x, y, z = (vector * (math.sin(angle / 2) / angle if angle > 1e-12 else 0.5)).tolist()
    east_m, north_m, up_m = fit.position_m.tolist()
    return CameraPose(
        captured_at_s=at_s,
        position_m=(east_m, north_m, up_m),
        orientation=(x, y, z, math.cos(angle / 2)),
        # Six digits are more than a covariance has, and journals hold one a frame.
        covariance=tuple([float(f"{each:.6g}") for each in fit.covariance.ravel().tolist()]),
        tags=tags,
        moved=moved,
    )


def _matrix(pose: CameraPose) -> Values:
    """Return the camera's axes in the room as columns: the inverse of `_pose`."""
    x, y, z, w = pose.orientation or (0.0, 0.0, 0.0, 1.0)
    half = math.atan2(math.sqrt(x * x + y * y + z * z), w)
    vector = np.array((x, y, z)) * (2 * half / math.sin(half) if half > 1e-12 else 2.0)
    body = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    return np.column_stack((-body[:, 1], -body[:, 2], body[:, 0]))


# The fit ------------------------------------------------------------------------------------------


def _linearise(views: LandmarkViews, position_m: Values, turn: Values) -> _Linear | None:
    """Return the errors of corners, and how they change; None where one is not in front of the camera."""
    rays_m = views.corners_m - position_m
    x, y, depth = (rays_m @ turn).transpose(2, 0, 1)
    if not (depth > 0).all():
        return None
    place = np.stack((x / depth, y / depth), axis=-1)
    # u = X / Z, so that du = (dX - u dZ) / Z for a shift of the corner in the room; shape (n, 4, 2, 3).
    shift = (turn.T[:2] - place[..., None] * turn.T[2]) / depth[..., None, None]
    # A turn v of the tag moves a corner by v × arm; a turn w of the camera moves it by -w × ray, as seen by the camera.
    of_tag = np.concatenate((shift, -shift @ _skew(views.arms_m)), axis=-1).reshape(-1, 8, 6)
    of_camera = np.concatenate((-shift, shift @ _skew(rays_m)), axis=-1).reshape(-1, 8, 6)
    of_size = (shift @ views.arms_m[..., None]).reshape(-1, 8, 1) * views.size_sigma
    covariance = views.noise + (of_tag * views.place_variances) @ of_tag.transpose(0, 2, 1)
    slopes = np.concatenate((of_camera, views.common, of_size), axis=2)
    return _Linear(slopes, views.seen - place.reshape(-1, 8), np.linalg.inv(covariance))


def _skew(vectors: Values) -> Values:
    """Return the matrices that take other vectors to the cross product with vectors, shape (n, 4, 3, 3)."""
    return np.asarray((vectors @ SKEW).reshape(-1, 4, 3, 3))


def _fit(views: LandmarkViews, position_m: Values, turn: Values) -> _Fit | None:
    """Return the pose nearby that explains the corners best; None where there is none."""
    linear = _linearise(views, position_m, turn)
    common = np.zeros(views.common.shape[2] + 1)
    for _ in range(MAX_STEPS):
        if linear is None:
            return None
        step, gain = _step(linear, common)
        before = linear.chi_square(linear.off, common)
        for _ in range(MAX_HALVINGS):
            moved_m = position_m + step[:3]
            turned = np.asarray(cv2.Rodrigues(step[3:6])[0]) @ turn
            then = _linearise(views, moved_m, turned)
            if then is not None and linear.chi_square(then.off, common + step[6:]) <= before:
                break
            step, gain = step / 2, gain / 2
        else:
            break
        position_m, turn, common, linear = moved_m, turned, common + step[6:], then
        if gain < SETTLED * max(1.0, before / linear.off.size):
            break
    if linear is None or not math.isfinite(linear.chi_square(linear.off, common)):
        return None
    covariance = np.asarray(np.linalg.inv(_normal(linear))[:6, :6], np.float64)
    freedom = linear.off.size - 6
    return _Fit(position_m, turn, covariance, linear.chi_square(linear.off, common), freedom)


def _normal(linear: _Linear) -> Values:
    normal = (linear.slopes.transpose(0, 2, 1) @ linear.weights @ linear.slopes).sum(axis=0)
    normal[6:, 6:] += np.eye(len(normal) - 6)  # the priors of what is common
    return np.asarray(normal)


def _step(linear: _Linear, common: Values) -> tuple[Values, float]:
    """Return the step to the minimum if all were linear, and what it would take off chi-square."""
    rest = linear.off - linear.slopes[:, :, 6:] @ common
    slope = np.einsum("nij,nik,nk->j", linear.slopes, linear.weights, rest)
    slope[6:] -= common
    step = np.linalg.solve(_normal(linear), slope)
    return step, float(step @ slope)


# Which tags, and which of several minima ----------------------------------------------------------

_Starts = Sequence[Sequence[tuple[Values, Values]]]


def _without_moved(views: LandmarkViews, starts: _Starts) -> tuple[list[int], list[_Fit]]:
    """Return which tags agree on where the camera is, and the minima of their fit.

    A tag that has moved is the one without which the others fit far better, by how they fit themselves: so blur, which
    moves all corners, makes no tag seem moved.
    """
    used = list(range(len(starts)))
    minima = _minima(views, starts)
    while len(used) > 2 and minima and not _is_good(minima[0]):
        rest, without = _best_rest(views, starts, used)
        if not without:
            break
        scale = max(1.0, without[0].chi_square / without[0].freedom)
        gained = minima[0].chi_square - without[0].chi_square
        if gained < scale * _limit(COORDINATES, MOVED) and not _contradicts(minima[0]):
            break
        used, minima = rest, without
    return used, minima


def _best_rest(views: LandmarkViews, starts: _Starts, used: Sequence[int]) -> tuple[list[int], list[_Fit]]:
    """Return all tags but one, which fit best, or well; and their minima, none if there is no fit."""
    best: tuple[list[int], list[_Fit]] = [], []
    for left in used:
        rest = [each for each in used if each != left]
        minima = _minima(views.of(rest), [starts[each] for each in rest])
        if minima and (not best[1] or minima[0].chi_square < best[1][0].chi_square):
            best = rest, minima
            if _is_good(minima[0]):
                break
    return best


def _minima(views: LandmarkViews, starts: _Starts) -> list[_Fit]:
    """Return the poses that explain the corners best, each better than all nearby, the best first."""
    fits: list[_Fit] = []
    for of_tag in starts[:TAGS_TO_START_FROM]:
        for position_m, turn in of_tag:
            fit = _fit(views, position_m, turn)
            if fit is not None and not any(_sigmas_apart(fit, other) < SAME for other in fits):
                fits.append(fit)
        if any(map(_is_good, fits)):
            break
    return sorted(fits, key=lambda fit: fit.chi_square)


def _is_good(fit: _Fit) -> bool:
    return fit.chi_square < _limit(fit.freedom, SUSPECT)


def _likeliest(minima: Sequence[_Fit], expected: ExpectedPose, at_s: float) -> _Fit | None:
    """Return the likeliest pose; None if another one, elsewhere, is hardly less likely.

    That another one may be true widens the covariance, by the second moment about the one that is taken.
    """
    costs = [fit.chi_square + expected.misfit(fit, at_s) for fit in minima]
    least = min(costs)
    best = minima[costs.index(least)]
    covariance = best.covariance * max(1.0, best.chi_square / best.freedom)
    for fit, cost in zip(minima, costs, strict=True):
        odds = math.exp(-(cost - least) / 2)
        probability = odds / (1 + odds)
        if fit is best or probability < 1e-9:
            continue
        if probability > POSSIBLE and _sigmas_apart(fit, best) > APART:
            return None
        off = _apart(best.position_m, best.turn, fit)
        covariance = covariance + probability * np.outer(off, off)
    return best._replace(covariance=covariance)


def _contradicts(fit: _Fit) -> bool:
    # Of one or two tags no other tells how well corners fit, so only chance excuses a bad fit.
    few = fit.freedom <= 10 and fit.chi_square > _limit(fit.freedom, MOVED)
    return few or fit.chi_square > CONTRADICTION * fit.freedom


def _limit(freedom: int, sigmas: float) -> float:
    """Return the limit a chi-square is below, but for a number of standard deviations (Wilson and Hilferty, 1931)."""
    share = 2 / (9 * freedom)
    return freedom * (1 - share + sigmas * math.sqrt(share)) ** 3


def _apart(position_m: Values, turn: Values, other: _Fit) -> Values:
    """Return the shift and the turn from a pose to another one."""
    turned = cv2.Rodrigues(other.turn @ turn.T)[0].ravel()
    return np.concatenate((other.position_m - position_m, np.asarray(turned, np.float64)))


def _sigmas_apart(one: _Fit, other: _Fit) -> float:
    off = _apart(one.position_m, one.turn, other)
    return math.sqrt(max(0.0, float(off @ np.linalg.solve(one.covariance + other.covariance, off))))
