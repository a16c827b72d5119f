"""A rule that fired wrongly a while ago: its configuration, and the recording of what it saw."""

from __future__ import annotations

import math
import os
import random
from collections.abc import Callable
from pathlib import Path

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import to_be_recorded
from stadimeter.app.recordings.recording import Recorded, RecordingWriter
from stadimeter.app.timeline import TimelineKeeper
from stadimeter.config.loader import load_configuration
from stadimeter.core.clock import DAY_S
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from support.browser import STILL
from support.observing import Rehearsal

KEPT = '[timeline]\nkeep = "7 d"\n[recording]\nlast = "1 h"\n'
CONFIGURATION = KEPT + STILL.replace('ack = "required"\nlatch = true\n', "")
"""A buzzer sounds when the ball is nearer than a metre."""

SECONDS = 240
FRAME_S = 0.1
VISITS = {30: (0.92, 2.0), 90: (0.5, 6.0), 150: (0.9, 2.0), 200: (0.6, 5.0)}
"""When, how near and for how long: two that came by, and two that came to stay."""
BY_S, STAYED_S = 31.5, 93.0
"""A moment of the first that came by, and of the first that stayed."""


def distance_m(at_s: float) -> float:
    """Return how far away the ball was."""
    nearest = [0.0] + [
        (3.2 - near_m) * math.exp(-(((at_s - begin_s - stay_s / 2) / (stay_s / 2 + 0.8)) ** 8))
        for begin_s, (near_m, stay_s) in VISITS.items()
    ]
    return 3.2 - max(nearest)


def record(folder: Path, began_unix_s: float) -> Path:
    """Write the configuration, and the recording and the timeline of a run by it that began at a time."""
    place = folder / "stadimeter.toml"
    place.write_text(CONFIGURATION)
    configuration = load_configuration(place)
    (folder / "recordings").mkdir(exist_ok=True)
    path = folder / "recordings" / "evening.mcap"
    written = Recorded(configuration=to_be_recorded(configuration))
    writer = RecordingWriter(path, written, anchor_ns=round(began_unix_s * 1e9))
    watched = _Watched(configuration.plan, FRAME_S)
    keeper = TimelineKeeper(folder / "timeline" / place.stem, DAY_S, lambda: began_unix_s + watched.now_s)
    watched.listeners += [writer.write, keeper]
    random_ = random.Random(1)  # noqa: S311 - noise of a measurement
    frames = range(round(SECONDS / FRAME_S))
    watched.see(*(distance_m(each * FRAME_S) + random_.gauss(0, 0.01) for each in frames))
    writer.close()
    keeper.close()
    os.utime(path, (began_unix_s + SECONDS, began_unix_s + SECONDS))
    return path


class _Watched(Rehearsal):
    """A rehearsal whose cycles are written down."""

    def __init__(self, plan: Plan, frame_s: float) -> None:
        super().__init__(plan, frame_s)
        self.listeners: list[Callable[[CycleRecord], None]] = []

    def cycle(self, observation: Observation) -> Decision:
        decision = super().cycle(observation)
        for listener in self.listeners:
            listener(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
        return decision
