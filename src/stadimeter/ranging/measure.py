"""From a detection to a distance, with its standard deviation and direction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Reading, TargetShape, Values
from stadimeter.core.measurement import Measurement, MeasurementStatus

_STATUS = {
    DetectionStatus.FOUND: MeasurementStatus.MEASURED,
    DetectionStatus.PERHAPS: MeasurementStatus.PERHAPS,
    DetectionStatus.TRUNCATED: MeasurementStatus.TRUNCATED,
    DetectionStatus.NOT_FOUND: MeasurementStatus.NOT_FOUND,
}


def measure(detection: Detection, shape: TargetShape, camera: CameraModel, captured_at_s: float) -> Measurement:
    """Measure how far away a target is; without figures, and with the detection's reason, unless it is seen whole.

    The shape works out where the target's centre is in the camera frame; its length is the distance.

    The standard deviation has two causes: what differs from frame to frame, such as the noise of edges, which makes the
    distance uncertain in proportion to its square; and what stays, such as the error of the focal length or of the
    target's size, which is the same share of every distance.

    Args:
        camera: The camera model at the picture's resolution.
        captured_at_s: When the picture was taken, on the run's monotonic clock.
    """
    if not detection.is_whole:
        return _without_figures(detection, _STATUS[detection.status], detection.reason, captured_at_s)
    if not (0 < detection.width_px < math.inf and 0 < detection.height_px < math.inf):
        reason = f"the detector reports an apparent size of {detection.width_px:g}x{detection.height_px:g} px"
        return _without_figures(detection, MeasurementStatus.ERROR, reason, captured_at_s)
    reading = shape.locate(detection, camera)
    # Both edges of a target move, in opposite directions.
    # Edge bias of σ px an edge: 2 σ / P of the size, so of the distance; it is the same in every frame.
    bias_share = 2 * camera.edge_bias_sigma_px / max(detection.width_px, detection.height_px)
    lasting_share = math.hypot(_lens_share(camera, reading.position_m), shape.relative_sigma, bias_share)
    if camera.pupil_ahead_m:
        x_m, y_m, depth_m = reading.position_m
        reading = replace(reading, position_m=(x_m, y_m, max(depth_m - camera.pupil_ahead_m, 0.0)))
    measurement = _with_figures(detection, captured_at_s, reading, lasting_share)
    return replace(measurement, size_share=max(detection.width_px, detection.height_px) / camera.width_px)


def _lens_share(camera: CameraModel, position_m: tuple[float, float, float] | None) -> float:
    if position_m is None:
        return camera.focal_relative_sigma
    x_m, y_m, depth_m = position_m
    return camera.distance_share(*camera.pixel(x_m / depth_m, y_m / depth_m))


def _with_figures(detection: Detection, captured_at_s: float, reading: Reading, lasting_share: float) -> Measurement:
    x_m, y_m, depth_m = reading.position_m
    straight_m = math.sqrt(x_m * x_m + y_m * y_m + depth_m * depth_m)
    return Measurement(
        target=detection.target,
        status=_STATUS[detection.status],
        captured_at_s=captured_at_s,
        distance_m=straight_m,
        depth_m=depth_m,
        # All shares are of the distance, so independent causes add as squares and the sum is times the distance.
        sigma_m=straight_m * math.hypot(reading.noise_share, reading.systematic_share, lasting_share),
        noise_m=straight_m * reading.noise_share,
        bearing_rad=math.atan2(x_m, depth_m),
        # Up is positive; the camera's y points down.
        elevation_rad=-math.atan2(y_m, math.hypot(depth_m, x_m)),
        tilt_rad=reading.tilt_rad,
        ambiguity=reading.ambiguity,
        reason=detection.reason if detection.status is DetectionStatus.PERHAPS else "",
    )


def _without_figures(detection: Detection, status: MeasurementStatus, reason: str, captured_at_s: float) -> Measurement:
    return Measurement(target=detection.target, status=status, captured_at_s=captured_at_s, reason=reason)


def unmeasured(measured: Measurement) -> Measurement:
    """Return a measurement by a size that is not known as what it is: none."""
    reason = "; ".join(filter(None, ("its size is not known, so one camera measures no distance", measured.reason)))
    at_s = measured.captured_at_s
    return Measurement(target=measured.target, status=MeasurementStatus.ERROR, captured_at_s=at_s, reason=reason)


class SigmaParts(Struct, frozen=True, kw_only=True):
    """The causes of a distance's standard deviation. Their squares add up to its square."""

    edges_m: float  # the noise of the edges in the picture, which differs from frame to frame
    focal_length_m: float  # how well the focal length is known, and the rest of the lens where the target is seen
    size_m: float  # how well the target's size is known
    pose_m: float  # everything else that stays; of something flat, which of two mirrored poses it has, and edge bias


def sigma_parts(measured: Measurement, shape: TargetShape, camera: CameraModel) -> SigmaParts | None:
    """Return the causes of a distance's standard deviation; None if there is no distance."""
    if measured.distance_m is None or measured.sigma_m is None or measured.noise_m is None:
        return None
    focal_length_m = measured.distance_m * _lens_share(camera, measured.position_m)
    size_m = measured.distance_m * shape.relative_sigma
    known_m = math.hypot(measured.noise_m, focal_length_m, size_m)
    # What is left of two nearly equal numbers is rounding error, no cause.
    rest_m2 = measured.sigma_m**2 - known_m**2
    return SigmaParts(
        edges_m=measured.noise_m,
        focal_length_m=focal_length_m,
        size_m=size_m,
        pose_m=math.sqrt(rest_m2) if rest_m2 > 1e-9 * measured.sigma_m**2 else 0.0,
    )


# The distance between two targets that are seen in one picture --------------------------------------------------------


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


# The size of what is seen, if its distance is known: similar triangles the other way round ----------------------------
#
# What appears P large per unit of depth, at the depth Z, is ``W = P Z`` large. Errors of the focal length and of
# the distance change it by the same share, and the edges by the share of what they are off.

# Standard deviation of each edge of a box that somebody drew by hand.
DRAWN_SIGMA_PX = 1.0


class DrawnBox(NamedTuple):
    """A rectangle in a picture, in pixels; its left top corner, and its size."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float


class SizeAt(Struct, frozen=True, kw_only=True):
    """Width and height of something at a known distance, with their standard deviations."""

    width_m: float
    height_m: float
    width_sigma_m: float
    height_sigma_m: float


def size_at(
    measured: Measurement, parts: SigmaParts, shape: TargetShape, is_upright: bool, at: tuple[float, float]
) -> SizeAt | None:
    """Return the size of a target, whatever size it is taken for; None if it was not measured.

    The distance that is measured is in proportion to the size that it is taken for, at any tilt and anywhere in the
    picture. So the true size is as many times that one as the true distance is that which was measured.

    Args:
        measured: By its size.
        parts: The causes of the standard deviation of that.
        is_upright: Whether it appears higher than wide.
        at: How far its centre truly is, and the standard deviation of that, in metres.
    """
    distance_m = measured.distance_m
    if not distance_m:
        return None
    scale = at[0] / distance_m
    others_m = math.hypot(parts.edges_m, parts.focal_length_m, parts.pose_m)
    share = math.hypot(at[1] / at[0], others_m / distance_m)
    sides = sorted((scale * shape.longest_m, scale * shape.shortest_m), reverse=not is_upright)
    return SizeAt(width_m=sides[0], height_m=sides[1], width_sigma_m=share * sides[0], height_sigma_m=share * sides[1])


def box_size_at(box: DrawnBox, camera: CameraModel, at: tuple[float, float]) -> SizeAt:
    """Return the size of what fills a box, if it faces the camera, square to the optical axis.

    Args:
        camera: The camera model at the picture's resolution.
        at: How far the middle of the box is along the straight line, and the standard deviation of that, in metres.
    """
    middle = box.x_px + box.width_px / 2, box.y_px + box.height_px / 2
    ends = [
        (box.x_px, middle[1]), (box.x_px + box.width_px, middle[1]),
        (middle[0], box.y_px), (middle[0], box.y_px + box.height_px), middle,
    ]  # fmt: skip
    left, right, top, bottom, centre = camera.directions(np.array(ends)).tolist()
    depth_m = at[0] / math.hypot(1.0, *centre)
    width_m, height_m = depth_m * (right[0] - left[0]), depth_m * (bottom[1] - top[1])
    # Both edges err independently, so their difference by √2 times as much.
    common = math.hypot(at[1] / at[0], camera.distance_share(*middle))
    edges_m = math.sqrt(2) * DRAWN_SIGMA_PX * depth_m
    return SizeAt(
        width_m=width_m,
        height_m=height_m,
        width_sigma_m=math.hypot(edges_m / camera.fx_px, common * width_m),
        height_sigma_m=math.hypot(edges_m / camera.fy_px, common * height_m),
    )
