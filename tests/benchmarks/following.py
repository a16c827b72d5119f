"""How well a moving target is followed, and whether the stated standard deviation holds.

The noise is that of `rule_policies`, without outliers and gaps, at 2 m and at 4 m. A target rests; sways by ± 0.4 m,
once in 4 s; walks with changing speeds of up to 1.2 m/s; or rests and then approaches at 1 m/s. The first two seconds
of each run are left out: learning. A leap is from 4 m to 1 m; it is late by the time from its first frame to the frame
in which the track is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from part import Part, table
from rule_policies import FRAMES_PER_S, Distances, correlated, sigma_m

from stadimeter.core.measurement import Track
from stadimeter.core.plan import Tracking
from stadimeter.core.tracking.life_cycle import new_track, step
from support.observing import measured

RUNS, RUN_S, LEFT_OUT_S = 200, 8.0, 2.0
AT_M = (2.0, 4.0)
SWAY_M, SWAY_HZ = 0.4, 0.25
WALK_MPS, WALK_MPS2 = 1.2, 1.5
APPROACH_MPS, APPROACH_FROM_S = 1.0, 4.0
LEAP_M, LEAP_RATES_HZ = (4.0, 1.0), (10.0, 15.0)
INSIDE = ((1.0, "68 %"), (1.645, "90 %"), (1.96, "95 %"))

Way = Callable[[float, Distances, np.random.Generator], Distances]
"""Return the true distances at some times, of a target that is at a distance in the beginning."""


def _sways(at_m: float, times_s: Distances, random: np.random.Generator) -> Distances:
    phase = random.uniform(0, 2 * math.pi)
    return at_m + SWAY_M * np.sin(2 * math.pi * SWAY_HZ * times_s + phase)


def _walks(at_m: float, times_s: Distances, random: np.random.Generator) -> Distances:
    true_m, speed_mps, wanted_mps, until_s = np.full(len(times_s), at_m), 0.0, 0.0, 0.0
    most_mps = WALK_MPS2 / FRAMES_PER_S
    for index in range(1, len(times_s)):
        if times_s[index] >= until_s:
            until_s, wanted_mps = times_s[index] + random.uniform(1, 4), random.uniform(-WALK_MPS, WALK_MPS)
        is_far = abs(true_m[index - 1] - at_m) > 0.3 * at_m
        back_mps = math.copysign(wanted_mps, at_m - true_m[index - 1])
        speed_mps += float(np.clip((back_mps if is_far else wanted_mps) - speed_mps, -most_mps, most_mps))
        true_m[index] = true_m[index - 1] + speed_mps / FRAMES_PER_S
    return true_m


WAYS: dict[str, Way] = {
    "rest": lambda at_m, times_s, _: np.full(len(times_s), at_m),
    "sway": _sways,
    "walk": _walks,
    "approach": lambda at_m, times_s, _: (
        at_m + (RUN_S - APPROACH_FROM_S) * APPROACH_MPS - np.maximum(0, times_s - APPROACH_FROM_S) * APPROACH_MPS
    ),
}


def tracks_of(seen_m: Distances, times_s: Distances) -> list[Track]:
    """Return the track after each frame."""
    state, settings, tracks = new_track("object"), Tracking(), []
    for at_s, each_m in zip(times_s.tolist(), seen_m.tolist(), strict=True):
        state = step(state, measured("object", at_s, each_m, sigma_m(each_m)), at_s, settings)
        tracks.append(state.track)
    return tracks


def errors(way: Way, at_m: float, runs: int, seed: int) -> tuple[Distances, Distances, Distances]:
    """Return the errors of tracks in metres and in stated standard deviations, and those of the raw measurements."""
    times_s = np.arange(1, round(RUN_S * FRAMES_PER_S) + 1) / FRAMES_PER_S
    counted = times_s > LEFT_OUT_S
    found: list[tuple[float, float, float]] = []
    for run in range(runs):
        random = np.random.default_rng([seed, round(at_m), run])
        true_m = way(at_m, times_s, random)
        seen_m = true_m + sigma_m(1.0) * true_m**2 * correlated(len(times_s), random)
        for track, true, seen in zip(
            np.array(tracks_of(seen_m, times_s), dtype=object)[counted], true_m[counted], seen_m[counted], strict=True
        ):
            found.append((track.distance_m - true, (track.distance_m - true) / track.sigma_m, seen - true))
    track_m, track_sigmas, raw_m = np.array(found).T
    return track_m, track_sigmas, raw_m


def late_s(rate_hz: float, runs: int, seed: int) -> float:
    """Return the mean time from the first frame after a leap to the one in which the track is there."""
    frames, late = round(3 * rate_hz), []
    times_s = np.arange(1, 2 * frames + 1) / rate_hz
    true_m = np.repeat(LEAP_M, frames)
    for run in range(runs):
        random = np.random.default_rng([seed, round(rate_hz), run])
        tracks = tracks_of(true_m + sigma_m(1.0) * true_m**2 * correlated(len(true_m), random), times_s)
        there = next(
            (
                index
                for index, track in enumerate(tracks[frames:])
                if track.is_valid and (track.distance_m or math.inf) < np.mean(LEAP_M)
            ),
            frames,
        )
        late.append(there / rate_hz)
    return float(np.mean(late))


def run(runs: int, seed: int) -> Part:
    """Follow, for the report."""
    rows, facts = [], {}
    for name, way in WAYS.items():
        for at_m in AT_M:
            track_m, track_sigmas, raw_m = errors(way, at_m, runs, seed)
            inside = [float(np.mean(np.abs(track_sigmas) < limit)) for limit, _ in INSIDE]
            rows.append((f"{name}, {at_m:g} m", *(f"{each:.3f}" for each in inside), _rms(track_m), _rms(raw_m)))
            facts |= {f"follow {name} {at_m:g} m {of}": each for each, (_, of) in zip(inside, INSIDE, strict=True)}
    head = ("motion", *(f"{of} interval holds" for _, of in INSIDE), "rms error", "of raw measurements")
    late = {rate_hz: late_s(rate_hz, runs, seed) for rate_hz in LEAP_RATES_HZ}
    facts |= {f"leap late {rate_hz:g} Hz": each for rate_hz, each in late.items()}
    text = (
        f"{runs} runs of {RUN_S:g} s each.\n\n{table(head, rows)}\n\nA leap from {LEAP_M[0]:g} m to {LEAP_M[1]:g} m is "
        + " and ".join(f"{each:.2f} s late at {rate_hz:g} frames a second" for rate_hz, each in late.items())
        + ".\n"
    )
    return Part(title="Following", text=text, facts=facts)


def _rms(errors_m: Sequence[float] | Distances) -> str:
    return f"{1000 * math.sqrt(float(np.mean(np.square(errors_m)))):.1f} mm"
