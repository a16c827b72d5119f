"""The distance of a target that stands on the floor, from where its foot appears: no size is needed for that.

With the camera at the height h, looking up by the angle t, the vertical points down along ``(0, cos t, -sin t)`` in the
camera frame. A ray ``(x, y, 1)`` falls by ``q = y cos t - sin t`` and goes ``l = hypot(x, cos t + y sin t)`` along the
floor for each unit of depth. The ray through the foot meets the floor ``h l / q`` from below the camera, and the centre
is straight above the foot. So with the ray through the centre, n long and l' along the floor,

    ``1 / D = (q / l) (l' / n) / h``

for anything that stands upright. A ball of radius r touches the floor straight below its centre, and ``sin α = r / D``
is seen, as the half angle of its outline: ``1 / D = (q' / n + sin α) / h`` for a ball of any size. What has its centre
at a known height c has ``1 / D = (q' / n) / (h - c)``; of what lies flat, c is 0.

The *inverse* of the distance is worked with: it is linear in what errs, even at the horizon, where the distance has no
end (J. Civera, A. Davison and J. Montiel, "Inverse Depth Parametrization for Monocular SLAM", 2008). Its variance is

    ``(∂(1/D)/∂y σ_y)² + (∂(1/D)/∂t σ_t)² + (σ_h / h D)² + …``

Of the distance, a tilt that is off by σ_t makes a share of about ``σ_t D / h``, a height that is off σ_h / h. The
derivatives are differences: each cause moves by one standard deviation.

The distance by size errs by the same edges and the same focal length, so both errors are correlated. Of two estimates
with the variances s² and f² and the covariance c, the best that is linear in both takes the second one by
``(s² - c) / (s² + f² - 2 c)`` (Y. Bar-Shalom, "On the track-to-track correlation problem", 1981).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from stadimeter.core.detection import Detection, Points, TargetShape
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.words import metres
from stadimeter.errors import CalibrationError
from stadimeter.ranging.flat import SheetShape, TagShape, UprightShape
from stadimeter.ranging.plane_pose import COORDINATES, PlanePose, RectanglePose, plane_poses, rectangle, refine

Ray = tuple[float, float]  # x and y per unit of depth, the lens's distortion undone

# Size and floor that are further apart than this many standard deviations of their difference contradict each other.
# By chance that is one frame in 370.
DISAGREEMENT_SIGMAS = 3.0

# Boxes by a network end above the soles by this share of their height: people on a road came out 7.5 % too far by them.
CUT_FEET_SHARE = 0.07

# Standard deviation of how far what stands leans forwards or back.
LEAN_RAD = math.radians(3)


class OnFloor(Struct, frozen=True, kw_only=True):
    """A target by its size and by the floor.

    Attributes:
        measurement: What to go by.
        by_size: As it was without the floor.
        distance_m: By the floor alone; None where its ray does not meet the floor.
        sigma_m: The standard deviation of that.
        apart_sigmas: How far the two are apart, in standard deviations of their difference.
    """

    measurement: Measurement
    by_size: Measurement
    distance_m: float | None
    sigma_m: float
    apart_sigmas: float


class _Sight(NamedTuple):
    """All that the floor's distance follows from."""

    centre: Ray
    foot: Ray | None  # where it touches the floor; None of a ball, and where the height of the centre is known
    sine: float  # of the half angle of a ball, else 0
    tilt_rad: float
    height_m: float  # of the camera above the foot, or above the centre where its height is known

    def nearness(self) -> float:
        """Return the inverse of the distance, per metre; 0 at the horizon and less above it."""
        falls, level, length = _fall(self.centre, self.tilt_rad)
        if self.foot is None:
            return (falls / length + self.sine) / self.height_m
        foot_falls, foot_level, _ = _fall(self.foot, self.tilt_rad)
        return foot_falls / foot_level * level / length / self.height_m

    def moved(self, across: float, down: float, foot_down: float, sine: float = 0.0) -> _Sight:
        """Return it with its rays moved, and its sine changed by a share."""
        (x, y), foot = self.centre, self.foot
        foot = foot and (foot[0] + across, foot[1] + foot_down)
        return self._replace(centre=(x + across, y + down), foot=foot, sine=self.sine * (1 + sine))


class _Cause(NamedTuple):
    """The motion of both inverse distances by one cause, by one standard deviation, as shares of that by the size."""

    of_floor: float
    of_size: float
    is_noise: bool = False  # whether it differs from frame to frame


def _fall(ray: Ray, tilt_rad: float) -> tuple[float, float, float]:
    """Return the fall of a ray, its way along the floor, and its length, per unit of depth."""
    (x, y), cosine, sine = ray, math.cos(tilt_rad), math.sin(tilt_rad)
    return y * cosine - sine, math.hypot(x, cosine + y * sine), math.sqrt(1 + x * x + y * y)


def stand(by_size: Measurement, found: Detection, shape: TargetShape, camera: CameraModel, footing: Footing) -> OnFloor:
    """Join what a target's size tells with what the floor tells; see the head of this file.

    Where they contradict each other, the distance by the size stays, since the floor is what changes from frame to
    frame (a target that is lifted, a robot that nods), with a standard deviation that reaches the other one.

    Args:
        camera: The camera model at the picture's resolution.
    """
    distance_m, sigma_m = by_size.distance_m, by_size.sigma_m
    if by_size.position_m is None or not distance_m or not sigma_m:
        return OnFloor(measurement=by_size, by_size=by_size, distance_m=None, sigma_m=0.0, apart_sigmas=0.0)
    sight = _sight(by_size, found, shape, camera, footing)
    nearer = sight.nearness() * distance_m  # how many times nearer it is by the floor
    causes = [*_causes(sight, by_size, found, camera, footing)]
    if isinstance(shape, UprightShape):
        lower = sight.moved(0.0, 0.0, CUT_FEET_SHARE * found.height_px / camera.fy_px)
        causes.append(_Cause((lower.nearness() - sight.nearness()) * distance_m, 0.0))
    of_floor = sum(each.of_floor**2 for each in causes)
    of_size, common = (sigma_m / distance_m) ** 2, sum(each.of_floor * each.of_size for each in causes)
    apart = abs(nearer - 1) / math.sqrt(max(of_floor + of_size - 2 * common, 1e-18))
    floor_m = distance_m / nearer if nearer > 0 else None
    floor_sigma_m = math.sqrt(of_floor) * floor_m * floor_m / distance_m if floor_m else math.inf
    joined = (
        _contradicted(by_size, distance_m, sigma_m, nearer)
        if apart > DISAGREEMENT_SIGMAS
        else _joined(by_size, distance_m, nearer, causes, (of_size, of_floor, common))
    )
    said = OnFloor(measurement=joined, by_size=by_size, distance_m=floor_m, sigma_m=floor_sigma_m, apart_sigmas=apart)
    return said if joined is not by_size and apart <= DISAGREEMENT_SIGMAS else _with_reason(said)


def _sight(by_size: Measurement, found: Detection, shape: TargetShape, camera: CameraModel, footing: Footing) -> _Sight:
    x_m, y_m, z_m = by_size.position_m or (0.0, 0.0, 1.0)
    centre, tilt_rad = (x_m / z_m, y_m / z_m), footing.tilt_rad
    if footing.centre_m is not None:
        return _Sight(centre, None, 0.0, tilt_rad, footing.height_m - footing.centre_m)
    if shape.limb_radius_m > 0:
        sine = shape.limb_radius_m / (by_size.distance_m or math.inf)
        return _Sight(centre, None, sine, tilt_rad, footing.height_m)
    return _Sight(
        centre, _foot(found, camera, tilt_rad, has_corners=shape.has_corners), 0.0, tilt_rad, footing.height_m
    )


def _foot(found: Detection, camera: CameraModel, tilt_rad: float, *, has_corners: bool) -> Ray:
    """Return the ray through the middle of the lowest edge, or through the lowest point of what is round."""
    if not len(found.outline_px):
        x_px, y_px = found.centre_px
        return camera.direction(x_px, y_px + found.height_px / 2)
    rays = camera.directions(found.outline_px).tolist()
    rays.sort(key=lambda ray: -_fall(ray, tilt_rad)[0] / _fall(ray, tilt_rad)[1])
    if not has_corners:
        return rays[0][0], rays[0][1]
    # The middle of the edge from r to s, in perspective: r / q_r and s / q_s are where these rays meet the floor, and
    # the ray to half way between is (q_s r + q_r s) / (q_r + q_s). At the horizon that is half way in the picture.
    (first_x, first_y), (other_x, other_y) = rays[:2]
    falls = [max(_fall(ray, tilt_rad)[0], 0.0) for ray in rays[:2]]
    weight = falls[1] / sum(falls) if min(falls) > 0 else 0.5
    return weight * first_x + (1 - weight) * other_x, weight * first_y + (1 - weight) * other_y


def _causes(
    sight: _Sight, by_size: Measurement, found: Detection, camera: CameraModel, footing: Footing
) -> Iterator[_Cause]:
    distance_m, nearness = by_size.distance_m or math.inf, sight.nearness()

    def cause(moved: _Sight, of_size: float = 0.0, *, is_noise: bool = False) -> _Cause:
        return _Cause((moved.nearness() - nearness) * distance_m, of_size, is_noise)

    # Opposite edges make up the extent and the centre: σ of the extent moves each by half, apart or together.
    half = found.size_sigma_px / 2 / camera.fy_px
    noise_share = (by_size.noise_m or 0.0) / distance_m
    yield cause(sight.moved(0.0, half, half), is_noise=True)
    yield cause(sight.moved(0.0, 0.0, half, noise_share), noise_share, is_noise=True)
    bias_share = 2 * camera.edge_bias_sigma_px / max(found.width_px, found.height_px)
    bias = camera.edge_bias_sigma_px / camera.fy_px
    yield cause(sight.moved(0.0, 0.0, bias, bias_share), bias_share)
    for moved, of_size in _lenses(sight, camera):
        yield cause(moved, of_size)
    sigma_rad = footing.tilt_sigma_rad
    yield cause(sight._replace(tilt_rad=sight.tilt_rad + sigma_rad))
    foot_x = sight.foot[0] if sight.foot else 0.0
    yield cause(sight.moved(0.0, sigma_rad * sight.centre[0], sigma_rad * foot_x))  # a roll, to first order
    off_m = math.hypot(footing.height_sigma_m, footing.centre_sigma_m)
    yield cause(sight._replace(height_m=sight.height_m + off_m))
    if sight.foot is not None:
        # What leans moves its centre by its height above the foot, which is seen as the angle between both rays.
        yield _Cause(math.sin(LEAN_RAD) * math.dist(sight.centre, sight.foot), 0.0)


def _lenses(sight: _Sight, camera: CameraModel) -> Iterator[tuple[_Sight, float]]:
    """Yield it through lenses that are off by one standard deviation, with what that does to the nearness by size."""
    for moved, share in through_other_lenses(np.array((sight.centre, sight.foot or sight.centre)), camera):
        (x, y), (foot_x, foot_y) = moved.tolist()
        yield sight._replace(centre=(x, y), foot=sight.foot and (foot_x, foot_y), sine=sight.sine * (1 + share)), share


def through_other_lenses(rays: Points, camera: CameraModel) -> Iterator[tuple[Points, float]]:
    """Yield rays, ``(n, 2)``, through each lens that is off by one standard deviation, independent of the others.

    With each comes how much nearer, as a share, the first of them seems by its size.
    """
    if camera.uncertainty is None:
        # A focal length that is longer by a share makes all directions smaller, and the distance by size larger.
        yield rays * (1 - camera.focal_relative_sigma), -camera.focal_relative_sigma
        return
    changes = camera.sensitivities(camera.project(rays))
    variances, directions = np.linalg.eigh(camera.uncertainty.covariance())
    for change in (changes @ (directions * np.sqrt(variances.clip(0.0)))).transpose(2, 0, 1):
        yield rays + change[:, 1:], -float(change[0, 0])


def _joined(
    by_size: Measurement, distance_m: float, nearer: float, causes: list[_Cause], variances: tuple[float, float, float]
) -> Measurement:
    """Return the best of both; of a size that is not known, with an infinite σ, that by the floor."""
    of_size, of_floor, common = variances
    is_known = math.isfinite(of_size)
    weight = (of_size - common) / max(of_size + of_floor - 2 * common, 1e-18) if is_known else 1.0
    weight = min(max(weight, 0.0), 1.0)
    share = 1 + weight * (nearer - 1)
    if share <= 0:
        return by_size
    rest = 1 - weight
    variance = weight**2 * of_floor + (rest**2 * of_size + 2 * weight * rest * common if is_known else 0.0)
    noise = math.hypot(*[weight * each.of_floor + rest * each.of_size for each in causes if each.is_noise])
    joined_m = distance_m / share
    return replace(
        by_size,
        distance_m=joined_m,
        depth_m=None if by_size.depth_m is None else by_size.depth_m / share,
        sigma_m=joined_m * math.sqrt(variance) / share,
        noise_m=joined_m * min(noise, math.sqrt(variance)) / share,
    )


def _contradicted(by_size: Measurement, distance_m: float, sigma_m: float, nearer: float) -> Measurement:
    """Return the distance by size with a σ of half the difference, so that both are within two of them."""
    apart_share = min(abs(1 / nearer - 1), 1.0) if nearer > 0 else 1.0
    return replace(by_size, sigma_m=math.hypot(sigma_m, distance_m * apart_share / 2))


def _with_reason(said: OnFloor) -> OnFloor:
    """Return it with what is wrong in words; a target of unknown size that is not on the floor has no distance."""
    by_size, measured = said.by_size, said.measurement
    if not math.isfinite(by_size.sigma_m or 0.0):
        reason = "its size is not known, and it does not appear on the floor: it is above the horizon"
        bare = Measurement(target=by_size.target, status=MeasurementStatus.ERROR, captured_at_s=by_size.captured_at_s)
        return replace(said, measurement=replace(bare, reason=reason))
    size = metres(by_size.distance_m or 0.0, by_size.sigma_m or 0.0)
    floor = "not there" if said.distance_m is None else f"at {metres(said.distance_m, said.sigma_m)}"
    reason = (
        f"at {size} by its size, {floor} by the floor, {said.apart_sigmas:.0f} σ apart: it is not on the floor, or its "
        "size, or the camera's height or tilt, is wrong; the size counts, with a wider ±"
    )
    return replace(said, measurement=replace(measured, reason=reason))


# Height of a camera above the floor and its tilt, from a rectangle of known sides that lies on it ---------------------

# The other pose that explains the corners must be this much worse, as a chi-square: once in 10,000 it is the true one.
CLEARLY_WORSE = 18.0

# Corners are off by this, in pixels, besides what the detector states: paper does not lie quite flat.
NOT_FLAT_PX = 0.1


class CameraAboveFloor(Struct, frozen=True, kw_only=True):
    """The place of a camera above the floor, with the standard deviations of its height and tilt.

    Attributes:
        tilt_rad: How far it looks up from level.
        roll_rad: How far its right side is down.
    """

    height_m: float
    height_sigma_m: float
    tilt_rad: float
    tilt_sigma_rad: float
    roll_rad: float


def camera_above(found: Detection, shape: SheetShape | TagShape, camera: CameraModel) -> CameraAboveFloor:
    """Return where the camera is, from one picture of a sheet or a tag that lies on the floor.

    The normal n of the plane is the vertical, and its centre p lies ``h = -n · p`` below the camera, which looks up by
    ``asin n_z``. Each cause, the coordinates of the corners, the lens and the size, is moved by one standard deviation.

    Args:
        camera: The camera model at the picture's resolution.

    Raises:
        CalibrationError: The corners may be seen from two sides, or are not those of the rectangle.
    """
    corners = np.asarray(found.outline_px, dtype=np.float64)
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    sigma = math.hypot(found.size_sigma_px / math.sqrt(2), NOT_FLAT_PX) / focal_px
    seen = camera.directions(corners)
    pose, corners_m = _pose(seen, shape, sigma)
    height_m, tilt_rad, roll_rad = _above(pose)
    moved = [seen + step.reshape(4, 2) for step in np.eye(COORDINATES) * sigma]
    moved += [rays for rays, _ in through_other_lenses(seen, camera)]
    poses = [refine(pose, corners_m, each.tolist()) for each in moved]
    changes = np.array([_above(each) for each in poses]) - (height_m, tilt_rad, roll_rad)
    off_m, off_rad, _ = np.sqrt((changes**2).sum(axis=0)).tolist()
    return CameraAboveFloor(
        height_m=height_m,
        height_sigma_m=math.hypot(off_m, height_m * shape.relative_sigma),
        tilt_rad=tilt_rad,
        tilt_sigma_rad=off_rad,
        roll_rad=roll_rad,
    )


def mean_of(views: Sequence[CameraAboveFloor]) -> CameraAboveFloor:
    """Return the mean of several pictures. Their ± is that of the best one, and how far they differ.

    Errors of the lens and of the size are the same in all of them, so more pictures do not make these smaller.
    """
    count, best = len(views), min(views, key=lambda each: each.tilt_sigma_rad)
    heights, tilts = [each.height_m for each in views], [each.tilt_rad for each in views]
    spreads = [float(np.std(each, ddof=1)) / math.sqrt(count) if count > 1 else 0.0 for each in (heights, tilts)]
    return CameraAboveFloor(
        height_m=sum(heights) / count,
        height_sigma_m=math.hypot(best.height_sigma_m, spreads[0]),
        tilt_rad=sum(tilts) / count,
        tilt_sigma_rad=math.hypot(best.tilt_sigma_rad, spreads[1]),
        roll_rad=sum(each.roll_rad for each in views) / count,
    )


def _pose(seen: Points, shape: SheetShape | TagShape, sigma: float) -> tuple[PlanePose, list[list[float]]]:
    """Return the pose that explains the corners, and these in its own frame; a sheet may lie along or across."""
    sides = (shape.longest_m, shape.shortest_m)
    known: list[tuple[RectanglePose, Points]] = []
    for width_m, height_m in dict.fromkeys((sides, sides[::-1])):
        corners_m = rectangle(width_m, height_m)
        known += [(pose, corners_m) for pose in plane_poses(corners_m, seen)]
    known.sort(key=lambda each: each[0].misfit)
    if not known:
        raise CalibrationError("its corners are not those of a rectangle that lies before the camera")
    best, corners_m = known[0]
    # Half a turn about the normal is the same pose, and a square has four of them.
    others = [pose for pose, _ in known[1:] if math.dist(pose.normal, best.normal) > 1e-3]
    if any((other.misfit**2 - best.misfit**2) * COORDINATES < CLEARLY_WORSE * sigma**2 for other in others):
        raise CalibrationError("it is seen too small to tell how it lies; put it nearer, or take a larger one")
    return PlanePose(*best[:3]), corners_m.tolist()


def _above(pose: PlanePose) -> tuple[float, float, float]:
    """Return height, tilt and roll: the normal of what lies on the floor is up, (0, -cos t, sin t) without a roll."""
    x, y, z = RectanglePose(*pose, 0.0).normal
    height_m = -(x * pose.position_m[0] + y * pose.position_m[1] + z * pose.position_m[2])
    return height_m, math.asin(min(max(z, -1.0), 1.0)), math.atan2(-x, -y)
