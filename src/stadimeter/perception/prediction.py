"""Expected places of targets in the next frame: predictions from their tracks.

A prediction must be quick and honest about its uncertainty, not clever: what is not found there is looked for in the
whole picture. The distance goes on as the track has it. The direction goes on as it changed between the last two
sightings, and what that was off by is what the next prediction may be off by: a target that rests, or moves evenly, is
expected within a pixel or two, one that a hand waves about within some tens.
"""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import CameraPose, Landmarks
from stadimeter.core.detection import DetectionStatus, Prediction, TargetShape
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Track
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.detectors.protocol import FindsSeveral
from stadimeter.ranging.camera_pose import ExpectedPose, SeenLandmark, locate_camera
from stadimeter.ranging.flat import UprightShape

# Each target is looked for in the whole frame this often, in time of capture.
SEARCH_EVERY_S = 1.0

# A target that was not measured for longer than this may be anywhere.
UNSEEN_MAX_S = 0.5

# How fast targets move across the line of sight, as a standard deviation: a person walks at 1.4 m/s. It counts while
# nothing is known of the motion.
LATERAL_MPS = 1.0

# How fast the camera turns, as a standard deviation: a robot that follows turns at about 1 rad/s at most.
TURN_RADPS = 0.5

# A target hidden behind another one of its kind is remembered for this long. Its motion was known: it goes on, and what
# the target may have moved otherwise is this share of what one of unknown motion may.
REMEMBERED_S = 1.5
REMEMBERED_DRIFT = 0.4

# The innovation of one prediction counts for the next ones too, by this factor less with each.
INNOVATION_DECAY = 0.85

# That much of it is noise of the place where a box is.
NOISE_SIGMAS = 2.0

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


class Expectations:
    """Decides in which frames each target is looked for where it is expected. One for each run."""

    def __init__(self) -> None:
        self._searched_at_s: dict[str, float] = {}
        self._motions: dict[str, AngularMotion | None] = {}

    def of(self, track: Track | None, shape: TargetShape, camera: CameraModel, at_s: float) -> Prediction | None:
        """Return where a target is expected in a frame; None to search all of it. Asked once for a target and frame."""
        if track is None:
            return None
        motion = self._motions[track.target] = follow(self._motions.get(track.target), track, shape)
        # Capture time, not frames: the period holds at any frame rate, and in replays. A clock that goes back searches
        # the whole frame.
        since_s = at_s - self._searched_at_s.get(track.target, -math.inf)
        expected = predict(track, shape, camera, at_s, motion) if 0 <= since_s < SEARCH_EVERY_S else None
        if expected is None:
            self._searched_at_s[track.target] = at_s
        return expected


class AngularMotion(Struct, frozen=True, kw_only=True):
    """The change of the direction of a target."""

    at_s: float  # the capture time of its last sighting
    bearing_rad: float
    elevation_rad: float
    bearing_radps: float = 0.0  # how fast the bearing changed since the sighting before
    elevation_radps: float = 0.0
    innovation_rad: float = 0.0  # how far from where it was expected it appeared of late
    # The time since the sighting before; 0 if there was none, so that nothing is known of the motion.
    step_s: float = 0.0


def follow(motion: AngularMotion | None, track: Track, shape: TargetShape) -> AngularMotion | None:
    """Return the motion with the newest sighting taken in; None of a target that is not tracked.

    Places of targets are known to a fraction of a pixel, so their rate is that between two sightings. Those of boxes
    are not: the middle of a person's box goes to and fro by some percent of its height. Place and rate are those of an
    alpha-beta filter then (P. R. Kalata, "The tracking index", IEEE Trans. AES 20, 1984).
    """
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
    across_rad = bearing_rad - motion.bearing_rad - motion.bearing_radps * step_s
    up_rad = elevation_rad - motion.elevation_rad - motion.elevation_radps * step_s
    off_rad = math.hypot(across_rad * math.cos(elevation_rad), up_rad)
    distance_m = track.distance_m or math.inf
    noise_rad = shape.box_sigma * shape.longest_m / distance_m if isinstance(shape, UprightShape) else 0.0
    if not off_rad <= JUMP_SIGMAS * math.hypot(loose_radps(distance_m) * step_s, noise_rad):
        return AngularMotion(at_s=at_s, bearing_rad=bearing_rad, elevation_rad=elevation_rad)
    place_gain, rate_gain = _gains(noise_rad, loose_radps(distance_m) * step_s * step_s)
    return AngularMotion(
        at_s=at_s,
        bearing_rad=bearing_rad - (1 - place_gain) * across_rad,
        elevation_rad=elevation_rad - (1 - place_gain) * up_rad,
        bearing_radps=motion.bearing_radps + rate_gain * across_rad / step_s,
        elevation_radps=motion.elevation_radps + rate_gain * up_rad / step_s,
        innovation_rad=max(off_rad - NOISE_SIGMAS * noise_rad, INNOVATION_DECAY * motion.innovation_rad),
        step_s=step_s,
    )


def _gains(noise_rad: float, manoeuvre_rad: float) -> tuple[float, float]:
    """Return the gains of place and rate, by the noise of a sighting and by what a second's change of rate moves."""
    if noise_rad <= 0:
        return 1.0, 1.0
    index = manoeuvre_rad / noise_rad
    rest = (4 + index - math.sqrt(8 * index + index * index)) / 4
    place = 1 - rest * rest
    return place, min(1.0, 2 * (2 - place) - 4 * rest)


def predict(
    track: Track,
    shape: TargetShape,
    camera: CameraModel,
    at_s: float,
    motion: AngularMotion | None = None,
    *,
    is_remembered: bool = False,
) -> Prediction | None:
    """Return where and how large a target will appear.

    None unless the target is tracked, or coasts and was measured within `UNSEEN_MAX_S`, its figures are finite, it is
    in front of the camera and in the picture, and the uncertainty leaves anything out.

    Args:
        camera: The camera model at the picture's resolution.
        at_s: When the picture was taken, on the run's monotonic clock.
        motion: How its direction changes, with this track taken in; None for not known.
        is_remembered: Whether it goes on for `REMEMBERED_S`, as one that may be hidden for a while.
    """
    known = bring_to_time(track, at_s, REMEMBERED_S if is_remembered else UNSEEN_MAX_S)
    if known is None:
        return None
    bearing_rad, elevation_rad, sigma_rad = _direction(known, motion, is_remembered=is_remembered)
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
    return check_useful(Prediction(centre_px=centre_px, size_px=size_px, sigma_px=sigma_px), camera)


class KnownFigures(Struct):
    """The figures of a track, brought to the time of the picture."""

    distance_m: float
    sigma_m: float  # its standard deviation
    bearing_rad: float  # the bearing of the last sighting
    elevation_rad: float
    unseen_s: float


def bring_to_time(track: Track, at_s: float, unseen_max_s: float = UNSEEN_MAX_S) -> KnownFigures | None:
    """Return the figures of a track at a time; None unless it is valid and was measured not too long before."""
    if not track.is_valid or track.as_of_s is None or track.measured_at_s is None or track.sigma_m is None:
        return None
    if track.distance_m is None or track.bearing_rad is None or track.elevation_rad is None:
        return None
    unseen_s, ahead_s = at_s - track.measured_at_s, at_s - track.as_of_s
    if not 0 <= unseen_s <= unseen_max_s:
        return None
    return KnownFigures(
        track.distance_m - (track.closing_mps or 0.0) * ahead_s,
        math.hypot(track.sigma_m, (track.closing_sigma_mps or 0.0) * ahead_s),
        track.bearing_rad,
        track.elevation_rad,
        unseen_s,
    )


def loose_radps(distance_m: float) -> float:
    """Return the speed of the direction of a target of which nothing is known, as a standard deviation."""
    return math.hypot(LATERAL_MPS / max(distance_m, 1e-6), TURN_RADPS)


def _direction(known: KnownFigures, motion: AngularMotion | None, *, is_remembered: bool) -> tuple[float, float, float]:
    """Return bearing, elevation, and the standard deviation of the direction."""
    unseen_s = known.unseen_s
    drift_radps = loose_radps(known.distance_m)
    if motion is None or motion.step_s <= 0:
        return known.bearing_rad, known.elevation_rad, drift_radps * unseen_s
    # The rate goes on for two steps at most; beyond that only the uncertainty grows, by 1 m/s across at the target's
    # distance and 0.5 rad/s of the camera's own turning.
    even_s = min(unseen_s, EVEN_STEPS * motion.step_s)
    on_s, drift = (unseen_s, REMEMBERED_DRIFT) if is_remembered else (even_s, 1.0)
    return (
        motion.bearing_rad + motion.bearing_radps * on_s,
        motion.elevation_rad + motion.elevation_radps * on_s,
        motion.innovation_rad * unseen_s / motion.step_s + drift * drift_radps * (unseen_s - even_s),
    )


def _size_share(known: KnownFigures, shape: TargetShape, lens_share: float) -> float:
    """Return the standard deviation of the apparent size as a share of it.

    An error of the lens or of the target's size is in the track's distance as it is in this prediction, and cancels
    out.
    """
    share = known.sigma_m / max(known.distance_m, 1e-6)
    # Track σ² = noise² + lens² + size²; only the noise moves the apparent size between frames.
    rest = share * share - lens_share**2 - shape.relative_sigma**2
    return math.sqrt(rest) if rest > 0 else 0.0


def check_useful(expected: Prediction, camera: CameraModel) -> Prediction | None:
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


# The place of the camera itself, frame by frame: the tags of known places are looked for, and their corners tell ------

# A tag counts as moved once this many frames in a row say so: by chance one in 100,000 does.
MOVED_FRAMES = 5


class CameraLocator:
    """Finds the pose of one camera in one frame after the other."""

    def __init__(self, landmarks: Landmarks, detector: FindsSeveral, viewpoint: Viewpoint) -> None:
        self._landmarks = landmarks
        self._tags = {tag.number: tag for tag in landmarks.tags}
        self._detector = detector
        self._expected = ExpectedPose(viewpoint)
        self._moved: dict[int, int] = {}  # in how many frames in a row each tag was not where it should be

    def locate(self, frame: Frame, lens: CameraModel) -> CameraPose:
        """Return where the camera was when a frame was taken, or why that is not known.

        Args:
            lens: The camera model at the frame's resolution.
        """
        found = self._detector.detect_all(frame, lens=lens)
        seen = [
            SeenLandmark(self._tags[each.number], each)
            for each in found
            if each.status is DetectionStatus.FOUND and each.number in self._tags
        ]
        pose = locate_camera(seen, self._landmarks, lens, self._expected, frame.captured_at_s)
        self._moved = {number: self._moved.get(number, 0) + 1 for number in pose.moved}
        if pose.position_m is not None:
            self._expected = self._expected._replace(before=pose)
        return pose

    def trouble(self) -> str:
        """Return which tags are not where the configuration says, in words; empty for none."""
        moved = tuple([number for number, frames in self._moved.items() if frames >= MOVED_FRAMES])
        return replace(CameraPose(captured_at_s=0.0), moved=moved).moved_words
