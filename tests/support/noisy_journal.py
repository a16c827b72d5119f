"""The journal of a target that moves as a test says, with the noise that measurements have."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import measured

SIGMA_PER_M2 = 0.006
"""The standard deviation of the noise, which measurements state, divided by the square of the distance."""

CORRELATION = 0.6
"""Of the noise, from one frame to the next."""

SECONDS, FRAMES_PER_S = 120.0, 15.0


def write_noisy_journal(path: Path, where_m: Callable[[float], float]) -> Path:
    """Write the journal of a run without rules.

    Args:
        where_m: How far away the target truly is at a time in seconds.
    """
    random = np.random.default_rng(1)
    state = initial_state(Plan(targets=("ball",)))
    writer = JournalWriter(path, RecordedConfiguration(text=""))
    error = random.normal()
    for number in range(round(SECONDS * FRAMES_PER_S)):
        at_s = number / FRAMES_PER_S
        error = CORRELATION * error + math.sqrt(1 - CORRELATION**2) * random.normal()
        true_m = where_m(at_s)
        seen_m = true_m + error * SIGMA_PER_M2 * true_m**2
        sight = measured("ball", at_s, seen_m, SIGMA_PER_M2 * seen_m**2)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        observation = Observation(now_s=at_s + 0.01, frame=frame, measurements=(sight,))
        state, decision = decide(state, observation)
        writer.write(CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision))
    writer.close()
    return path
