"""The motion of a target across the line of sight: the rates of its bearing and elevation, and whether it stands still.

It is worked out only for targets that some rule asks it of. Each angle has a Kalman filter of the angle and its rate,
whose rate wanders with white-noise acceleration, as in `stadimeter.core.tracking.filter`; an acceleration of a m/s² at
the distance d is one of a / d rad/s². Two things are different from the filter of the distance:

- Nothing states how noisy an angle is, so its variance is learnt: from how far each sighting is from the line through
  the ones before and after it, which no steady motion changes. Innovations would not do: a filter that lags takes its
  lag for noise, and lags more for that.
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

# A sighting further than this from what was expected, in standard deviations, may be an error: the next one tells.
# Beyond the second of these, two to the same side mean that the target manoeuvres.
GATE_SIGMAS, DOUBT_SIGMAS = 4.0, 2.0

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
    before: TransverseMotion, track: Track, acceleration_mps2: float, autocorrelation: float, *, is_after_gap: bool
) -> TransverseMotion:
    """Take in what one cycle knows of a target.

    Args:
        acceleration_mps2: Standard deviation of the target's acceleration that is expected.
        autocorrelation: Of the noise from one frame to the next, which hides a part of it from who compares frames.
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
    shown = 1.0 - (4.0 - autocorrelation) * autocorrelation / 3.0  # of the variance, in a second difference
    after = replace(
        before,
        seen_at_s=at_s,
        bearing=_step_angle(before.bearing, bearing_rad, at_s, wander, start_var, shown),
        elevation=_step_angle(before.elevation, elevation_rad, at_s, wander, start_var, shown),
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
    before: AngleEstimate | None, seen_rad: float, at_s: float, wander: float, start_var: float, shown: float
) -> AngleEstimate:
    if before is None or at_s - before.at_s > MAX_PAUSE_S:
        noise = NOISE_AT_START_RAD**2 if before is None else before.noise_rad2
        return AngleEstimate(at_s, seen_rad, None, 0.0, seen_rad, 0.0, noise, 0.0, start_var, noise)
    step_s = at_s - before.at_s
    expected = before.angle_rad + step_s * before.rate_radps
    error = seen_rad - expected
    added = wander * step_s
    cov = before.cov_rad2ps + step_s * before.var_rate
    var = before.var_rad2 + step_s * (before.cov_rad2ps + cov + added * step_s / 3)
    cov, var_rate = cov + added * step_s / 2, before.var_rate + added
    noise, square = before.noise_rad2, error * error
    side = 0 if square < DOUBT_SIGMAS**2 * (var + noise) else 1 if error > 0 else -1
    if side and side == before.doubt:
        wider = square - var - noise  # as much as makes the error one of one standard deviation
        var, cov, var_rate = var + wider, cov + wider / step_s, var_rate + wider / (step_s * step_s)
    elif square > GATE_SIGMAS**2 * (var + noise):
        return before._replace(doubt=side)
    gain, rate_gain = var / (var + noise), cov / (var + noise)
    return AngleEstimate(
        at_s=at_s,
        seen_rad=seen_rad,
        earlier_s=before.at_s,
        earlier_rad=before.seen_rad,
        angle_rad=expected + gain * error,
        rate_radps=before.rate_radps + rate_gain * error,
        var_rad2=max(0.0, var - gain * var),
        cov_rad2ps=cov - gain * cov,
        var_rate=max(0.0, var_rate - rate_gain * cov),
        noise_rad2=_learn_noise(before, seen_rad, at_s, shown),
        doubt=side,
    )


def _learn_noise(before: AngleEstimate, seen_rad: float, at_s: float, shown: float) -> float:
    """Return the variance of a sighting's noise after another one; a sighting counts for no more than three sigmas."""
    if before.earlier_s is None:
        return before.noise_rad2
    way = (before.at_s - before.earlier_s) / (at_s - before.earlier_s)
    off = before.seen_rad - (before.earlier_rad + way * (seen_rad - before.earlier_rad))
    variance = off * off / (shown * (1.0 + way * way + (1.0 - way) * (1.0 - way)))
    share = 1.0 - math.exp((before.at_s - at_s) / LEARNING_S)
    return max((1.0 - share) * before.noise_rad2 + share * min(variance, 9.0 * before.noise_rad2), NOISE_FLOOR_RAD**2)


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
