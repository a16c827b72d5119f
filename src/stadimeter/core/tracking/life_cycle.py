"""The life of a target: searching (tentative), tracking (confirmed), coasting, lost.

::

    searching ──confirmed──▶ tracking ──a frame without it──▶ coasting ──for too long──▶ lost
                                 ▲            measured again ◀────┘                        │
                                 └────────────────────── confirmed again ──────────────────┘

A new target must be measured in some frames in a row before it counts, so that one false detection moves nothing; in
more of them where it is only perhaps the target. An
outlier is refused like a frame without the target. Three in a row that agree with each other mean that the target
really jumped, and so do more that do not: the track starts anew. How noisy the target is, is learnt on the way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.bounds import MAX_FIGURE, MAX_TIME_S
from stadimeter.core.measurement import Measurement, MeasurementStatus, Sighting, Track, TrackStatus
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.filter import NOISE_FLOOR_M
from stadimeter.core.tracking.motion import Innovation, MotionState, NoiseEstimate, Tracking

# Sightings, the usable measurements of a target, and tentative tracks made of some in a row ---------
#
# A new target is tentative, and so is what contradicts a target that is tracked: if its frames agree, the target is
# there. A first sighting gives no speed; the second agrees with it if the target may have moved as targets mostly
# do. Two that contradict each other may be errors, or a fast target: then a third on the line through both decides.
# This is two-point differencing: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and
# Navigation", Wiley 2001, section 5.5.3.

# Two sightings that are further apart than a target of this speed could come are not of one target.
MAX_SPEED_MPS = 40.0

# The frames that agree when a third is on the line through two.
ON_A_LINE = 3

# What is perhaps the target must be the same thing in ten frames in a row before it counts: a third of a second of
# most cameras. What stands still for as long and looks like the target is taken for it.
PERHAPS_FRAMES = 10


def sighting_of(measurement: Measurement) -> Sighting | None:
    """Return the figures of a measurement; None if the target was not measured or a figure makes no sense."""
    distance_m, depth_m, sigma_m = measurement.distance_m, measurement.depth_m, measurement.sigma_m
    noise_m, bearing_rad, elevation_rad = measurement.noise_m, measurement.bearing_rad, measurement.elevation_rad
    if measurement.status not in (MeasurementStatus.MEASURED, MeasurementStatus.PERHAPS):
        return None
    if distance_m is None or depth_m is None or sigma_m is None:
        return None
    if noise_m is None or bearing_rad is None or elevation_rad is None:
        return None
    # One comparison for six figures: a sum with NaN or infinity in it is not below the bound either.
    figures = abs(distance_m) + abs(depth_m) + abs(sigma_m) + abs(noise_m) + abs(bearing_rad) + abs(elevation_rad)
    if not (figures <= MAX_FIGURE and abs(measurement.captured_at_s) <= MAX_TIME_S) or distance_m <= 0:
        return None
    return Sighting(
        at_s=measurement.captured_at_s,
        distance_m=distance_m,
        noise_m=max(noise_m, NOISE_FLOOR_M),
        scale_sigma=math.sqrt(max(0.0, sigma_m**2 - noise_m**2)) / distance_m,
        depth_share=depth_m / distance_m,
        bearing_rad=bearing_rad,
        elevation_rad=elevation_rad,
        size_share=measurement.size_share,
        remark=measurement.reason,
        is_perhaps=measurement.status is MeasurementStatus.PERHAPS,
    )


class TentativeTrack(NamedTuple):
    """A target that is not confirmed yet.

    Attributes:
        sighting: The newest sighting.
        noise_m: The standard deviation of its noise.
        frames: How many frames in a row agree with each other.
        sure: In how many of them it was measured and not only perhaps.
        motion: How it moves if it moves as targets mostly do.
        fast: How it moves if it is as fast as its last two sightings say; None if they agree anyway.
    """

    sighting: Sighting
    noise_m: float
    frames: int
    sure: int
    motion: MotionState
    fast: MotionState | None = None

    def is_confirmed(self, frames: int) -> bool:
        """Check whether it counts; a target that is surely seen takes this number of frames."""
        return self.sure >= frames or self.frames >= max(frames, PERHAPS_FRAMES)


def extend_tentative(
    before: TentativeTrack | None, sighting: Sighting, noise_m: float, settings: Tracking
) -> TentativeTrack:
    """Return the candidate after another sighting.

    Args:
        before: What was seen in the frames before; None for nothing.
        noise_m: Standard deviation of the sighting's noise, above zero.
        settings: How to track.
    """
    at_rest, sure = motion.start(sighting.distance_m, noise_m), int(not sighting.is_perhaps)
    if before is None:
        return TentativeTrack(sighting, noise_m, 1, sure, at_rest)
    agreeing = _take_if_agreeing(before.motion, before, sighting, noise_m, settings)
    if agreeing:
        return TentativeTrack(sighting, noise_m, before.frames + 1, before.sure + sure, agreeing)
    on_line = before.fast and _take_if_agreeing(before.fast, before, sighting, noise_m, settings)
    if on_line:
        return TentativeTrack(sighting, noise_m, ON_A_LINE, ON_A_LINE if sure and before.sure else 0, on_line)
    return TentativeTrack(sighting, noise_m, 1, sure, at_rest, _start_fast(before, sighting, noise_m))


def _take_if_agreeing(
    state: MotionState, before: TentativeTrack, sighting: Sighting, noise_m: float, settings: Tracking
) -> MotionState | None:
    """Return the motion with a sighting taken in; None if the sighting contradicts it."""
    step_s = sighting.at_s - before.sighting.at_s
    moved = motion.predict(state, step_s, settings.acceleration_mps2, settings.autocorrelation)
    innovation = motion.compare(moved, sighting.distance_m, noise_m)
    return motion.update(moved, noise_m, innovation) if innovation.sigmas <= settings.gate_sigmas else None


def _start_fast(before: TentativeTrack, sighting: Sighting, noise_m: float) -> MotionState | None:
    step_s = sighting.at_s - before.sighting.at_s
    # Metres per second from two sightings; 40 m/s is a limit of sense, not of a model.
    rate_mps = (sighting.distance_m - before.sighting.distance_m) / step_s
    if abs(rate_mps) > MAX_SPEED_MPS:
        return None
    return motion.start_moving(sighting.distance_m, noise_m, rate_mps, before.noise_m, step_s)


# The track of one target: begun, followed, coasting, lost -------------------------------------------------------------

# A target that keeps its speed has a probability of the constant-velocity model above this.
MIN_CONSTANT_VELOCITY_SHARE = 0.5

# For this long after a leap another one is believed at once.
RESTLESS_S = 2.0

_AS_STATED = NoiseEstimate()

# Least ratio of expected and measured distance, either way, that the noise of a measurement is corrected by.
MIN_RATIO = 0.5

# This many measurements in a row that contradict the track, and agree with each other, are the target.
AGREEING_FRAMES = 3


class TrackState(Struct, frozen=True, kw_only=True):
    """All that is remembered of a target from one cycle to the next.

    Attributes:
        filter: What is known of its motion; None before it was confirmed.
        filter_at_s: The capture time of the newest frame that was taken in.
        sighting: The last sighting that was accepted.
        earlier: The one before it; None if the track began with the last one.
        candidate: What was seen in the newest frames and does not count yet: a new target, or what contradicts the
            track; None if there is nothing of that kind.
        is_doubted: Whether the candidate's newest sighting is where the target may be if it manoeuvres.
        leapt_at_s: When the target last really made a leap.
        noise: How noisy it is.
        member: Of the nearest or the farthest of several, which one that is now; empty for any other target.
    """

    track: Track
    filter: MotionState | None = None
    filter_at_s: float = -math.inf
    sighting: Sighting | None = None
    earlier: Sighting | None = None
    candidate: TentativeTrack | None = None
    is_doubted: bool = False
    leapt_at_s: float = -math.inf
    noise: NoiseEstimate = _AS_STATED
    member: str = ""


def new_track(target: str) -> TrackState:
    """Return the state of a target that was never seen."""
    return TrackState(track=Track(target=target))


def step(state: TrackState, measurement: Measurement | None, now_s: float, settings: Tracking) -> TrackState:
    """Take in what one cycle knows of the target.

    Args:
        state: What was known before.
        measurement: What the new frame says of the target; None in a cycle without a new frame.
        now_s: The run's monotonic clock, for noticing that nothing comes.
        settings: How to track.
    """
    after = _take_in(state, measurement, now_s, settings)
    if state.track.since_s is not None and after.track.is_valid is state.track.is_valid:
        return after
    return replace(after, track=replace(after.track, since_s=now_s))


def after_gap(state: TrackState, now_s: float, reason: str) -> TrackState:
    """Return the state after a gap without frames: the old estimate is too old to go on with.

    It must be confirmed anew, and for how long it is in sight or out of sight is counted from now.

    Args:
        state: What was known before.
        now_s: The run's monotonic clock.
        reason: Why there were no frames.
    """
    track = replace(state.track, since_s=now_s)
    if track.is_valid:
        track = replace(track, status=TrackStatus.LOST, rejected=0, reason=reason)
    return replace(state, track=track, candidate=None)


def _take_in(state: TrackState, measurement: Measurement | None, now_s: float, settings: Tracking) -> TrackState:
    if measurement is None:
        return _lose_if_late(state, now_s, settings, "no new frame")
    if measurement.captured_at_s <= state.filter_at_s:
        return state  # a repeated or late frame tells nothing new
    sighting = sighting_of(measurement)
    if sighting is None:
        return _miss(state, measurement, settings)
    if state.track.is_valid:
        return _follow(state, sighting, settings)
    return _consider(state, sighting, settings)


def _lose_if_late(state: TrackState, now_s: float, settings: Tracking, reason: str) -> TrackState:
    track = state.track
    if not track.is_valid or track.measured_at_s is None:
        return state
    unseen_s = now_s - track.measured_at_s
    if unseen_s <= settings.coast_s:
        return state
    # A prediction stands in for measurements for `coast` seconds of the run's clock, not for a number of frames.
    reason = f"not measured for {unseen_s:.2f} s, limit {settings.coast_s:.2f} s: {reason}"
    track = replace(track, status=TrackStatus.LOST, rejected=0, reason=reason)  # what was refused is no news any more
    return replace(state, track=track, candidate=None)


def _miss(state: TrackState, measurement: Measurement, settings: Tracking) -> TrackState:
    """Coast through a frame without the target; the track is lost after `coast`."""
    reason = measurement.reason or "the measurement holds no usable figures"
    if not state.track.is_valid:
        return replace(state, track=replace(state.track, reason=reason), candidate=None)
    return _coast(
        state, _predict(state, measurement.captured_at_s, settings), measurement.captured_at_s, settings, reason
    )


def _consider(state: TrackState, sighting: Sighting, settings: Tracking) -> TrackState:
    found = extend_tentative(state.candidate, sighting, _noise_m(state, sighting, settings), settings)
    if found.is_confirmed(settings.confirm_frames):
        return _begin(state, found, settings)
    if sighting.is_perhaps:
        takes = max(settings.confirm_frames, PERHAPS_FRAMES)
        reason = f"perhaps seen in {found.frames} of the {takes} frames in a row that it takes: {sighting.remark}"
    else:
        reason = f"seen in {found.frames} of the {settings.confirm_frames} frames in a row that it takes"
    track = replace(state.track, reason=reason)
    return replace(state, track=track, filter_at_s=sighting.at_s, candidate=found)


def _follow(state: TrackState, sighting: Sighting, settings: Tracking) -> TrackState:
    """Take in a sighting of a confirmed target, unless it is an outlier."""
    # Prediction to the capture time, innovation of each model, then the innovation gate: `gate` of the configuration in
    # standard deviations. What fails is refused, and coasts.
    moved = _predict(state, sighting.at_s, settings)
    noise_m = _noise_m(state, sighting, settings) * _noise_weight(moved.distance_m, sighting.distance_m)
    innovation = motion.compare(moved, sighting.distance_m, noise_m)
    noise = _learn_noise(state, motion.normalise(moved, innovation), sighting, settings)
    # `sigmas` is the smallest of the three models: what any of them explains is no outlier.
    is_outlier = innovation.sigmas > settings.gate_sigmas
    if is_outlier or _may_be_feigned(state, moved, sighting, innovation, settings):
        if sighting.is_perhaps:  # what may be another thing, and is elsewhere, is another thing
            return _coast(state, moved, sighting.at_s, settings, sighting.remark)
        return _refuse(replace(state, noise=noise), moved, sighting, innovation, settings)
    known = motion.update(moved, noise_m, innovation)
    return TrackState(
        track=_track(state.track, known, sighting, noise, settings, TrackStatus.TRACKING),
        filter=known,
        filter_at_s=sighting.at_s,
        sighting=sighting,
        earlier=state.sighting,
        leapt_at_s=sighting.at_s if state.is_doubted else state.leapt_at_s,
        noise=noise,
    )


def _refuse(
    state: TrackState, moved: MotionState, sighting: Sighting, innovation: Innovation, settings: Tracking
) -> TrackState:
    """Refuse a sighting that contradicts the track; begin anew if that goes on, or if such sightings agree."""
    rival = extend_tentative(state.candidate, sighting, _noise_m(state, sighting, settings), settings)
    rejected = state.track.rejected + 1
    if rejected > settings.outliers_max or rival.frames >= AGREEING_FRAMES:
        return _begin(state, rival, settings)
    is_outlier = innovation.sigmas > settings.gate_sigmas
    far = f", {innovation.sigmas:.1f} standard deviations off, limit {settings.gate_sigmas:.1f}" if is_outlier else ""
    jumped = f"jumped to {sighting.distance_m:.2f} m{far}; waiting for more frames"
    reason = f"outlier {rejected} of {settings.outliers_max}: {jumped}"
    track = replace(state.track, rejected=rejected)
    refused = replace(state, track=track, candidate=rival, is_doubted=not is_outlier)
    return _coast(refused, moved, sighting.at_s, settings, reason)


def _begin(state: TrackState, found: TentativeTrack, settings: Tracking) -> TrackState:
    """Begin the track, or begin it anew, with a tentative one that was confirmed."""
    sighting = found.sighting
    return TrackState(
        track=_track(state.track, found.motion, sighting, state.noise, settings, TrackStatus.TRACKING),
        filter=found.motion,
        filter_at_s=sighting.at_s,
        sighting=sighting,
        leapt_at_s=state.leapt_at_s,
        noise=state.noise,
    )


def _may_be_feigned(
    state: TrackState, moved: MotionState, sighting: Sighting, innovation: Innovation, settings: Tracking
) -> bool:
    """Check whether a target at constant velocity seems to have made a leap that one wrong measurement could feign.

    Near the camera the noise is so small that a manoeuvre allows for far more than the noise does: a wrong measurement
    within that would be believed at once. One frame decides: if the next one is there too, the target did move.
    """
    if not settings.outliers_max or innovation.constant_sigmas <= settings.gate_sigmas:
        return False
    # Only a target that kept its speed so far, and has not leapt in the last two seconds, is held back for one frame.
    if moved.constant_share < MIN_CONSTANT_VELOCITY_SHARE or sighting.at_s - state.leapt_at_s < RESTLESS_S:
        return False
    if state.candidate is None or not state.is_doubted:
        return True
    expected_m = sighting.distance_m - innovation.constant_m
    # A target that really starts goes on the same way. Two errors in a row hardly ever agree.
    return (state.candidate.sighting.distance_m - expected_m) * innovation.constant_m <= 0


def _learn_noise(state: TrackState, innovation_sigmas: float, sighting: Sighting, settings: Tracking) -> NoiseEstimate:
    line = None
    if state.earlier is not None and state.sighting is not None:
        line = motion.compare_with_line(state.noise, (state.earlier, state.sighting), sighting, settings)
    return motion.learn(state.noise, innovation_sigmas, line, sighting.at_s - state.filter_at_s, settings)


def _noise_m(state: TrackState, sighting: Sighting, settings: Tracking) -> float:
    return sighting.noise_m * settings.noise_factor * state.noise.factor


def _noise_weight(expected_m: float, seen_m: float) -> float:
    """Return the multiple of its stated noise that a measurement counts with.

    The noise follows from the distance that was seen and grows with its square: what errs towards the camera seems the
    surest, so all together pull a track nearer, by three times its variance over the distance, and raise alarms for
    nothing. With the noise at the expected distance that would be over, but a target that comes would be believed late.
    This is in between: with correlated noise at 8 m, 9 instead of 19 false alarms of safety rules in 400 minutes.
    """
    return math.sqrt(min(max(expected_m / seen_m, MIN_RATIO), 1 / MIN_RATIO))


def _predict(state: TrackState, at_s: float, settings: Tracking) -> MotionState:
    known = cast(MotionState, state.filter)  # a track that counts has one
    autocorrelation = state.noise.autocorrelation(settings)
    return motion.predict(known, at_s - state.filter_at_s, settings.acceleration_mps2, autocorrelation)


def _coast(state: TrackState, moved: MotionState, at_s: float, settings: Tracking, reason: str) -> TrackState:
    """Show what is expected, as long as that may stand in for measurements."""
    sighting = cast(Sighting, state.sighting)  # a track that counts has one
    track = _track(state.track, moved, sighting, state.noise, settings, TrackStatus.COASTING)
    track = replace(track, as_of_s=at_s, rejected=state.track.rejected, reason=reason)
    return _lose_if_late(replace(state, track=track, filter=moved, filter_at_s=at_s), at_s, settings, reason)


def _track(
    before: Track, known: MotionState, sighting: Sighting, noise: NoiseEstimate, settings: Tracking, status: TrackStatus
) -> Track:
    """Put what the filter knows into the track that others see."""
    # Variance of the distance: that of the filter for what averages out, and the stated one for the share that stays
    # from frame to frame. The scale error (focal length, size of the target) is a share of the distance and is added at
    # the end.
    together, staying = known.estimate(), noise.staying_share
    stated_m = sighting.noise_m * settings.noise_factor
    noise_m = math.sqrt((1.0 - staying) * together.var_distance_m2 + staying * stated_m * stated_m)
    return Track(
        target=before.target,
        status=status,
        distance_m=together.distance_m,
        depth_m=together.distance_m * sighting.depth_share,
        closing_mps=-together.rate_mps,
        sigma_m=math.hypot(noise_m, together.distance_m * sighting.scale_sigma),
        noise_m=noise_m,
        closing_sigma_mps=math.sqrt(together.var_rate_m2ps2),
        bearing_rad=sighting.bearing_rad,
        elevation_rad=sighting.elevation_rad,
        as_of_s=sighting.at_s,
        measured_at_s=sighting.at_s,
        reason=sighting.remark,
        since_s=before.since_s,
        closing_cov_m2ps=-together.cov_m2ps,
        noise_factor=settings.noise_factor * noise.factor,
    )


# The nearest and the farthest of several targets of one kind, each a target of its own for rules ----------------------
#
# It is the track of one member, under another name. It stays the same one until another member is surely nearer, so
# two that are about as far away do not make it leap from frame to frame.

# Another member takes over when it is nearer by this many standard deviations of the difference: with 2, noise alone
# does so in 2 of 100 frames in which both are as far away.
SURELY_SIGMAS = 2.0


class NearestOf(Struct, frozen=True, kw_only=True):
    """A target that stands for the nearest of several, or the farthest.

    Attributes:
        members: The targets that it is one of.
        is_farthest: Whether it is the farthest.
    """

    name: str
    members: tuple[str, ...]
    is_farthest: bool = False


def step_nearest(which: NearestOf, before: TrackState, tracked: Sequence[TrackState], now_s: float) -> TrackState:
    """Return the state of the target after a cycle.

    Args:
        tracked: Every target after the cycle, its members among them.
        now_s: The run's monotonic clock.
    """
    members = [each for each in tracked if each.track.target in which.members]
    seen = [each for each in members if each.track.is_valid and each.track.distance_m is not None]
    same = next((each for each in members if each.track.target == before.member), members[0])
    chosen = same
    if seen:
        best = min(seen, key=lambda each: _order_m(which, each))
        chosen = same if same in seen and not _is_surely_before(which, best, same) else best
    # While none is in sight, it is as it was lost; since when is its own, whichever member it was.
    track = replace(chosen.track, target=which.name)
    if before.track.since_s is not None and before.track.is_valid is track.is_valid:
        track = replace(track, since_s=before.track.since_s)
    else:
        track = replace(track, since_s=now_s)
    return replace(chosen, track=track, member=chosen.track.target)


def _order_m(which: NearestOf, state: TrackState) -> float:
    distance_m = state.track.distance_m or 0.0
    return -distance_m if which.is_farthest else distance_m


def _is_surely_before(which: NearestOf, one: TrackState, other: TrackState) -> bool:
    sigma_m = math.hypot(one.track.noise_m or 0.0, other.track.noise_m or 0.0)
    return _order_m(which, other) - _order_m(which, one) > SURELY_SIGMAS * sigma_m
