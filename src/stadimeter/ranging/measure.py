"""From a detection to a distance, with its standard deviation and direction."""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.target import BallSize, DiscSize, SheetSize, TagSize, TargetSize
from stadimeter.ranging.ball import read_ball
from stadimeter.ranging.disc import read_disc
from stadimeter.ranging.reading import Reading
from stadimeter.ranging.sheet import read_sheet
from stadimeter.ranging.tag import read_tag

_STATUS = {
    DetectionStatus.TRUNCATED: MeasurementStatus.TRUNCATED,
    DetectionStatus.NOT_FOUND: MeasurementStatus.NOT_FOUND,
}


def measure_frame(frame: Frame, detection: Detection, size: TargetSize, camera: CameraModel) -> Measurement:
    """Measure how far away a target is in a frame, whatever the frame's resolution.

    Args:
        frame: The frame.
        detection: Where the target is in it.
        size: The target's size.
        camera: A camera model for any resolution of the same aspect.

    Returns:
        The measurement.

    Raises:
        CalibrationError: The frame has another aspect than the camera model.
    """
    return measure(detection, size, camera.scaled_to(frame.width_px, frame.height_px), frame.captured_at_s)


def measure(detection: Detection, size: TargetSize, camera: CameraModel, captured_at_s: float) -> Measurement:
    """Measure how far away a target is.

    Where the target's centre is in the camera frame comes from `stadimeter.ranging.ball` or `stadimeter.ranging.sheet`;
    its length is the distance.

    The standard deviation has two causes: what differs from frame to frame, such as the noise of edges, which makes the
    distance uncertain in proportion to its square; and what stays, such as the error of the focal length or of the
    target's size, which is the same share of every distance.

    Args:
        detection: Where the target is in the picture, or why it is not.
        size: The target's size.
        camera: The camera model at the picture's resolution.
        captured_at_s: When the picture was taken, on the run's monotonic clock.

    Returns:
        The measurement; without figures, and with the detection's reason, unless the target was found whole.
    """
    if detection.status is not DetectionStatus.FOUND:
        return _without_figures(detection, _STATUS[detection.status], detection.reason, captured_at_s)
    if not (0 < detection.width_px < math.inf and 0 < detection.height_px < math.inf):
        reason = f"the detector reports an apparent size of {detection.width_px:g}x{detection.height_px:g} px"
        return _without_figures(detection, MeasurementStatus.ERROR, reason, captured_at_s)
    lasting_share = math.hypot(camera.focal_relative_sigma, size.relative_sigma)
    return _with_figures(detection, captured_at_s, _reading(detection, size, camera), lasting_share)


def _reading(detection: Detection, size: TargetSize, camera: CameraModel) -> Reading:
    match size:
        case BallSize():
            return read_ball(detection, size, camera)
        case SheetSize():
            return read_sheet(detection, size, camera)
        case TagSize():
            return read_tag(detection, size, camera)
        case DiscSize():
            return read_disc(detection, size, camera)


def _with_figures(detection: Detection, captured_at_s: float, reading: Reading, lasting_share: float) -> Measurement:
    x_m, y_m, depth_m = reading.position_m
    straight_m = math.sqrt(x_m * x_m + y_m * y_m + depth_m * depth_m)
    return Measurement(
        target=detection.target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=captured_at_s,
        distance_m=straight_m,
        depth_m=depth_m,
        sigma_m=straight_m * math.hypot(reading.noise_share, reading.systematic_share, lasting_share),
        noise_m=straight_m * reading.noise_share,
        bearing_rad=math.atan2(x_m, depth_m),
        elevation_rad=-math.atan2(y_m, math.hypot(depth_m, x_m)),
        tilt_rad=reading.tilt_rad,
        ambiguity=reading.ambiguity,
    )


def _without_figures(detection: Detection, status: MeasurementStatus, reason: str, captured_at_s: float) -> Measurement:
    return Measurement(target=detection.target, status=status, captured_at_s=captured_at_s, reason=reason)
