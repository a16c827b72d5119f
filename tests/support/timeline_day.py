"""A day of a timeline, as a run would have kept it: for tests in a browser, pictures and measurements."""

from __future__ import annotations

import math
import uuid
from pathlib import Path

import numpy as np

from stadimeter.app.timeline import STATES, Names
from stadimeter.core.decision import RuleStatus

DAY_S = 86400
VISIT_S, AWAY_S = 900, 5400
"""Each target comes near for this long, this often."""


def keep_day(folder: Path, end_s: float) -> None:
    """Write a day that ends at a time. A rule ``far`` is active beyond 2.5 m, and ``near`` below a metre.

    Args:
        folder: That of the timeline.
    """
    names = Names(("ball",), ("far", "near"))
    rng = np.random.default_rng(1)
    rows = np.zeros(DAY_S, names.row)
    rows["unix_s"] = at_s = int(end_s) - DAY_S + np.arange(DAY_S)
    phase = at_s % AWAY_S
    near = np.exp(-(((phase - AWAY_S / 2) / VISIT_S) ** 2))
    metres = 3.0 - 2.3 * near + 0.3 * np.sin(at_s / 2000) + rng.normal(0, 0.02, DAY_S)
    spread = rng.exponential(0.03, (2, DAY_S))
    metres[phase < 400] = math.nan
    figures = np.stack([metres, 0.01 * metres**2, metres - spread[0], metres + spread[1], ~np.isnan(metres)], 1)
    rows["figures"][:, 0] = figures
    for number, is_active in enumerate((metres > 2.5, metres < 1.0)):
        state = np.where(is_active, STATES.index(RuleStatus.ACTIVE), STATES.index(RuleStatus.IDLE))
        rows["states"][:, number] = np.where(np.isnan(metres), STATES.index(RuleStatus.UNKNOWN), state)
    folder.mkdir(parents=True, exist_ok=True)
    for day in np.unique(at_s // DAY_S):
        segment = rows[at_s // DAY_S == day]
        name = f"{int(segment['unix_s'][0])}-{uuid.uuid4().hex[:8]}"
        (folder / f"{name}.1").write_bytes(names.head + segment.tobytes())
