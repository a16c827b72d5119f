"""From a frame and the tracks to measurements: the lens scaled, each target looked for where it is expected, measured.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. Its answer
there is final, so something that was once mistaken for the target could hold its place for ever, while the target is in
plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.

A prediction must be quick and honest about its uncertainty, not clever: what is not found there is looked for in the
whole picture. The distance goes on as the track has it. The direction goes on as it changed between the last two
sightings, and what that was off by is what the next prediction may be off by: a target that rests, or moves evenly, is
expected within a pixel or two, one that a hand waves about within some tens.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points, Prediction
from stadimeter.core.floor import Footing
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.measurement import Measurement
from stadimeter.core.target import TargetShape
from stadimeter.core.track import Track
from stadimeter.detectors.protocol import Detector
from stadimeter.perception.motion_blur import MotionBlur
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import measure

# Each target is looked for in the whole frame this often, in time of capture.
SEARCH_EVERY_S = 1.0

# A target that was not measured for longer than this may be anywhere.
UNSEEN_MAX_S = 0.5

# How fast targets move across the line of sight, as a standard deviation: a person walks at 1.4 m/s. It counts while
# nothing is known of the motion.
LATERAL_MPS = 1.0

# How fast the camera turns, as a standard deviation: a robot that follows turns at about 1 rad/s at most.
TURN_RADPS = 0.5

# The innovation of one prediction counts for the next ones too, by this factor less with each.
INNOVATION_DECAY = 0.85

# A target further off than this many of those standard deviations has jumped, and its motion is unknown again.
JUMP_SIGMAS = 4.0

# A motion is taken to go on for this many times the step that it was seen in; then only the uncertainty goes on.
EVEN_STEPS = 2.0

# However still everything is, a prediction is taken to err by this, in pixels and as a share of the size.
FLOOR_PX = 1.0
FLOOR_SHARE = 0.02

# A standard deviation beyond this share of the picture's longer side leaves nothing out, so it is no prediction.
USEFUL_SHARE = 0.25

# A target that appears larger than this per unit of depth, over 126 degrees, is too near to be seen whole.
MAX_SIZE_PER_DEPTH = 4.0

_SIDEWAYS_RAD = math.radians(85)


class Perceiver:
    """Looks for the targets of one run, by name, and measures them.

    The lens, at any resolution of the frames' aspect, is scaled here, once for each resolution, and passed on:
    detectors and ranging must see the very same one.
    """

    def __init__(
        self,
        detectors: Mapping[str, Detector],
        camera_model: CameraModel,
        footings: Mapping[str, Footing] | None = None,
    ) -> None:
        self.detectors = detectors
        self._footings = footings or {}
        self._camera_model = camera_model
        self._lens = camera_model
        self._optics: Optics | None = None
        self._sightings: dict[str, LastOutline] = {}
        self.expectations = Expectations()
        self.motion_blur = MotionBlur()

    def look(
        self, frame: Frame, tracks: Mapping[str, Track] | None = None
    ) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target, with what tracks tell; return a detection and a measurement for each.

        Raises:
            CalibrationError: The frame has another aspect than the camera model, or the camera was set otherwise.
        """
        lens, at_s = self.lens_of(frame), frame.captured_at_s
        detections, measurements = [], []
        for name, detector in self.detectors.items():
            shape = detector.target_shape
            expected = self.expectations.of(tracks.get(name), shape, lens, at_s) if tracks else None
            if expected is not None:
                expected = add_outline(expected, self._sightings.get(name), shape, lens)
            found = detector.detect(frame, expected, lens=lens)
            measured = measure(found, shape, lens, at_s)
            if name in self._footings:
                measured = stand(measured, found, shape, lens, self._footings[name]).measurement
            if shape.has_corners and measured.depth_m is not None:
                self._sightings[name] = LastOutline(found.outline_px, found.centre_px, measured.depth_m)
            self.motion_blur.add(frame, found, measured, lens.fx_px)
            detections.append(found)
            measurements.append(measured)
        return tuple(detections), tuple(measurements)

    def lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model for the frame, whose resolution, subsampling and optics hardly ever change."""
        lens = self._lens
        # Scaling a lens takes longer than this comparison, and detector and ranging must get the same object.
        is_same = (lens.width_px, lens.height_px) == (frame.width_px, frame.height_px) and frame.optics is self._optics
        if not is_same or lens.subsampling != (self._camera_model.subsampling or frame.subsampling):
            lens = self._lens = self._camera_model.for_frame(frame)
            self._optics = frame.optics
        return lens


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


class Expectations:
    """Decides in which frames each target is looked for where it is expected. One for each run."""

    def __init__(self) -> None:
        self._searched_at_s: dict[str, float] = {}
        self._motions: dict[str, AngularMotion | None] = {}

    def of(self, track: Track | None, shape: TargetShape, camera: CameraModel, at_s: float) -> Prediction | None:
        """Return where a target is expected in a frame; None to search all of it. Asked once for a target and frame."""
        if track is None:
            return None
        motion = self._motions[track.target] = follow(self._motions.get(track.target), track)
        # Capture time, not frames: the period holds at any frame rate, and in replays. A clock that goes back searches
        # the whole frame.
        since_s = at_s - self._searched_at_s.get(track.target, -math.inf)
        expected = predict(track, shape, camera, at_s, motion) if 0 <= since_s < SEARCH_EVERY_S else None
        if expected is None:
            self._searched_at_s[track.target] = at_s
        return expected


class AngularMotion(Struct, frozen=True, kw_only=True):
    """How the direction of a target changes."""

    at_s: float  # the capture time of its last sighting
    bearing_rad: float
    elevation_rad: float
    bearing_radps: float = 0.0  # how fast the bearing changed since the sighting before
    elevation_radps: float = 0.0
    innovation_rad: float = 0.0  # how far from where it was expected it appeared of late
    # The time since the sighting before; 0 if there was none, so that nothing is known of the motion.
    step_s: float = 0.0


def follow(motion: AngularMotion | None, track: Track) -> AngularMotion | None:
    """Return the motion with the newest sighting taken in; None of a target that is not tracked."""
    at_s, bearing_rad, elevation_rad = track.measured_at_s, track.bearing_rad, track.elevation_rad
    if not track.is_valid or at_s is None or bearing_rad is None or elevation_rad is None:
        return None
    if motion is not None and at_s == motion.at_s:
        return motion
    if motion is None or not 0 < at_s - motion.at_s <= UNSEEN_MAX_S:
        return AngularMotion(at_s=at_s, bearing_rad=bearing_rad, elevation_rad=elevation_rad)
    step_s = at_s - motion.at_s
    # Innovation of the direction: what the last rate did not foretell. An angle of bearing is shorter on the sphere by
    # the cosine of the elevation.
    across_rad, up_rad = bearing_rad - motion.bearing_rad, elevation_rad - motion.elevation_rad
    off_rad = math.hypot(
        (across_rad - motion.bearing_radps * step_s) * math.cos(elevation_rad), up_rad - motion.elevation_radps * step_s
    )
    if not off_rad <= JUMP_SIGMAS * _loose_radps(track.distance_m or math.inf) * step_s:
        return AngularMotion(at_s=at_s, bearing_rad=bearing_rad, elevation_rad=elevation_rad)
    return AngularMotion(
        at_s=at_s,
        bearing_rad=bearing_rad,
        elevation_rad=elevation_rad,
        bearing_radps=across_rad / step_s,
        elevation_radps=up_rad / step_s,
        innovation_rad=max(off_rad, INNOVATION_DECAY * motion.innovation_rad),
        step_s=step_s,
    )


def predict(
    track: Track, shape: TargetShape, camera: CameraModel, at_s: float, motion: AngularMotion | None = None
) -> Prediction | None:
    """Return where and how large a target will appear.

    None unless the target is tracked, or coasts and was measured within `UNSEEN_MAX_S`, its figures are finite, it is
    in front of the camera and in the picture, and the uncertainty leaves anything out.

    Args:
        camera: The camera model at the picture's resolution.
        at_s: When the picture was taken, on the run's monotonic clock.
        motion: How its direction changes, with this track taken in; None for not known.
    """
    known = _bring_to_time(track, at_s)
    if known is None:
        return None
    bearing_rad, elevation_rad, sigma_rad = _direction(known, motion)
    if not (abs(bearing_rad) < _SIDEWAYS_RAD and abs(elevation_rad) < _SIDEWAYS_RAD):
        return None
    # From bearing and elevation (up positive) to the camera frame, x right, y down, z forward, per unit of depth.
    depth_m = known.distance_m * math.cos(elevation_rad) * math.cos(bearing_rad)
    nearer_m = _nearer_m(depth_m, shape)
    if not nearer_m * MAX_SIZE_PER_DEPTH > shape.longest_m:
        return None
    x, y = math.tan(bearing_rad), -math.tan(elevation_rad) / math.cos(bearing_rad)
    # The centre of a ball's outline lies further out than the ball's centre, see `stadimeter.ranging.ball`.
    outwards = 1 + (shape.limb_radius_m / nearer_m) ** 2
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    size_px = shape.longest_m / nearer_m * focal_px
    # d(tan θ) = (1 + tan² θ) dθ: away from the middle an angle takes more pixels.
    across_px = focal_px * sigma_rad * (1 + x * x + y * y)
    centre_px = camera.pixel(x * outwards, y * outwards)
    larger_px = size_px * _size_share(known, shape, camera.distance_share(*centre_px))
    sigma_px = math.hypot(FLOOR_PX, FLOOR_SHARE * size_px, across_px, larger_px)
    return _check_useful(Prediction(centre_px=centre_px, size_px=size_px, sigma_px=sigma_px), camera)


class _Known(Struct):
    """The figures of a track, brought to the time of the picture."""

    distance_m: float
    sigma_m: float  # its standard deviation
    bearing_rad: float  # the bearing of the last sighting
    elevation_rad: float
    unseen_s: float


def _bring_to_time(track: Track, at_s: float) -> _Known | None:
    if not track.is_valid or track.as_of_s is None or track.measured_at_s is None or track.sigma_m is None:
        return None
    if track.distance_m is None or track.bearing_rad is None or track.elevation_rad is None:
        return None
    unseen_s, ahead_s = at_s - track.measured_at_s, at_s - track.as_of_s
    if not 0 <= unseen_s <= UNSEEN_MAX_S:
        return None
    return _Known(
        track.distance_m - (track.closing_mps or 0.0) * ahead_s,
        math.hypot(track.sigma_m, (track.closing_sigma_mps or 0.0) * ahead_s),
        track.bearing_rad,
        track.elevation_rad,
        unseen_s,
    )


def _loose_radps(distance_m: float) -> float:
    """Return how fast the direction of a target changes of which nothing is known, as a standard deviation."""
    return math.hypot(LATERAL_MPS / max(distance_m, 1e-6), TURN_RADPS)


def _direction(known: _Known, motion: AngularMotion | None) -> tuple[float, float, float]:
    """Return bearing, elevation, and the standard deviation of the direction."""
    unseen_s = known.unseen_s
    loose_radps = _loose_radps(known.distance_m)
    if motion is None or motion.step_s <= 0:
        return known.bearing_rad, known.elevation_rad, loose_radps * unseen_s
    # The rate goes on for two steps at most; beyond that only the uncertainty grows, by 1 m/s across at the target's
    # distance and 0.5 rad/s of the camera's own turning.
    on_s = min(unseen_s, EVEN_STEPS * motion.step_s)
    return (
        known.bearing_rad + motion.bearing_radps * on_s,
        known.elevation_rad + motion.elevation_radps * on_s,
        motion.innovation_rad * unseen_s / motion.step_s + loose_radps * (unseen_s - on_s),
    )


def _size_share(known: _Known, shape: TargetShape, lens_share: float) -> float:
    """Return the standard deviation of the apparent size as a share of it.

    An error of the lens or of the target's size is in the track's distance as it is in this prediction, and cancels
    out.
    """
    share = known.sigma_m / max(known.distance_m, 1e-6)
    # Track σ² = noise² + lens² + size²; only the noise moves the apparent size between frames.
    rest = share * share - lens_share**2 - shape.relative_sigma**2
    return math.sqrt(rest) if rest > 0 else 0.0


def _check_useful(expected: Prediction, camera: CameraModel) -> Prediction | None:
    """Return a prediction whose figures are finite, that is in the picture, and that leaves anything out."""
    x_px, y_px = expected.centre_px
    # The picture begins half a pixel before the centre of its first one.
    is_seen = -0.5 <= x_px <= camera.width_px - 0.5 and -0.5 <= y_px <= camera.height_px - 0.5
    is_sure = expected.sigma_px <= USEFUL_SHARE * max(camera.width_px, camera.height_px)
    return expected if is_seen and is_sure and expected.size_px > 0 else None


def _nearer_m(depth_m: float, shape: TargetShape) -> float:
    """Return ``sqrt(Z² - r²)``, by which extents appear smaller; 0 for a target around the camera or behind it."""
    square_m2 = depth_m * depth_m - shape.limb_radius_m * shape.limb_radius_m
    return math.sqrt(square_m2) if depth_m > 0 and square_m2 > 0 else 0.0
