"""Two cameras in a run: what the first one has found is looked for in the second one's picture, and measured by both.

Both run freely, so their pictures are not of one moment. While it is tracked, a target's motion is known: where it was
in the second picture is brought to the time of the first one, and what the motion may be off by counts as noise of that
place. Of a baseline b, a way v Δt across makes a share v Δt / b of the distance; so pictures may be the further apart,
the better the motion is known. Whatever keeps both from measuring together, the first camera measures alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.detection import Detection, DetectionStatus, Prediction, Values
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, Track
from stadimeter.core.sensor_fusion import DISAGREEMENT_SIGMAS
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.detectors.protocol import Detector, TracksSeveral
from stadimeter.errors import PictureError, StadimeterError
from stadimeter.perception import prediction
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.stereo import measure_pair

# A pair whose target may have moved otherwise than expected by more than this share of the baseline is not used: at 12
# cm that is 5 ms of a target of 1 m/s of which nothing is known, and 50 ms of one that moves evenly.
MOVED_SHARE = 0.05

# However still a target is, pictures further apart are not of one moment.
MAX_APART_S = 0.05

# A motion may change by this share of itself from one picture to the other.
CHANGE_SHARE = 0.1

# A target of unknown size that is not tracked is taken to be as far away as this, and to move as one there does.
ASSUMED_M = 1.0

TOGETHER, TOGETHER_AND_SIZE = "by two cameras", "by two cameras and its size"


class _Whereabouts(Struct, frozen=True, eq=False):
    """The place of a target in the left camera's frame when the first picture was taken, and when the second one was.

    Attributes:
        moved_m: By how much it may have moved otherwise, as a standard deviation.
        sigma_m: Of its distance; infinite for a target of unknown size that is not tracked.
    """

    now_m: Values
    then_m: Values
    moved_m: float
    sigma_m: float


class SecondView:
    """Measures targets with a second camera too.

    Args:
        detectors: Those of the first camera once more, by target: they may remember what they have seen.
    """

    def __init__(self, rig: StereoRig, detectors: Mapping[str, Detector]) -> None:
        self._rig, self._detectors = rig, detectors
        self._rotation = np.asarray(cv2.Rodrigues(np.array(rig.turn_rad))[0])
        self._scaled: tuple[object, StereoRig] = (None, rig)
        self._motions: dict[str, prediction.AngularMotion | None] = {}

    def join(self, seen: SeenTarget, track: Track | None, frame: Frame, second: Frame | None) -> Measurement:
        """Return a target as both cameras together have it, or as the first one alone; its reason says which.

        Args:
            seen: In the first camera's frame, by its own size.
            track: What is known of it from before.
            second: The second camera's frame that is nearest in time; None for none.
        """
        name = seen.measurement.target
        motion = prediction.follow(self._motions.get(name), track, seen.shape) if track is not None else None
        self._motions[name] = motion
        if seen.measurement.position_m is None:
            return seen.measurement
        try:
            if second is None:
                raise PictureError("it gives no picture")
            return self._measure(seen, track, motion, frame, second)
        except StadimeterError as error:  # whatever is wrong with the second camera, the first one goes on
            return _with_remark(seen.measurement, f"without the second camera: {error}")

    def _measure(
        self,
        seen: SeenTarget,
        track: Track | None,
        motion: prediction.AngularMotion | None,
        frame: Frame,
        second: Frame,
    ) -> Measurement:
        rig, apart_s = self._rig_for(frame, second), second.captured_at_s - frame.captured_at_s
        where = _whereabouts(seen, track, motion, frame.captured_at_s, apart_s)
        limit_s = min(MAX_APART_S, abs(apart_s) * MOVED_SHARE * rig.baseline_m / max(where.moved_m, 1e-9))
        if apart_s and not abs(apart_s) <= limit_s:
            raise PictureError(f"pictures are {1e3 * abs(apart_s):.0f} ms apart, limit {1e3 * limit_s:.0f} ms")
        now_m, then_m = ((each - rig.place_m) @ self._rotation for each in (where.now_m, where.then_m))
        now_px, then_px = rig.right.project(np.array([each[:2] / each[2] for each in (now_m, then_m)]))
        moved_px = where.moved_m * rig.right.fx_px / float(then_m[2])
        found = self._find(seen, (where, float(then_m[2]), then_px, moved_px), rig, second)
        found = _bring(found, now_px - then_px, float(then_m[2] / now_m[2]))
        right = replace(seen, detection=found, measurement=measure(found, seen.shape, rig.right, frame.captured_at_s))
        if right.measurement.position_m is None:
            raise PictureError(right.measurement.reason)
        joined, figures = measure_pair(seen, right, rig, moved_px, DISAGREEMENT_SIGMAS)
        if figures is None:
            raise PictureError(joined.reason)
        said = TOGETHER_AND_SIZE if math.isfinite(seen.shape.relative_sigma) else TOGETHER
        return _with_remark(joined, figures.disagreement or said)

    def _find(
        self, seen: SeenTarget, there: tuple[_Whereabouts, float, Values, float], rig: StereoRig, second: Frame
    ) -> Detection:
        """Look for a target in the second picture where it is expected; everywhere if it may be anywhere."""
        (where, depth_m, there_px, moved_px), lens, expected = there, rig.right, None
        if math.isfinite(where.sigma_m):
            per_m = lens.fx_px / depth_m
            left_px = max(seen.detection.width_px, seen.detection.height_px)
            size_px = left_px * per_m * float(where.now_m[2]) / rig.left.fx_px
            # The disparity f b / Z errs by f b / Z² of what the distance errs by.
            across_px = per_m * rig.baseline_m * where.sigma_m / depth_m
            sigma_px = math.hypot(prediction.FLOOR_PX, prediction.FLOOR_SHARE * size_px, across_px, moved_px)
            centre_px = float(there_px[0]), float(there_px[1])
            expected = prediction.check_useful(
                Prediction(centre_px=centre_px, size_px=size_px, sigma_px=sigma_px), lens
            )
            if expected is None:
                raise PictureError("the target is out of its view, or may be anywhere in it")
        detector = self._detectors[seen.measurement.target]
        if expected is not None and isinstance(detector, TracksSeveral):
            found = detector.detect_near(second, expected, lens=lens)
        else:
            found = detector.detect(second, expected, lens=lens)
        if found.status is not DetectionStatus.FOUND or found.number != seen.detection.number:
            raise PictureError(f"not in its picture: {found.reason or f'it shows number {found.number}'}")
        return found

    def _rig_for(self, frame: Frame, second: Frame) -> StereoRig:
        """Return the rig at the frames' resolutions and settings, which hardly ever change."""
        key = tuple((each.image.shape, each.subsampling, each.optics) for each in (frame, second))
        if self._scaled[0] != key:
            self._scaled = key, self._rig.for_frames(frame, second)
        return self._scaled[1]


def _whereabouts(
    seen: SeenTarget, track: Track | None, motion: prediction.AngularMotion | None, at_s: float, apart_s: float
) -> _Whereabouts:
    measured = seen.measurement
    distance_m, sigma_m, closing_mps = measured.distance_m or ASSUMED_M, measured.sigma_m or math.inf, 0.0
    if track is not None and (known := prediction.bring_to_time(track, at_s)) is not None:
        distance_m, sigma_m, closing_mps = known.distance_m, known.sigma_m, track.closing_mps or 0.0
    elif math.isinf(sigma_m):
        distance_m = ASSUMED_M
    unsure_radps, across_radps, up_radps = prediction.loose_radps(distance_m), 0.0, 0.0
    if motion is not None and motion.step_s > 0:
        unsure_radps = motion.innovation_rad / motion.step_s
        across_radps, up_radps = motion.bearing_radps, motion.elevation_radps
    now_m, then_m = (
        (distance_m - closing_mps * later_s)
        * _direction(
            (measured.bearing_rad or 0.0) + across_radps * later_s, (measured.elevation_rad or 0.0) + up_radps * later_s
        )
        for later_s in (0.0, apart_s)
    )
    moved_m = math.hypot(unsure_radps * distance_m * apart_s, CHANGE_SHARE * math.dist(now_m, then_m))
    return _Whereabouts(now_m, then_m, moved_m, sigma_m)


def _direction(bearing_rad: float, elevation_rad: float) -> Values:
    """Return the unit vector of a direction in the camera frame: x right, y down, z forward."""
    level = math.cos(elevation_rad)
    return np.array((math.sin(bearing_rad) * level, -math.sin(elevation_rad), math.cos(bearing_rad) * level))


def _bring(found: Detection, by_px: Values, larger: float) -> Detection:
    """Return a detection where, and as large as, the target was when the first picture was taken."""
    x_px, y_px = found.centre_px
    centre_px = np.array((x_px, y_px)) + by_px
    return replace(
        found,
        centre_px=(float(centre_px[0]), float(centre_px[1])),
        outline_px=(found.outline_px - (x_px, y_px)) * larger + centre_px,
        width_px=found.width_px * larger,
        height_px=found.height_px * larger,
    )


def _with_remark(measured: Measurement, remark: str) -> Measurement:
    return replace(measured, reason="; ".join(filter(None, (measured.reason, remark))))
