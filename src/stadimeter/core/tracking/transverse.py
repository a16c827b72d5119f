"""The motion of a target across the line of sight: the rates of its bearing and elevation, and whether it stands still.

It is worked out only for targets that some rule asks it of. Each angle goes through the same three filters as the
distance (`stadimeter.core.tracking.motion`): an acceleration of a m/s² at the distance d is one of a / d rad/s². What
they filter is never below zero, so angles are counted from behind the camera.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Mount
from stadimeter.core.measurement import Sighting, Track
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.motion import MotionState, Tracking

# Noise of an angle: never less than a twentieth of a pixel at a focal length of 500, and one pixel where it is unknown.
MIN_NOISE_RAD, UNKNOWN_NOISE_RAD = 1e-4, 2e-3

# Out of sight for longer, a target has another speed; and for longer than the second, it may have moved and come back.
MAX_PAUSE_S, MAX_UNSEEN_S = 0.5, 5.0

# It has moved when it is this many standard deviations of the noise further away than it may be, and the place where it
# began to stand is the mean of this time. In 6 hours of simulated standing at 2 to 8 m nothing moved, allowed 1 cm.
MOVED_SIGMAS, PLACE_S = 5.0, 2.0

# A target whose motion is asked for, and the distance within which it counts as standing; None where that is not asked.
AskedMotion = tuple[str, float | None]


class Viewpoint(Struct, frozen=True, kw_only=True):
    """From where the camera looks, as far as the configuration says, and through which lens.

    Attributes:
        height_m: How high the camera is above the floor; None if that is not known.
        tilt_rad: How far it looks up from level where its mounting does not move.
        mount: Where it sits on the robot.
    """

    height_m: float | None = None
    tilt_rad: float = 0.0
    lens: CameraModel | None = None
    mount: Mount = Mount()

    def angle_noise_rad(self, track: Track, sighting: Sighting | None) -> float:
        """Return the standard deviation of the noise of a sighting's angles; 0 where that is not known.

        The noise of the edges that makes a target seem larger or smaller moves its centre too, which is the mean of its
        two sides where the extent is their difference. So as a share of the extent it is half that of the distance.
        """
        if sighting is None or sighting.size_share is None or self.lens is None:
            return 0.0
        share = sighting.noise_m * track.noise_factor / sighting.distance_m
        return share * sighting.size_share * self.lens.width_px / self.lens.fx_px / 2


class Standing(NamedTuple):
    """Since when a target has stood, to within a distance of where it began to."""

    within_m: float
    place_m: tuple[float, float, float]
    """Where it began to stand, in the camera frame: the mean of its first moments there."""
    since_s: float
    frames: int = 1
    """In how many frames it was seen in these moments."""


class TransverseMotion(Struct, frozen=True, kw_only=True):
    """All that is remembered of a target's motion across the line of sight from one cycle to the next.

    Attributes:
        withins_m: The distances that count as standing still, one for each condition that asks.
        seen_at_s: The capture time of the newest sighting; None until it was seen.
        doubted_at_s: That of a newer one that was refused as too far from what was expected; None for none.
        angles: The filters of bearing and elevation; None until it was seen.
        standing: Since when it has stood, for each of `withins_m`; empty until it was seen.
    """

    target: str
    withins_m: tuple[float, ...] = ()
    seen_at_s: float | None = None
    doubted_at_s: float | None = None
    angles: tuple[MotionState, MotionState] | None = None
    standing: tuple[Standing, ...] = ()


def motions_for(asked: Iterable[AskedMotion], before: Iterable[TransverseMotion] = ()) -> tuple[TransverseMotion, ...]:
    """Return the motions that are asked for, one for each target; what was known before goes on."""
    known = {each.target: each for each in before}
    withins_m: dict[str, set[float]] = {}
    for target, within_m in asked:
        withins_m.setdefault(target, set()).update([] if within_m is None else [within_m])
    return tuple(
        replace(known.get(target, TransverseMotion(target=target)), withins_m=tuple(sorted(withins_m[target])))
        for target in sorted(withins_m)
    )


def step_motion(
    before: TransverseMotion, track: Track, sighting: Sighting | None, viewpoint: Viewpoint, settings: Tracking
) -> TransverseMotion:
    """Take in what one cycle knows of a target; `sighting` is the newest that was accepted."""
    if sighting is None or not (track.is_valid and track.distance_m):
        return before
    at_s = sighting.at_s
    if at_s in {before.seen_at_s, before.doubted_at_s}:
        return before
    angle_rad = viewpoint.angle_noise_rad(track, sighting) or UNKNOWN_NOISE_RAD
    pause_s = math.inf if before.seen_at_s is None else at_s - before.seen_at_s
    wander = settings.acceleration_mps2 / track.distance_m, settings.autocorrelation
    last = before.angles if before.angles is not None and pause_s <= MAX_PAUSE_S else (None, None)
    bearing, bearing_sigmas = _step_angle(last[0], sighting.bearing_rad, angle_rad, pause_s, wander)
    elevation, elevation_sigmas = _step_angle(last[1], sighting.elevation_rad, angle_rad, pause_s, wander)
    if before.doubted_at_s is None and max(bearing_sigmas, elevation_sigmas) > settings.gate_sigmas:
        return replace(before, doubted_at_s=at_s)  # an error, or it has set off: the next sighting tells
    stood = {each.within_m: each for each in before.standing} if pause_s <= MAX_UNSEEN_S else {}
    x, y, z = direction_of(sighting.bearing_rad, sighting.elevation_rad)
    place_m = x * track.distance_m, y * track.distance_m, z * track.distance_m
    noises_m = track.noise_m or 0.0, track.distance_m * angle_rad
    standing = tuple([_stand(stood.get(m), m, place_m, noises_m, at_s) for m in before.withins_m])
    return replace(before, seen_at_s=at_s, doubted_at_s=None, angles=(bearing, elevation), standing=standing)


def _step_angle(
    before: MotionState | None, seen_rad: float, noise_rad: float, pause_s: float, wander: tuple[float, float]
) -> tuple[MotionState, float]:
    """Return the filters after a sighting, and how many standard deviations it is from what was expected."""
    seen_rad, noise_rad = seen_rad + math.pi, max(noise_rad, MIN_NOISE_RAD)
    if before is None:
        return motion.start(seen_rad, noise_rad), 0.0
    moved = motion.predict(before, pause_s, *wander)
    innovation = motion.compare(moved, seen_rad, noise_rad)
    return motion.update(moved, noise_rad, innovation), innovation.sigmas


def _stand(
    before: Standing | None,
    within_m: float,
    place_m: tuple[float, float, float],
    noises_m: tuple[float, float],
    at_s: float,
) -> Standing:
    """Return since when a target has stood.

    Args:
        noises_m: The standard deviation of its noise along the line of sight, and across it.
    """
    if before is None:
        return Standing(within_m, place_m, at_s)
    moved_m = math.dist(place_m, before.place_m)
    along_m = abs(math.hypot(*place_m) - math.hypot(*before.place_m))
    across_m = math.sqrt(max(0.0, moved_m * moved_m - along_m * along_m))
    noise_m = math.hypot(along_m * noises_m[0], across_m * noises_m[1]) / moved_m if moved_m else 0.0
    if moved_m > within_m + MOVED_SIGMAS * noise_m:
        return Standing(within_m, place_m, at_s)
    if at_s - before.since_s > PLACE_S:
        return before
    x, y, z = [was + (now - was) / (before.frames + 1) for was, now in zip(before.place_m, place_m, strict=True)]
    return before._replace(place_m=(x, y, z), frames=before.frames + 1)


def direction_of(bearing_rad: float, elevation_rad: float) -> tuple[float, float, float]:
    """Return a vector of length 1 in the camera frame: x right, y down, z forward."""
    level = math.cos(elevation_rad)
    return (level * math.sin(bearing_rad), -math.sin(elevation_rad), level * math.cos(bearing_rad))
