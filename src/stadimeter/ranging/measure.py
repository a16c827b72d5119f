"""From a detection to a distance, with its standard deviation and direction."""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Reading, TargetShape
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
