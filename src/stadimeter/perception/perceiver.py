"""From a frame and the tracks to measurements: the lens scaled, each target looked for where it is expected, measured.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. Its answer
there is final, so something that was once mistaken for the target could hold its place for ever, while the target is in
plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from stadimeter.core.detection import Detection, Points, Prediction, TargetShape
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.measurement import Measurement, Track
from stadimeter.detectors.protocol import Detector, TracksSeveral
from stadimeter.perception.prediction import Expectations
from stadimeter.perception.several import Several
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import measure, unmeasured
from stadimeter.ranging.separation import SeenTarget

if TYPE_CHECKING:  # most runs have one camera
    from stadimeter.perception.second_camera import SecondView
from collections import deque

from msgspec import Struct, field

# Motion blur of the targets of a run, and the exposure that avoids it -------------------------------
#
# A target that moves at v pixels a second is smeared by b = v·t while it is exposed for t. Measured on rendered
# pictures, smeared along one side, of targets of s pixels: up to b/s = 0.03 distances are off by 0.5 % at most; at
# 0.1 those of a ball by -0.6 %, of a sheet by 0.7 %, of a tag by -3.5 %. Beyond that a sheet's may be off by 13 %,
# and targets are lost.

# A target is blurred by motion if it is smeared by more than this share of its size, and by more than this.
BLURRED_SHARE = 0.03
BLURRED_PX = 1.0

# The exposure that is advised leaves a smear of this share: less cannot be seen in the distance.
WANTED_SHARE = 0.02

# Blur is worth a word in more than this share of the sightings, and if it was seen this often.
BLURRED_OF_SIGHTINGS = 0.05
SIGHTINGS_MIN = 5

# The exposure is advised for what is blurred less than the worst tenth of the blurred sightings.
SPEED_PERCENTILE = 0.9

# Two sightings further apart than this do not tell a speed.
APART_MAX_S = 0.2

KEPT = 500


class _Smear(NamedTuple):
    share: float  # of the target's size
    smear_px: float
    speed_mps: float  # across the line of sight, of target and camera together
    exposure_s: float


class _Sighting(NamedTuple):
    captured_at_s: float
    found: Detection


class _Watched(Struct):
    last: _Sighting | None = None
    sightings: int = 0
    blurred: int = 0
    smears: deque[_Smear] = field(default_factory=lambda: deque(maxlen=KEPT))  # the newest blurred ones


class MotionBlur:
    """Watches the targets of a run, in frames of known exposure; others are left out."""

    def __init__(self) -> None:
        self._targets: dict[str, _Watched] = {}

    def add(self, frame: Frame, found: Detection, measured: Measurement, focal_px: float) -> None:
        """Take in where a target is in a frame.

        Args:
            focal_px: The focal length at the frame's resolution.
        """
        if frame.exposure_s is None:
            return
        watched = self._targets.setdefault(measured.target, _Watched())
        before, watched.last = watched.last, None
        if measured.depth_m is None:
            return
        watched.last = _Sighting(frame.captured_at_s, found)
        speed_px_s = _speed_px_s(before, watched.last)
        if speed_px_s is None:
            return
        watched.sightings += 1
        # b = v t in pixels; held against the smaller side, which the distance suffers most on.
        smear_px = speed_px_s * frame.exposure_s
        share = smear_px / max(1.0, min(found.width_px, found.height_px))
        if share > BLURRED_SHARE and smear_px > BLURRED_PX:
            watched.blurred += 1
            speed_mps = speed_px_s * measured.depth_m / focal_px
            watched.smears.append(_Smear(share, smear_px, speed_mps, frame.exposure_s))

    def advice(self) -> tuple[str, ...]:
        """Return a sentence on each target that motion blurs, with the exposure to write; nothing if none is."""
        return tuple(
            _advice(target, watched)
            for target, watched in self._targets.items()
            if watched.blurred >= max(SIGHTINGS_MIN, BLURRED_OF_SIGHTINGS * watched.sightings)
        )


def _speed_px_s(before: _Sighting | None, now: _Sighting) -> float | None:
    """Return the speed of the edges of a target in the picture: its centre, and half of what its size changes by."""
    if before is None or before.found.number != now.found.number:
        return None
    apart_s = now.captured_at_s - before.captured_at_s
    if not 0 < apart_s <= APART_MAX_S:
        return None
    # An approach moves opposite edges apart: each by half of what the size grows.
    grown_px = max(abs(now.found.width_px - before.found.width_px), abs(now.found.height_px - before.found.height_px))
    return (math.dist(now.found.centre_px, before.found.centre_px) + grown_px / 2) / apart_s


def _advice(target: str, watched: _Watched) -> str:
    # Sorted by share of the size. Smear is proportional to exposure, so the wanted share scales the exposure that was
    # measured.
    smears = sorted(watched.smears)
    smear = smears[int(SPEED_PERCENTILE * len(smears))]
    percent = math.ceil(100 * watched.blurred / watched.sightings)
    wanted_ms = _at_most_ms(smear.exposure_s * WANTED_SHARE / smear.share)
    return (
        f"{target}: blurred by {smear.smear_px:.1f} px at {smear.speed_mps:.1f} m/s, {smear.share:.0%} of its size,"
        f" with an exposure of {1e3 * smear.exposure_s:.3g} ms (in {percent} % of the frames): its distance is unsure"
        f' then. Write exposure = "{wanted_ms:g} ms" in [camera], with more light'
    )


def _at_most_ms(exposure_s: float) -> float:
    """Return an exposure in milliseconds, rounded down to two digits; 0.1 at least, which is a camera's step."""
    exposure_ms = 1e3 * exposure_s
    step_ms = 10.0 ** (math.floor(math.log10(exposure_ms)) - 1) if exposure_ms > 0 else 0.1
    return max(0.1, round(math.floor(exposure_ms / step_ms) * step_ms, 6))


# ----------------------------------------------------------------------------------------------------


class Perceiver:
    """Looks for the targets of one run, by name, and measures them. Names with one detector are of one kind.

    The lens, at any resolution of the frames' aspect, is scaled here, once for each resolution, and passed on:
    detectors and ranging must see the very same one.
    """

    def __init__(
        self,
        detectors: Mapping[str, Detector],
        camera_model: CameraModel,
        footings: Mapping[str, Footing] | None = None,
        second: SecondView | None = None,
    ) -> None:
        self.detectors = detectors
        self._footings = footings or {}
        self._second = second
        self._larger: dict[str, float] = {}  # of targets of unknown size, how much larger than assumed they are
        self._camera_model = camera_model
        self._lens = camera_model
        self._optics: Optics | None = None
        self._sightings: dict[str, LastOutline] = {}
        self._kinds = _kinds_of(detectors)
        self.expectations = Expectations()
        self.motion_blur = MotionBlur()

    def look(
        self, frame: Frame, tracks: Mapping[str, Track] | None = None, second: Frame | None = None
    ) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target, with what tracks tell; return a detection and a measurement for each.

        Args:
            second: Of a run with a second camera, its frame that is nearest in time; None for none.

        Raises:
            CalibrationError: The frame has another aspect than the camera model, or the camera was set otherwise.
        """
        lens, at_s = self.lens_of(frame), frame.captured_at_s
        detections, measurements = [], []
        members: dict[str, Detection] = {}
        for kind in self._kinds:
            members |= kind.look(frame, lens, tracks or {})
        for name, detector in self.detectors.items():
            shape = detector.target_shape
            found = members.get(name)
            if found is None:
                expected = self.expectations.of(tracks.get(name), shape, lens, at_s) if tracks else None
                if expected is not None:
                    larger = expected.size_px * self._larger.get(name, 1.0)
                    expected = add_outline(replace(expected, size_px=larger), self._sightings.get(name), shape, lens)
                found = detector.detect(frame, expected, lens=lens)
            measured = self._measure(found, shape, frame, (tracks or {}).get(name), second)
            if shape.has_corners and measured.depth_m is not None:
                self._sightings[name] = LastOutline(found.outline_px, found.centre_px, measured.depth_m)
            self.motion_blur.add(frame, found, measured, lens.fx_px)
            detections.append(found)
            measurements.append(measured)
        return tuple(detections), tuple(measurements)

    def _measure(
        self, found: Detection, shape: TargetShape, frame: Frame, track: Track | None, second: Frame | None
    ) -> Measurement:
        """Measure a target by its size, and by a second camera or the floor."""
        lens = self._lens
        by_size = measured = measure(found, shape, lens, frame.captured_at_s)
        if self._second is not None:
            seen = SeenTarget(detection=found, measurement=by_size, shape=shape)
            measured = self._second.join(seen, track, frame, second)
        is_joined = measured.distance_m != by_size.distance_m
        if found.target in self._footings and not is_joined:
            measured = stand(measured, found, shape, lens, self._footings[found.target]).measurement
        return self._without_size(measured, by_size) if math.isinf(shape.relative_sigma) else measured

    def _without_size(self, measured: Measurement, by_size: Measurement) -> Measurement:
        """Return the measurement made without the size, and learn that; or that nothing was."""
        if measured.distance_m is None or not math.isfinite(measured.sigma_m or math.inf):
            return measured if measured.distance_m is None else unmeasured(measured)
        self._larger[measured.target] = measured.distance_m / (by_size.distance_m or math.inf)
        return measured

    def lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model for the frame, whose resolution, subsampling and optics hardly ever change."""
        lens = self._lens
        # Scaling a lens takes longer than this comparison, and detector and ranging must get the same object.
        is_same = (lens.width_px, lens.height_px) == (frame.width_px, frame.height_px) and frame.optics is self._optics
        if not is_same or lens.subsampling != (self._camera_model.subsampling or frame.subsampling):
            lens = self._lens = self._camera_model.for_frame(frame)
            self._optics = frame.optics
        return lens


def _kinds_of(detectors: Mapping[str, Detector]) -> tuple[Several, ...]:
    """Find the detectors of each kind of which there are several: the names with one and the same detector."""
    names: dict[int, list[str]] = {}
    for name, detector in detectors.items():
        names.setdefault(id(detector), []).append(name)
    several = ((detectors[members[0]], members) for members in names.values())
    return tuple(
        Several(members, detector)
        for detector, members in several
        if isinstance(detector, TracksSeveral) and (len(members) > 1 or detector.numbers)
    )


class LastOutline(NamedTuple):
    """The corners and the centre of a target when it was last seen, in pixels, and its depth then."""

    outline_px: Points
    centre_px: tuple[float, float]
    depth_m: float


def add_outline(
    expected: Prediction, sighting: LastOutline | None, shape: TargetShape, camera: CameraModel
) -> Prediction:
    """Return a prediction with the corners that were last seen, moved and scaled to where and how large it is."""
    if sighting is None:
        return expected
    # Apparent length then, in pixels by similar triangles; the ratio of both lengths scales the corners about the
    # centre, which is moved.
    then_px = shape.longest_m / sighting.depth_m * math.sqrt(camera.fx_px * camera.fy_px)
    around = sighting.outline_px - np.array(sighting.centre_px)
    outline_px = around * (expected.size_px / then_px) + np.array(expected.centre_px)
    return replace(expected, outline_px=outline_px)
