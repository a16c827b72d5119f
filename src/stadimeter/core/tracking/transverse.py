"""The motion of a target across the line of sight: the rates of its bearing and elevation, and whether it stands still.

It is worked out only for targets that some rule asks it of. Each angle has a Kalman filter of the angle and its rate,
whose rate wanders with white-noise acceleration, as in `stadimeter.core.tracking.filter`; an acceleration of a m/s² at
the distance d is one of a / d rad/s². Two things are different from the filter of the distance:

- Nothing states how noisy an angle is, so its variance is learnt: the mean square of the innovations of some seconds,
  less what the filter itself is unsure of. R. Mehra, "On the identification of variances and adaptive Kalman
  filtering", IEEE Transactions on Automatic Control 15 (2), 1970.
- One filter is enough, since it begins anew when it is wrong: of two sightings in a row that are both too far to the
  same side, the first is refused, for it may be an error, and with the second the rate is free to be any.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec.structs import replace

from stadimeter.core.track import Track
from stadimeter.core.tracking.filter import RATE_AT_START_MPS
from stadimeter.core.transverse_motion import AngleEstimate, AskedMotion, Standing, TransverseMotion, direction_of

# Process noise, as a share of the configured acceleration. Higher, and the speed of what stands is less sure; lower,
# and a target that sways is no longer within the stated deviation.
ACCELERATION_SHARE = 0.15

# A sighting this many standard deviations from what was expected is an error, or the target has set off.
GATE_SIGMAS = 4.0

# Noise of an angle: to begin with one pixel at a focal length of 500, and never less than a twentieth of that.
NOISE_AT_START_RAD, NOISE_FLOOR_RAD = 2e-3, 1e-4

# The time over which the noise is learnt.
LEARNING_S = 2.0

# Out of sight for longer, a target has another speed; and for longer than the second, it may have moved and come back.
MAX_PAUSE_S, MAX_UNSEEN_S = 0.5, 5.0

# It has moved when it is this many standard deviations of the noise further away than it may be, and the place where it
# began to stand is the mean of this time. In 20 hours of simulated standing at 2 to 8 m nothing moved, allowed 1 cm.
MOVED_SIGMAS, PLACE_S = 5.0, 2.0


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
    before: TransverseMotion, track: Track, acceleration_mps2: float, *, is_after_gap: bool
) -> TransverseMotion:
    """Take in what one cycle knows of a target.

    Args:
        acceleration_mps2: Standard deviation of the target's acceleration that is expected.
        is_after_gap: Whether the program stood still before this cycle: what was before says nothing.
    """
    if is_after_gap:
        before = TransverseMotion(target=before.target, withins_m=before.withins_m)
    at_s, distance_m, noise_m = track.measured_at_s, track.distance_m, track.noise_m
    bearing_rad, elevation_rad = track.bearing_rad, track.elevation_rad
    if not track.is_valid or at_s is None or at_s == before.seen_at_s or not distance_m:
        return before
    if bearing_rad is None or elevation_rad is None:
        return before
    wander = (ACCELERATION_SHARE * acceleration_mps2 / distance_m) ** 2
    start_var = (RATE_AT_START_MPS / distance_m) ** 2
    after = replace(
        before,
        seen_at_s=at_s,
        bearing=_step_angle(before.bearing, bearing_rad, at_s, wander, start_var),
        elevation=_step_angle(before.elevation, elevation_rad, at_s, wander, start_var),
    )
    if not before.withins_m:
        return after
    towards = direction_of(bearing_rad, elevation_rad)
    noises_m = (noise_m or track.sigma_m or 0.0, distance_m * after.angle_noise_rad)
    is_new = before.seen_at_s is not None and at_s - before.seen_at_s > MAX_UNSEEN_S
    stood = {} if is_new else {each.within_m: each for each in before.standing}
    standing = [_stand(stood.get(each), each, towards, distance_m, noises_m, at_s) for each in before.withins_m]
    return replace(after, standing=tuple(standing))


def _step_angle(
    before: AngleEstimate | None, seen_rad: float, at_s: float, wander: float, start_var: float
) -> AngleEstimate:
    if before is None or at_s - before.at_s > MAX_PAUSE_S:
        noise = NOISE_AT_START_RAD**2 if before is None else before.noise_rad2
        return AngleEstimate(at_s, seen_rad, 0.0, noise, 0.0, start_var, noise)
    last_s, angle, rate, var, cov, var_rate, noise, doubt = before
    step_s = at_s - last_s
    error = seen_rad - angle - step_s * rate
    added = wander * step_s
    cov_rate = cov + step_s * var_rate
    var += step_s * (cov + cov_rate + added * step_s / 3)
    cov, var_rate = cov_rate + added * step_s / 2, var_rate + added
    if error * error > GATE_SIGMAS**2 * (var + noise):
        side = 1 if error > 0 else -1
        if side != doubt:
            return before._replace(doubt=side)
        free = (error / step_s) ** 2  # the rate may have become any while nothing was taken in
        var, cov, var_rate = var + step_s * step_s * free, cov + step_s * free, var_rate + free
    else:
        share = 1.0 - math.exp(-step_s / LEARNING_S)
        noise = max(noise + share * (error * error - var - noise), NOISE_FLOOR_RAD**2)
    total = var + noise
    gain, rate_gain = var / total, cov / total
    return AngleEstimate(
        at_s,
        angle + step_s * rate + gain * error,
        rate + rate_gain * error,
        max(0.0, var - gain * var),
        cov - gain * cov,
        max(0.0, var_rate - rate_gain * cov),
        noise,
    )


def _stand(
    before: Standing | None,
    within_m: float,
    towards: tuple[float, float, float],
    distance_m: float,
    noises_m: tuple[float, float],
    at_s: float,
) -> Standing:
    """Return since when a target has stood.

    Args:
        noises_m: The standard deviation of its noise along the line of sight, and across it.
    """
    x, y, z = place_m = (distance_m * towards[0], distance_m * towards[1], distance_m * towards[2])
    if before is None:
        return Standing(within_m, place_m, at_s)
    x0, y0, z0 = before.place_m
    moved_m = math.dist(place_m, before.place_m)
    along_m = (x - x0) * towards[0] + (y - y0) * towards[1] + (z - z0) * towards[2]
    share = along_m / moved_m if moved_m else 1.0
    noise_m = math.hypot(share * noises_m[0], math.sqrt(max(0.0, 1.0 - share * share)) * noises_m[1])
    if moved_m > within_m + MOVED_SIGMAS * noise_m:
        return Standing(within_m, place_m, at_s)
    if at_s - before.since_s > PLACE_S:
        return before
    frames = before.frames + 1
    mean_m = (x0 + (x - x0) / frames, y0 + (y - y0) / frames, z0 + (z - z0) / frames)
    return before._replace(place_m=mean_m, frames=frames)
