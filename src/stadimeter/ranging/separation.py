"""The distance between two targets that are seen in one picture."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, TargetShape, Values
from stadimeter.core.measurement import Measurement
from stadimeter.ranging.measure import sigma_parts


class SeenTarget(Struct, frozen=True, kw_only=True):
    """A target that was found and measured in a picture."""

    detection: Detection
    measurement: Measurement
    shape: TargetShape


class Separation(Struct, frozen=True, kw_only=True):
    """The straight line between the centres of two targets."""

    distance_m: float
    sigma_m: float  # its standard deviation


def direction_sigma_px(detection: Detection) -> float:
    """Return the standard deviation of a centre, along each axis.

    Opposite edges make up a size and a centre: the size is their difference, the centre their mean, half as uncertain.
    """
    return detection.size_sigma_px / 2


def separation(one: SeenTarget, other: SeenTarget, camera: CameraModel) -> Separation | None:
    """Return the distance between two targets; None unless both were measured.

    Errors of the lens and, for two targets of one size, of that size are the same in both positions, and cancel for the
    most part. Each target's noise and doubt about its pose move it along its own line of sight; the noise of its centre
    moves it across.

    Args:
        camera: The camera model at the picture's resolution.
    """
    ends = one.measurement.position_m, other.measurement.position_m
    if ends[0] is None or ends[1] is None:
        return None
    first_m, second_m = np.array(ends[0]), np.array(ends[1])
    apart_m = float(np.linalg.norm(second_m - first_m))
    # Errors project on the line between both targets: of a move e of one of them, |e · along| changes their distance to
    # first order.
    along = (second_m - first_m) / max(apart_m, 1e-12)
    variance_m2 = _of_lens_m2(first_m, second_m, along, camera) + _of_sizes_m2(one, other, along)
    for target, position_m in ((one, first_m), (other, second_m)):
        variance_m2 += _own_m2(target, position_m, along, camera)
    return Separation(distance_m=apart_m, sigma_m=math.sqrt(max(variance_m2, 0.0)))


def _own_m2(target: SeenTarget, position_m: Values, along: Values, camera: CameraModel) -> float:
    parts = sigma_parts(target.measurement, target.shape, camera)
    distance_m = float(np.linalg.norm(position_m))
    share = float(along @ position_m) / distance_m
    outwards_m = 0.0 if parts is None else math.hypot(parts.edges_m, parts.pose_m)
    # Pixels over focal length is an angle; times the depth it is metres across the line of sight.
    across_m = direction_sigma_px(target.detection) / math.sqrt(camera.fx_px * camera.fy_px) * float(position_m[2])
    return (outwards_m * share) ** 2 + across_m**2 * max(1 - share**2, 0.0)


def _of_sizes_m2(one: SeenTarget, other: SeenTarget, along: Values) -> float:
    first_m, second_m = (
        float(along @ np.array(each.measurement.position_m)) * each.shape.relative_sigma for each in (one, other)
    )
    if one.shape == other.shape:  # printed alike, so wrong alike
        return (second_m - first_m) ** 2
    return first_m**2 + second_m**2


def _of_lens_m2(first_m: Values, second_m: Values, along: Values, camera: CameraModel) -> float:
    change = along @ (moved_by_lens(second_m, camera) - moved_by_lens(first_m, camera))
    if camera.uncertainty is not None:
        return float(change @ camera.uncertainty.covariance() @ change)
    # Only the share by which the focal length may be wrong is known: fx and fy move together.
    of_focal = float(change[0] * camera.fx_px + change[1] * camera.fy_px)  # both wrong by the same share
    return (of_focal * camera.focal_relative_sigma) ** 2


def moved_by_lens(position_m: Values, camera: CameraModel) -> Values:
    """Return the change of a position with each parameter of the lens, shape (3, 9)."""
    x, y = position_m[:2] / position_m[2]
    of_distance, of_x, of_y = camera.sensitivities(np.array([camera.pixel(x, y)]))[0]
    square = 1 + x * x + y * y
    turned_x = np.array((1.0, 0.0, 0.0)) * position_m[2] - position_m * x / square
    turned_y = np.array((0.0, 1.0, 0.0)) * position_m[2] - position_m * y / square
    return np.outer(position_m, of_distance) + np.outer(turned_x, of_x) + np.outer(turned_y, of_y)


def direction_sigmas_rad(target: SeenTarget, camera: CameraModel) -> tuple[float, float] | None:
    """Return the standard deviations of bearing and elevation; None if the target was not measured.

    Noise of the edges, and where it is known what the lens leaves open at this place.

    Args:
        camera: The camera model at the picture's resolution.
    """
    if target.measurement.position_m is None:
        return None
    x_m, y_m, z_m = target.measurement.position_m
    x, y = x_m / z_m, y_m / z_m
    noise_px = direction_sigma_px(target.detection)
    covariance = np.diag((noise_px / camera.fx_px, noise_px / camera.fy_px)) ** 2
    if camera.uncertainty is not None:
        of_direction = camera.sensitivities(np.array([camera.pixel(x, y)]))[0, 1:]
        covariance = covariance + of_direction @ camera.uncertainty.covariance() @ of_direction.T
    # Jacobian of bearing = atan x and elevation = -atan(y / √(1 + x²)) in x and y per unit of depth.
    flat, square = math.hypot(1.0, x), 1 + x * x + y * y
    to_angles = np.array(((1 / (1 + x * x), 0.0), (x * y / (flat * square), -flat / square)))
    bearing, elevation = np.diag(to_angles @ covariance @ to_angles.T)
    return math.sqrt(bearing), math.sqrt(elevation)
