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
from stadimeter.core.measurement import Measurement
from stadimeter.core.sensor_fusion import DISAGREEMENT_SIGMAS
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.core.track import Track
from stadimeter.detectors.protocol import Detector, TracksSeveral
from stadimeter.errors import StadimeterError
from stadimeter.perception.prediction import FLOOR_PX, FLOOR_SHARE, AngularMotion, bring_to_time, follow, loose_radps
from stadimeter.ranging.measure import measure
from stadimeter.ranging.separation import SeenTarget
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


class _Motion(Struct, frozen=True, eq=False):
    """Where a target is in the left camera's frame, its velocity, and how unsure that is across the line of sight."""

    position_m: Values
    velocity_mps: Values
    unsure_mps: float
    distance_m: float
    sigma_m: float  # of the distance

    def limit_s(self, baseline_m: float) -> float:
        """Return how far apart in time two pictures of it may be."""
        return min(MAX_APART_S, MOVED_SHARE * baseline_m / max(self.unsure_mps, 1e-9))


class SecondView:
    """Measures targets with a second camera too.

    Args:
        detectors: Those of the first camera once more, by target: they may remember what they have seen.
    """

    def __init__(self, rig: StereoRig, detectors: Mapping[str, Detector]) -> None:
        self._rig, self._detectors = rig, detectors
        self._rotation = np.asarray(cv2.Rodrigues(np.array(rig.turn_rad))[0])
        self._scaled: tuple[object, StereoRig] = (None, rig)
        self._motions: dict[str, AngularMotion | None] = {}

    def join(self, seen: SeenTarget, track: Track | None, frame: Frame, second: Frame | None) -> Measurement:
        """Return a target as both cameras together have it, or as the first one alone; its reason says which.

        Args:
            seen: In the first camera's frame, by its own size.
            track: What is known of it from before.
            second: The second camera's frame that is nearest in time; None for none.
        """
        name = seen.measurement.target
        motion = self._motions[name] = follow(self._motions.get(name), track) if track is not None else None
        if seen.measurement.position_m is None:
            return seen.measurement
        try:
            joined = "it gives no picture" if second is None else self._measure(seen, track, motion, frame, second)
        except StadimeterError as error:  # whatever is wrong with the second camera, the first one goes on
            joined = str(error)
        if isinstance(joined, Measurement):
            return joined
        return _with_remark(seen.measurement, f"without the second camera: {joined}")

    def _measure(
        self, seen: SeenTarget, track: Track | None, motion: AngularMotion | None, frame: Frame, second: Frame
    ) -> Measurement | str:
        rig, apart_s = self._rig_for(frame, second), second.captured_at_s - frame.captured_at_s
        known = _motion_of(seen, track, motion, frame.captured_at_s)
        if not abs(apart_s) <= (limit_s := known.limit_s(rig.baseline_m)):
            return f"pictures are {1e3 * abs(apart_s):.0f} ms apart, limit {1e3 * limit_s:.0f} ms"
        now_m, then_m = (
            (known.position_m + known.velocity_mps * after_s - rig.place_m) @ self._rotation
            for after_s in (0.0, apart_s)
        )
        moved_px = rig.right.fx_px * known.unsure_mps * abs(apart_s) / known.distance_m
        found = self._find(seen, known, (rig, then_m, moved_px), second)
        if found.status is not DetectionStatus.FOUND:
            return f"not in its picture: {found.reason}"
        if found.number != seen.detection.number:
            return f"its picture shows number {found.number}"
        found = _bring(found, *(rig.right.project((each[:2] / each[2])[None])[0] for each in (then_m, now_m)))
        found = _scale(found, float(then_m[2] / now_m[2]))
        by_size = measure(found, seen.shape, rig.right, frame.captured_at_s)
        if by_size.position_m is None:
            return by_size.reason
        right = SeenTarget(detection=found, measurement=by_size, shape=seen.shape)
        joined, figures = measure_pair(seen, right, rig, moved_px, DISAGREEMENT_SIGMAS)
        if figures is None:
            return joined.reason
        is_sized = math.isfinite(seen.shape.relative_sigma)
        said = figures.disagreement or (TOGETHER_AND_SIZE if is_sized else TOGETHER)
        return _with_remark(joined, said)

    def _rig_for(self, frame: Frame, second: Frame) -> StereoRig:
        """Return the rig at the frames' resolutions and settings, which hardly ever change."""
        key = tuple((each.image.shape, each.subsampling, each.optics) for each in (frame, second))
        if self._scaled[0] != key:
            self._scaled = key, self._rig.for_frames(frame, second)
        return self._scaled[1]

    def _find(
        self, seen: SeenTarget, known: _Motion, there: tuple[StereoRig, Values, float], second: Frame
    ) -> Detection:
        """Look for a target in the second picture, where it is expected."""
        rig, position_m, moved_px = there
        detector, lens = self._detectors[seen.measurement.target], rig.right
        if not math.isfinite(known.sigma_m):
            return detector.detect(second, lens=lens)
        x, y, z = position_m.tolist()
        if not z > 0:
            return _missing(seen, "it is behind the second camera")
        x_px, y_px = lens.pixel(x / z, y / z)
        if not (-0.5 <= x_px <= lens.width_px - 0.5 and -0.5 <= y_px <= lens.height_px - 0.5):
            return _missing(seen, "it is out of its view")
        size_px = max(seen.detection.width_px, seen.detection.height_px)
        size_px *= float(known.position_m[2]) / z * lens.fx_px / rig.left.fx_px
        # The disparity f b / Z errs by f b / Z² of what the distance errs by.
        across_px = lens.fx_px * rig.baseline_m * known.sigma_m / z**2
        sigma_px = math.hypot(FLOOR_PX, FLOOR_SHARE * size_px, across_px, moved_px)
        expected = Prediction(centre_px=(x_px, y_px), size_px=size_px, sigma_px=sigma_px)
        if isinstance(detector, TracksSeveral):
            return detector.detect_near(second, expected, lens=lens)
        return detector.detect(second, expected, lens=lens)


def _motion_of(seen: SeenTarget, track: Track | None, motion: AngularMotion | None, at_s: float) -> _Motion:
    """Return where a target is and how it moves; of an unknown size with an infinite σ unless it is tracked."""
    measured = seen.measurement
    distance_m, sigma_m, closing_mps = measured.distance_m or ASSUMED_M, measured.sigma_m or math.inf, 0.0
    if track is not None and (known := bring_to_time(track, at_s)) is not None:
        distance_m, sigma_m, closing_mps = known.distance_m, known.sigma_m, track.closing_mps or 0.0
    elif math.isinf(sigma_m):
        distance_m = ASSUMED_M
    bearing_rad, elevation_rad = measured.bearing_rad or 0.0, measured.elevation_rad or 0.0
    sin_b, cos_b = math.sin(bearing_rad), math.cos(bearing_rad)
    sin_e, cos_e = math.sin(elevation_rad), math.cos(elevation_rad)
    along = np.array((sin_b * cos_e, -sin_e, cos_b * cos_e))
    unsure_mps = loose_radps(distance_m) * distance_m
    velocity_mps = -closing_mps * along
    if motion is not None and motion.step_s > 0:
        # d/dt of distance times direction: the directions in which bearing and elevation grow, times their rates.
        across = motion.bearing_radps * np.array((cos_b * cos_e, 0.0, -sin_b * cos_e))
        up = motion.elevation_radps * np.array((-sin_b * sin_e, -cos_e, -cos_b * sin_e))
        velocity_mps = velocity_mps + distance_m * (across + up)
        unsure_mps = math.hypot(
            motion.innovation_rad / motion.step_s * distance_m, CHANGE_SHARE * float(np.linalg.norm(velocity_mps))
        )
    return _Motion(along * distance_m, velocity_mps, unsure_mps, distance_m, sigma_m)


def _bring(found: Detection, then_px: Values, now_px: Values) -> Detection:
    """Return a detection where the target was at the time of the first picture."""
    x_px, y_px = (now_px - then_px).tolist()
    centre_px = found.centre_px[0] + x_px, found.centre_px[1] + y_px
    return replace(found, centre_px=centre_px, outline_px=found.outline_px + (now_px - then_px))


def _scale(found: Detection, factor: float) -> Detection:
    """Return a detection that is larger by a factor, about its centre."""
    around_px = np.array(found.centre_px)
    return replace(
        found,
        outline_px=(found.outline_px - around_px) * factor + around_px,
        width_px=found.width_px * factor,
        height_px=found.height_px * factor,
    )


def _missing(seen: SeenTarget, reason: str) -> Detection:
    return Detection(target=seen.measurement.target, status=DetectionStatus.NOT_FOUND, reason=reason)


def _with_remark(measured: Measurement, remark: str) -> Measurement:
    return replace(measured, reason="; ".join(filter(None, (measured.reason, remark))))
