"""Place of a target, from two pictures of it that two cameras took at one time: by triangulation, and by size too.

Each picture gives rays: to the four corners of a sheet or a tag, to the centre of a ball or a disc. The two rays to one
point nearly meet; the point is put half way between where they come nearest (R. Hartley and P. Sturm, "Triangulation",
Computer Vision and Image Understanding 68, 1997, section 2: the midpoint method, which is as good as any where both
rays have about the same length). By how much they miss each other tells whether both saw the same thing at the same
time, and whether the cameras are still where they were.

The distance by the target's size is measured by each camera as ever. The three distances share errors: those of a focal
length are in the triangulation and in the distance by size, that of the size in both of these. So they are joined as
the best linear estimate does that is unbiased: with weights ``C⁻¹ 1 / (1' C⁻¹ 1)``, C being the covariance of their
logarithms (the Gauss-Markov theorem; Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
Tracking and Navigation", section 3.4).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Values
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.stereo_rig import OF_LENS, OF_POSE, UNKNOWNS, StereoRig
from stadimeter.core.words import metres
from stadimeter.ranging.flat import DiscShape
from stadimeter.ranging.measure import SeenTarget, direction_sigma_px, sigma_parts

# Size and triangulation that are further apart than this many standard deviations of their difference are said to
# disagree: by chance that is one in 370.
DISAGREEMENT_SIGMAS = 3.0

# Rays that miss each other by more are not of one thing at one time. It is more than three, since detectors know the
# noise of sizes better than that of places.
MAX_MISS_SIGMAS = 5.0

# What the rays may miss each other by besides: rolling shutters that are not quite in step.
MISS_FLOOR_PX = 0.1

_STEP = 1e-6

# Even what is said to be exact is no surer than to a hundred-millionth: its variance is divided by.
_EXACT = 1e-16

# Rays at a smaller angle than a microradian are taken to be at that one.
_PARALLEL = 1e-12


class StereoFigures(Struct, frozen=True, kw_only=True):
    """The figures of two cameras for a target, before it is joined.

    Attributes:
        distance_m: By triangulation alone, from the left camera to the target's centre.
        sigma_m: Its standard deviation, and `noise_m` the part that differs from frame to frame.
        miss_px: By how much the lines of sight miss each other in the left picture, with its standard deviation.
        size_m: By the target's size alone, both cameras joined, with its standard deviation; None if that is not known.
        disagreement: What is said if both disagree; else empty.
    """

    distance_m: float
    sigma_m: float
    noise_m: float
    miss_px: float
    miss_sigma_px: float
    size_m: float | None = None
    size_sigma_m: float | None = None
    disagreement: str = ""


class _Estimates(Struct, frozen=True, eq=False):
    """Logarithms of distances with their covariance, and the part of each one's variance that is noise."""

    logs: Values
    covariance: Values
    noise: Values

    def join(self, chosen: tuple[int, ...]) -> Values:
        """Return the weights of the best unbiased linear estimate from some; none of them is below zero.

        Weights below zero are right for errors that are known exactly. Where they are not, they lead to distances that
        are outside of all; so such an estimate is left out.
        """
        weights = np.zeros(len(self.logs))
        while True:
            index = list(chosen)
            some = np.linalg.solve(self.covariance[np.ix_(index, index)], np.ones(len(index)))
            some /= some.sum()
            if some.min() >= 0:
                weights[index] = some
                return weights
            chosen = tuple(each for each, weight in zip(chosen, some, strict=True) if weight > 0)

    def sigma(self, weights: Values) -> float:
        """Return the standard deviation of a combination."""
        return math.sqrt(max(float(weights @ self.covariance @ weights), 0.0))


def triangulate(left: Points, right: Points, pose: Values) -> tuple[Values, Values]:
    """Return where rays of two cameras come nearest to each other, and by what angle they miss.

    Args:
        left: Directions in the left camera's frame, x and y per unit of depth, shape ``(n, 2)``.
        right: Those in the right camera's frame, in the same order.
        pose: Turn and place of the right camera, as in `StereoRig`, shape ``(6,)``, or ``(n, 6)`` for one of each ray.

    Returns:
        The points in the left camera's frame, shape ``(n, 3)``; and the angles, shape ``(n,)``, in radians as the left
        camera sees them, with a sign. Points are behind the cameras where the rays part in front of them.
    """
    ones = np.ones((len(left), 1))
    poses = np.broadcast_to(pose, (len(left), 6))
    turns, which = np.unique(poses[:, :3], axis=0, return_inverse=True)
    rotations, place_m = np.array([cv2.Rodrigues(turn)[0] for turn in turns])[which.ravel()], poses[:, 3:]
    one = np.hstack((left, ones))
    other = np.einsum("nij,nj->ni", rotations, np.hstack((right, ones)))
    # The least squares solution of s one = place + t other.
    a, b, c = (one * one).sum(axis=1), (one * other).sum(axis=1), (other * other).sum(axis=1)
    d, e = (one * place_m).sum(axis=1), (other * place_m).sum(axis=1)
    along = np.where(np.abs(a * c - b * b) > _PARALLEL, a * c - b * b, _PARALLEL)
    s = (c * d - b * e) / along
    t = (b * d - a * e) / along
    points = (s[:, None] * one + place_m + t[:, None] * other) / 2
    # The shortest line between both rays is at right angles to both.
    normal = np.cross(one, other)
    lengths = np.linalg.norm(normal, axis=1).clip(math.sqrt(_PARALLEL)) * np.linalg.norm(points, axis=1).clip(1e-9)
    return points, (normal * place_m).sum(axis=1) / lengths


class _LineOfSight(Struct, frozen=True, eq=False):
    """Rays to points of a target, x and y per unit of depth, and the standard deviation of each in pixels."""

    directions: Points
    sigma_px: float


def _sight(seen: SeenTarget, camera: CameraModel, *, by_corners: bool) -> _LineOfSight:
    detection = seen.detection
    if by_corners:
        # A side is the difference of two corners, so each of these errs by its share of the square root of two.
        return _LineOfSight(camera.directions(detection.outline_px), detection.size_sigma_px / math.sqrt(2))
    x_m, y_m, z_m = seen.measurement.position_m or (math.nan, math.nan, math.nan)
    return _LineOfSight(np.array([[x_m / z_m, y_m / z_m]]), direction_sigma_px(detection))


class _Triangulated(Struct, frozen=True, eq=False):
    """A target's centre, and how the logarithm of its distance and the angle of the miss change."""

    position_m: Values
    miss_rad: float
    slopes: Values  # by the unknowns of the rig, shape (2, 24)
    noise: Values  # standard deviations of both because detections are noisy, shape (2,)

    @property
    def distance_m(self) -> float:
        """From the left camera."""
        return float(np.linalg.norm(self.position_m))

    def sigmas(self, rig: StereoRig) -> Values:
        """Return the standard deviations of both, of noise and rig together, shape (2,)."""
        of_rig = np.einsum("kp,pq,kq->k", self.slopes, rig.covariance, self.slopes).clip(0.0)
        return np.asarray(np.sqrt(of_rig + self.noise**2))


def _triangulate_target(left: SeenTarget, right: SeenTarget, rig: StereoRig, moved_sigma_px: float) -> _Triangulated:
    by_corners = left.shape.has_corners and len(left.detection.outline_px) == len(right.detection.outline_px) == 4
    one, other = _sight(left, rig.left, by_corners=by_corners), _sight(right, rig.right, by_corners=by_corners)
    if centres := _disc_centres(left, right, rig):
        one, other = replace(one, directions=centres[0]), replace(other, directions=centres[1])
    if by_corners:
        other = replace(other, directions=_in_order(one.directions, other.directions, _pose(rig)))
    return _triangulate_sights(one, replace(other, sigma_px=math.hypot(other.sigma_px, moved_sigma_px)), rig)


def _disc_centres(left: SeenTarget, right: SeenTarget, rig: StereoRig) -> tuple[Points, Points] | None:
    """Return where the centre of a disc is seen by both cameras; None for other targets, and where that is not known.

    Each camera allows two poses, whose centres are beside the axis of the cone to either side. Their true normals are
    the same one, and the mirrored ones differ by about twice the angle between both lines of sight: so of the four
    pairs of poses the one whose normals agree best is taken. From where noise makes that a guess they hardly differ.
    """
    if not (isinstance(left.shape, DiscShape) and isinstance(right.shape, DiscShape)):
        return None
    one, other = left.shape.poses(left.detection, rig.left), right.shape.poses(right.detection, rig.right)
    if one is None or other is None:
        return None
    rotation = np.asarray(cv2.Rodrigues(np.array(rig.turn_rad))[0])
    best = max(product(one.poses, other.poses), key=lambda both: float(both[0].normal @ rotation @ both[1].normal))
    seen_left, seen_right = ((each.position_m[:2] / each.position_m[2])[None] for each in best)
    return seen_left, seen_right


def _triangulate_sights(one: _LineOfSight, other: _LineOfSight, rig: StereoRig) -> _Triangulated:
    """Return the middle of the points that two cameras see, by propagation of all errors to first order."""
    count = len(one.directions)

    def find_middles(flats: Values) -> Values:
        rays = flats[:, :-6].reshape(-1, 2, count, 2)
        poses = np.repeat(flats[:, -6:], count, axis=0)
        points, misses = triangulate(rays[:, 0].reshape(-1, 2), rays[:, 1].reshape(-1, 2), poses)
        return np.column_stack((points.reshape(-1, count, 3).mean(axis=1), misses.reshape(-1, count).mean(axis=1)))

    flat = np.concatenate((one.directions.ravel(), other.directions.ravel(), _pose(rig)))
    # Central differences, all of them in one go: one after the other they take most of the time of a frame.
    steps = np.eye(len(flat)) * _STEP
    found = find_middles(np.vstack((flat, flat + steps, flat - steps)))
    here, slopes = found[0], ((found[1 : len(flat) + 1] - found[len(flat) + 1 :]) / (2 * _STEP)).T
    position_m = here[:3]
    both = np.vstack((position_m @ slopes[:3] / (position_m @ position_m), slopes[3]))
    by_rig, noise2 = np.zeros((2, UNKNOWNS)), np.zeros(2)
    for side, (sight, camera) in enumerate(((one, rig.left), (other, rig.right))):
        by_ray = both[:, 2 * count * side : 2 * count * (side + 1)]
        places_px = camera.project(sight.directions)
        # How each ray is read from its place in the picture changes with the lens, and with the noise of that place.
        by_lens = camera.sensitivities(places_px)[:, 1:].reshape(2 * count, OF_LENS)
        by_rig[:, OF_LENS * side : OF_LENS * (side + 1)] = by_ray @ by_lens
        for step in np.eye(2):
            per_px = camera.directions(places_px + step / 2) - camera.directions(places_px - step / 2)
            moved = np.einsum("knd,nd->kn", by_ray.reshape(2, count, 2), per_px)
            noise2 += sight.sigma_px**2 * (moved**2).sum(axis=1)
    by_rig[:, OF_POSE] = both[:, -6:]
    return _Triangulated(position_m, float(here[3]), by_rig, np.sqrt(noise2))


def straight_ahead_share(rig: StereoRig, distance_m: float) -> float:
    """Return the error of the cameras alone at a distance straight ahead of both: a standard deviation, as a share."""
    rotation = np.asarray(cv2.Rodrigues(np.array(rig.turn_rad))[0])
    there_m = np.array(rig.place_m) / 2 + (0.0, 0.0, distance_m)
    seen = there_m, (there_m - rig.place_m) @ rotation
    one, other = (_LineOfSight((each[:2] / each[2])[None], 0.0) for each in seen)
    return float(_triangulate_sights(one, other, rig).sigmas(rig)[0])


def _pose(rig: StereoRig) -> Values:
    return np.array((*rig.turn_rad, *rig.place_m))


def _in_order(left: Points, right: Points, pose: Values) -> Points:
    """Return the corners of the right picture from the one on that is the first of the left picture."""
    turned = [np.roll(right, -first, axis=0) for first in range(len(right))]
    return min(turned, key=lambda each: float(np.abs(triangulate(left, each, pose)[1]).sum()))


def slopes_of(function: Callable[[Values], Values], at: Values) -> Values:
    """Return the Jacobian of a function by central differences."""
    steps = np.eye(len(at)) * _STEP
    return np.column_stack([(function(at + step) - function(at - step)) / (2 * _STEP) for step in steps])


def measure_pair(
    left: SeenTarget,
    right: SeenTarget,
    rig: StereoRig,
    moved_sigma_px: float = 0.0,
    apart_sigmas: float = DISAGREEMENT_SIGMAS,
) -> tuple[Measurement, StereoFigures | None]:
    """Measure a target that was measured in both pictures; the distance is from the left camera.

    Args:
        rig: At the resolutions of the pictures.
        apart_sigmas: From where on triangulation and size are said to disagree.
        moved_sigma_px: By how much the target may have moved in the right picture since the left one was taken.

    Returns:
        The measurement, by triangulation and by size together; and what each says. Without the latter the rays do not
        belong together, and the measurement says why.
    """
    found = _triangulate_target(left, right, rig, moved_sigma_px)
    focal_px = math.sqrt(rig.left.fx_px * rig.left.fy_px)
    sigma = found.sigmas(rig)
    figures = StereoFigures(
        distance_m=found.distance_m,
        sigma_m=found.distance_m * float(sigma[0]),
        noise_m=found.distance_m * float(found.noise[0]),
        miss_px=found.miss_rad * focal_px,
        miss_sigma_px=math.hypot(float(sigma[1]) * focal_px, MISS_FLOOR_PX),
    )
    if reason := _why_not_one(found, figures):
        status = MeasurementStatus.ERROR
        at_s = left.measurement.captured_at_s
        return Measurement(target=left.measurement.target, status=status, captured_at_s=at_s, reason=reason), None
    if math.isinf(left.shape.relative_sigma):  # its size says nothing
        return _at(left.measurement, figures.distance_m, figures.sigma_m, figures.noise_m), figures
    return _join(left, _estimates(left, right, rig, found), figures, apart_sigmas)


def _why_not_one(found: _Triangulated, figures: StereoFigures) -> str:
    if not found.position_m[2] > 0:
        return (
            "the lines of sight meet behind the cameras: are the left and the right picture swapped? Give the left "
            "camera's first"
        )
    if abs(figures.miss_px) > MAX_MISS_SIGMAS * figures.miss_sigma_px:
        return (
            f"the lines of sight miss each other by {abs(figures.miss_px):.1f} px, "
            f"{abs(figures.miss_px) / figures.miss_sigma_px:.0f} σ: it is not one thing at one time in both pictures, "
            "the stereo file is of other cameras, or they have moved against each other; then calibrate again"
        )
    return ""


def _estimates(left: SeenTarget, right: SeenTarget, rig: StereoRig, found: _Triangulated) -> _Estimates:
    """Return the distances by triangulation, and by size for the left and the right camera, from the left one."""
    logs, noise = np.array((math.log(found.distance_m), 0.0, 0.0)), np.array((found.noise[0], 0.0, 0.0))
    # What each changes by with the rig, with the target's size, and with the rest that stays from frame to frame, which
    # is alike for cameras that are alike.
    slopes, of_size, rest = np.zeros((3, UNKNOWNS)), np.zeros(3), np.zeros(3)
    slopes[0] = found.slopes[0]
    rotation = np.asarray(cv2.Rodrigues(np.array(rig.turn_rad))[0])
    for index, (seen, camera) in enumerate(((left, rig.left), (right, rig.right)), 1):
        measured, parts = seen.measurement, sigma_parts(seen.measurement, seen.shape, camera)
        own_m = np.array(measured.position_m)
        turned_m = own_m if index == 1 else rotation @ own_m
        from_left_m = turned_m if index == 1 else turned_m + rig.place_m
        away_m = float(np.linalg.norm(from_left_m))
        # By which share the distance from the left camera grows if that from its own one does by one.
        growth = float(from_left_m @ turned_m) / away_m**2
        per_m = growth / (measured.distance_m or math.nan)
        place_px = camera.project(np.array([own_m[:2] / own_m[2]]))
        slopes[index, OF_LENS * (index - 1) : OF_LENS * index] = growth * camera.sensitivities(place_px)[0, 0]
        logs[index] = math.log(away_m)
        if parts is not None:
            noise[index], of_size[index], rest[index] = (
                per_m * each for each in (parts.edges_m, parts.size_m, parts.pose_m)
            )
    covariance = slopes @ rig.covariance @ slopes.T + np.outer(of_size, of_size) + np.outer(rest, rest)
    return _Estimates(logs, covariance + np.diag(noise**2 + _EXACT), noise)


_TRIANGULATED, _BY_SIZE, _ALL = (0,), (1, 2), (0, 1, 2)


def _join(
    left: SeenTarget, estimates: _Estimates, figures: StereoFigures, apart_sigmas: float
) -> tuple[Measurement, StereoFigures]:
    by_size = estimates.join(_BY_SIZE)
    size_m = math.exp(float(by_size @ estimates.logs))
    apart = estimates.join(_TRIANGULATED) - by_size
    difference, sigma = float(apart @ estimates.logs), estimates.sigma(apart)
    disagree = abs(difference) > apart_sigmas * sigma
    figures = replace(figures, size_m=size_m, size_sigma_m=size_m * estimates.sigma(by_size))
    weights = estimates.join(_TRIANGULATED if disagree else _ALL)
    distance_m = math.exp(float(weights @ estimates.logs))
    share = estimates.sigma(weights)
    if disagree:
        # One of both is wrong, and which one is not known: the interval reaches to the other one.
        share = math.hypot(share, difference)
        words = _disagreement(left.measurement.target, figures, difference, abs(difference) / sigma)
        figures = replace(figures, disagreement=words)
    noise_m = distance_m * float(np.linalg.norm(weights * estimates.noise))
    return _at(left.measurement, distance_m, distance_m * share, noise_m), figures


def _at(measured: Measurement, distance_m: float, sigma_m: float, noise_m: float) -> Measurement:
    scale = distance_m / (measured.distance_m or math.nan)
    depth_m = None if measured.depth_m is None else measured.depth_m * scale
    return replace(measured, distance_m=distance_m, depth_m=depth_m, sigma_m=sigma_m, noise_m=noise_m)


def _disagreement(target: str, figures: StereoFigures, difference: float, apart: float) -> str:
    both, size = metres(figures.distance_m, figures.sigma_m), metres(figures.size_m or 0.0, figures.size_sigma_m or 0.0)
    percent = f"{100 * abs(math.expm1(difference)):.1f} % {'larger' if difference > 0 else 'smaller'}"
    return (
        f"{target} is at {both} for both cameras together and {size} by its size, {apart:.0f} σ apart: it is {percent} "
        "than stated, or the cameras have moved against each other"
    )
