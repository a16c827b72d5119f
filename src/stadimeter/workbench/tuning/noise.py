"""The noise of a target's distance in recordings, separated from the movement of the target.

Noise is what is left when the target's own movement is taken away. Free movement of a target cannot be separated from
noise, so only calm stretches are used: some seconds in which a straight line fits about as well as it does elsewhere.
They give the noise, frame by frame, in units of the standard deviation that each measurement stated. Nothing is
assumed about its true size, its correlation, its outliers and its gaps: it is replayed as it was.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.bounds import MAX_FIGURE
from stadimeter.core.conditions.evidence import Quantity
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.tracking.filter import NOISE_FLOOR_M
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.replay import AnyRecording

# Length of a stretch: many times as long as noise lasts, and short enough for a target that never stands for long.
STRETCH_S = 5.0

# After a pause of this long, a new stretch begins.
GAP_S = 1.0

# A stretch counts if the target was measured in this share of its frames; else it may simply not have been there.
SEEN_SHARE = 0.5

# A stretch is calm if its spread is at most this many times that of the calmest quarter.
CALM_TIMES = 2.0

# Errors differ from movement by their duration: a median over this time leaves little of noise and outliers.
LASTING_S = 0.5

# A target whose distance differs from the line by more than this for `LASTING_S` moves, in units of its jitter, or of
# the stated standard deviation if that is larger. Noise that keeps 0.9 of itself from frame to frame stays below it.
MOVES_SIGMAS = 4.0

# Errors that are clearly larger than stated and keep more than this from frame to frame are a movement as well, or are
# like one: the two cannot be told apart.
MOVES_CORRELATION = 0.9

# With less than this, nothing can be said of noise.
MIN_CALM_S = 20.0

# Further than this from the line, in standard deviations of the noise as it truly is, is grossly wrong.
GROSS_SIGMAS = 6.0

# Noise that is larger than stated by less than this is learnt by the tracker soon enough.
CLEARLY_LARGER = 1.25

_MAD_TO_SIGMA = 1.4826
_FIT_ROUNDS = 4

Floats = NDArray[np.float64]


class Series(Struct, frozen=True, kw_only=True, eq=False):
    """The measurements of a target in one recording, a frame each.

    Attributes:
        figures_m: The distances, or depths; NaN in frames without the target.
        noises_m: The standard deviation that was stated for the part that differs from frame to frame.
        scale: The rest of the stated standard deviation, as a share of the distance.
    """

    times_s: Floats
    figures_m: Floats
    noises_m: Floats
    scale: float


class Stretch(Struct, frozen=True, kw_only=True, eq=False):
    """Some seconds of a recording.

    Attributes:
        steps_s: The time since the frame before, for each frame.
        first_m: The distance at its beginning, by the line that fits.
        errors: The distance of each measurement from the line, in standard deviations as stated; NaN without one.
        spread: The standard deviation of the errors, those that are grossly wrong left out.
        is_moving: The target left the line for longer than noise does: it set off, stopped, turned, or swayed.
    """

    steps_s: Floats
    first_m: float
    last_m: float
    errors: Floats
    spread: float
    is_moving: bool

    @property
    def duration_s(self) -> float:
        """Its duration."""
        return float(self.steps_s.sum())


class RecordedNoise(Struct, frozen=True, kw_only=True, eq=False):
    """The noise of recordings.

    Attributes:
        recorded_s: Length of the recordings, the time without the target included.
        frame_s: Median time from frame to frame.
        stated_per_m2: Median of the stated standard deviation of the noise divided by the square of the distance.
        scale: The part of the stated standard deviation that no filter reduces, as a share of the distance.
        ratio: The true standard deviation of the noise over the stated one.
        correlation: Of the noise from one frame to the next.
        gross: The share of outliers among the measurements.
    """

    stretches: tuple[Stretch, ...]
    calm: tuple[Stretch, ...]
    recorded_s: float
    frame_s: float
    stated_per_m2: float
    scale: float
    ratio: float
    correlation: float
    gross: float
    missing: float

    @property
    def calm_s(self) -> float:
        """Length of the calm stretches together, in seconds."""
        return sum(stretch.duration_s for stretch in self.calm)

    @property
    def factor(self) -> float:
        """The `noise_factor` of ``[tracking]`` that fits: 1 unless the noise is clearly larger than stated."""
        return round(self.ratio, 1) if self.ratio >= CLEARLY_LARGER else 1.0

    def stated_m(self, distance_m: float) -> float:
        """Return the standard deviation that would be stated for a measurement; in metres, for a distance in metres."""
        return max(self.stated_per_m2 * distance_m * distance_m, NOISE_FLOOR_M)

    def true_m(self, distance_m: float) -> float:
        """Return the standard deviation that a measurement truly has; in metres, for a distance in metres."""
        return self.ratio * self.stated_m(distance_m)


def series_of(recording: AnyRecording, target: str, quantity: Quantity) -> Series:
    """Read the measurements of a target from a recording, in the order of the frames.

    Raises:
        JournalError: The recording is damaged, has no frames, or does not know the target.
    """
    rows: list[tuple[float, float, float, float]] = []
    known: set[str] = set()
    frames = 0
    for cycle in recording.cycles():
        observation = cycle.observation()
        frames += observation.frame is not None
        known.update(seen.target for seen in observation.measurements)
        rows += [_row(seen, quantity) for seen in observation.measurements if seen.target == target]
    if not rows:
        raise JournalError(_why_nothing(recording, target, frames, known))
    _, first = np.unique([row[0] for row in rows], return_index=True)  # a frame that came twice counts once
    table = np.array(rows)[first]
    shares = table[:, 3][np.isfinite(table[:, 3])]
    return Series(
        times_s=table[:, 0],
        figures_m=table[:, 1],
        noises_m=table[:, 2],
        scale=float(np.median(shares)) if len(shares) else 0.0,
    )


def _row(seen: Measurement, quantity: Quantity) -> tuple[float, float, float, float]:
    """Return the capture time, the figure, its noise, and the other part of its standard deviation as a share."""
    figure_m = seen.distance_m if quantity == "distance" else seen.depth_m
    noise_m, sigma_m = seen.noise_m, seen.sigma_m
    nothing = (seen.captured_at_s, math.nan, math.nan, math.nan)
    if seen.status is not MeasurementStatus.MEASURED or figure_m is None or noise_m is None or sigma_m is None:
        return nothing
    if not abs(figure_m) + abs(noise_m) + abs(sigma_m) <= MAX_FIGURE or figure_m <= 0:  # NaN is not below anything
        return nothing
    noise_m = max(noise_m, NOISE_FLOOR_M)
    return seen.captured_at_s, figure_m, noise_m, math.sqrt(max(0.0, sigma_m**2 - noise_m**2)) / figure_m


def _why_nothing(recording: AnyRecording, target: str, frames: int, known: set[str]) -> str:
    if not frames:
        return f"{recording.path}: no frame was recorded; record a run in which the camera works"
    has = f"its targets are: {', '.join(sorted(known))}" if known else "no target was looked for"
    return f"{recording.path}: the rule watches '{target}', which this recording does not have; {has}"


def noise_of(recordings: Sequence[Series]) -> RecordedNoise:
    """Separate the noise of recordings from the target's movement.

    Raises:
        JournalError: The target was never calm for long enough.
    """
    stretches = [stretch for series in recordings for stretch in stretches_of(series)]
    calm = _calm(stretches)
    calm_s = sum(stretch.duration_s for stretch in calm)
    if calm_s < MIN_CALM_S:
        raise JournalError(
            f"the target stood still, or moved steadily, for {calm_s:.0f} s of the recordings only; at least "
            f"{MIN_CALM_S:.0f} s are needed to tell noise from movement: record it standing where it mostly stands"
        )
    calm = _restore_variance(calm)
    errors = np.concatenate([stretch.errors for stretch in calm])
    ratio = max(_spread(errors), 1e-3)
    seen = np.isfinite(errors)
    steps_s = np.concatenate([np.diff(series.times_s) for series in recordings])
    figures_m = np.concatenate([series.figures_m for series in recordings])
    noises_m = np.concatenate([series.noises_m for series in recordings])
    return RecordedNoise(
        stretches=tuple(stretches),
        calm=tuple(calm),
        recorded_s=sum(float(series.times_s[-1] - series.times_s[0]) for series in recordings),
        frame_s=float(np.median(steps_s)),
        stated_per_m2=float(np.nanmedian(noises_m / figures_m**2)),
        scale=float(np.median([series.scale for series in recordings])),
        ratio=ratio,
        correlation=_correlation([stretch.errors for stretch in calm], ratio),
        gross=float(np.mean(np.abs(errors[seen]) > GROSS_SIGMAS * ratio)),
        missing=float(1 - np.mean(seen)),
    )


def stretches_of(series: Series) -> list[Stretch]:
    """Cut a recording into stretches in which the target was there."""
    steps_s = np.diff(series.times_s, prepend=series.times_s[0] - _usual_step_s(series.times_s))
    return [
        _stretch(series, part, steps_s)
        for run in _runs(series.times_s)
        for part in _parts(series.times_s, run)
        if np.mean(np.isfinite(series.figures_m[part])) >= SEEN_SHARE
    ]


def _usual_step_s(times_s: Floats) -> float:
    return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


def _runs(times_s: Floats) -> Iterable[slice]:
    """Yield the frames between two pauses."""
    breaks = [0, *(np.flatnonzero(np.diff(times_s) > GAP_S) + 1).tolist(), len(times_s)]
    for first, end in pairwise(breaks):
        yield slice(first, end)


def _parts(times_s: Floats, run: slice) -> Iterable[slice]:
    """Yield stretches of a run; what is left over at its end is too short to tell anything."""
    first = run.start
    while first < run.stop and times_s[run.stop - 1] - times_s[first] >= STRETCH_S:
        end = int(np.searchsorted(times_s, times_s[first] + STRETCH_S))
        if end - first >= 10:
            yield slice(first, end)
        first = end


def _stretch(series: Series, part: slice, steps_s: Floats) -> Stretch:
    times_s, figures_m = series.times_s[part], series.figures_m[part]
    slope_mps, middle_m, middle_s = _robust_line(times_s, figures_m)
    line_m = middle_m + slope_mps * (times_s - middle_s)
    errors = (figures_m - line_m) / series.noises_m[part]
    return Stretch(
        steps_s=np.minimum(steps_s[part], GAP_S),
        first_m=float(line_m[0]),
        last_m=float(line_m[-1]),
        errors=errors,
        spread=_spread(errors),
        is_moving=_is_moving(times_s, errors),
    )


def _is_moving(times_s: Floats, errors: Floats) -> bool:
    spread = _spread(errors)
    if spread > CLEARLY_LARGER and _correlation([errors], spread) > MOVES_CORRELATION:
        return True
    jitter = _spread(np.diff(errors, n=2))  # what changes from frame to frame, of which a movement has next to nothing
    half = max(2, round(LASTING_S / 2 / _usual_step_s(times_s)))
    padded = np.pad(errors, half, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    seen = windows[np.isfinite(windows).mean(axis=1) >= SEEN_SHARE]
    lasting = np.abs(np.nanmedian(seen, axis=1)).max(initial=0.0)
    return bool(lasting > MOVES_SIGMAS * max(jitter, 1.0))


def _robust_line(times_s: Floats, figures_m: Floats) -> tuple[float, float, float]:
    """Return slope, height at the mean time, and the mean time, of a line that outliers do not draw to themselves."""
    seen = np.isfinite(figures_m)
    times_s, figures_m = times_s[seen], figures_m[seen]
    middle_s = float(times_s.mean())
    weights = (np.abs(figures_m - np.median(figures_m)) <= 0.3 * np.median(figures_m)).astype(float)
    slope, height = 0.0, float(np.median(figures_m))
    # Iteratively reweighted least squares: beyond three robust standard deviations weights fall with the fourth power.
    for _ in range(_FIT_ROUNDS):
        slope, height = np.polyfit(times_s - middle_s, figures_m, 1, w=np.sqrt(weights))
        off = np.abs(figures_m - height - slope * (times_s - middle_s))
        limit = 3 * max(_MAD_TO_SIGMA * float(np.median(off)), 1e-9)
        weights = np.maximum(np.minimum(1.0, limit / np.maximum(off, 1e-12)) ** 4, 1e-9)
    return float(slope), float(height), middle_s


def _spread(errors: Floats) -> float:
    return _MAD_TO_SIGMA * float(np.nanmedian(np.abs(errors)))


def _calm(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches in which a straight line fits about as well as it ever does, and for all of the time."""
    steady = [stretch for stretch in stretches if not stretch.is_moving]
    if not steady:
        return []
    usual = float(np.quantile([stretch.spread for stretch in steady], 0.25))
    return [stretch for stretch in steady if stretch.spread <= CALM_TIMES * usual + 1e-9]


def _restore_variance(calm: Sequence[Stretch]) -> list[Stretch]:
    """Return calm stretches whose errors are as large as they were before a line was laid through them.

    A line takes two of the independent errors to itself, and errors that last are fewer than the frames.
    """
    errors = [stretch.errors for stretch in calm]
    # n frames with autocorrelation ρ hold n (1 - ρ) / (1 + ρ) independent errors; a line with two parameters fitted to
    # m of them leaves a variance of (1 - 2/m) of what it was.
    correlation = max(0.0, _correlation(errors, max(_spread(np.concatenate(errors)), 1e-3)))
    frames = float(np.mean([len(each) for each in errors]))
    independent = max(4.0, frames * (1 - correlation) / (1 + correlation))
    grown = 1 / math.sqrt(1 - 2 / independent)
    return [replace(each, errors=each.errors * grown, spread=each.spread * grown) for each in calm]


def _correlation(errors: Sequence[Floats], ratio: float) -> float:
    """Return the correlation from one frame to the next, of errors that are not gross."""
    before = np.concatenate([each[:-1] for each in errors])
    after = np.concatenate([each[1:] for each in errors])
    usable = (np.abs(before) < GROSS_SIGMAS * ratio) & (np.abs(after) < GROSS_SIGMAS * ratio)
    if usable.sum() < 10 or not before[usable].std() or not after[usable].std():
        return 0.0
    return float(np.corrcoef(before[usable], after[usable])[0, 1])
