"""Journals of a target that stands, comes and goes, with noise of a known kind."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from msgspec import Struct

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import measured, missed

GROSS_FACTORS = (0.5, 1.6)


class KnownNoise(Struct, frozen=True, kw_only=True):
    """What kind of noise measurements have.

    Attributes:
        per_m2: Its standard deviation divided by the square of the distance.
        stated_per_m2: The same, as measurements state it.
        correlation: From one frame to the next.
        gross: The share of measurements that are wrong by half.
        missing: The share of frames without a measurement.
    """

    per_m2: float = 0.006
    stated_per_m2: float = 0.006
    correlation: float = 0.6
    gross: float = 0.0
    missing: float = 0.0


def write_noisy_journal(
    path: Path,
    where_m: Callable[[float], float],
    noise: KnownNoise,
    *,
    seconds: float = 120.0,
    frames_per_s: float = 15.0,
    target: str = "ball",
) -> Path:
    """Write the journal of a run without rules.

    Args:
        where_m: How far away the target truly is at a time in seconds.
        frames_per_s: How many frames a second there are.
    """
    random = np.random.default_rng(1)
    state = initial_state(Plan(targets=(target,)))
    writer = JournalWriter(path, RecordedConfiguration(text=""))
    error = random.normal()
    for number in range(round(seconds * frames_per_s)):
        at_s = number / frames_per_s
        error = noise.correlation * error + math.sqrt(1 - noise.correlation**2) * random.normal()
        true_m = where_m(at_s)
        seen_m = true_m + error * noise.per_m2 * true_m**2
        if random.random() < noise.gross:
            seen_m *= random.choice(GROSS_FACTORS)
        sees = random.random() >= noise.missing
        sight = measured(target, at_s, seen_m, noise.stated_per_m2 * seen_m**2) if sees else missed(target, at_s)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        observation = Observation(now_s=at_s + 0.01, frame=frame, measurements=(sight,))
        state, decision = decide(state, observation)
        writer.write(CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision))
    writer.close()
    return path
