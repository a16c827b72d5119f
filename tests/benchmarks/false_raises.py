"""How often alarms are raised for nothing, by several kinds of noise, over hours.

The box of `rule_policies` stands three standard deviations behind a threshold of 8 m. Its height is wrong by 3 px, one
standard deviation, in each kind of noise; of the last kind the middle two thirds are as wide as stated, so that the
standard deviation is larger than stated by nearly half. A rate is given with its 95 % interval, that of a Poisson
variable: a few minutes without a false raise say next to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from part import Part, table
from rule_policies import (
    BEHIND_SIGMAS,
    DEFAULT,
    FOCAL_PX,
    FRAMES_PER_S,
    NOISE_PX,
    OBJECT_M,
    SAFETY,
    SMALLEST_BOX_PX,
    Distances,
    correlated,
    judged,
    measure,
    plan_for,
    sigma_m,
)

THRESHOLD_M = 8.0
MINUTES, RUN_MINUTES = 200, 5
TAILS_DOF = 3
_SIGMA_OF_TAILS = math.sqrt(TAILS_DOF / (TAILS_DOF - 2))
_TWO_THIRDS_OF_TAILS = 1.196
"""68 % of Student's t with `TAILS_DOF` degrees of freedom is within this."""

SURE_SIGMAS = 1.96

Heights = Callable[[int, np.random.Generator], Distances]
"""Return errors of the box's height, in units of `NOISE_PX`."""

WIDER = "heavy tails, wider than stated"

KINDS: dict[str, Heights] = {
    "white": lambda count, random: random.normal(size=count),
    "correlated by 0.6": correlated,
    "heavy tails": lambda count, random: random.standard_t(TAILS_DOF, size=count) / _SIGMA_OF_TAILS,
    WIDER: lambda count, random: random.standard_t(TAILS_DOF, size=count) / _TWO_THIRDS_OF_TAILS,
}
OUTLIERS = "correlated by 0.6, 1 % outliers, 5 % missed"
"""That of `rule_policies`."""


def seen_m(kind: str, true_m: Distances, random: np.random.Generator) -> Distances:
    """Return what is measured of true distances with one kind of noise."""
    if kind == OUTLIERS:
        return measure(true_m, random)
    box_px = FOCAL_PX * OBJECT_M / true_m + NOISE_PX * KINDS[kind](len(true_m), random)
    return FOCAL_PX * OBJECT_M / np.maximum(box_px, SMALLEST_BOX_PX)


def count_raises(kind: str, minutes: int, seed: int) -> dict[str, int]:
    """Return how often our alarms are raised, by what the table calls them."""
    plan, names = plan_for(THRESHOLD_M, (DEFAULT, SAFETY))
    counts = dict.fromkeys(names.values(), 0)
    behind_m = THRESHOLD_M + BEHIND_SIGMAS * sigma_m(THRESHOLD_M)
    times_s = np.arange(1, round(RUN_MINUTES * 60 * FRAMES_PER_S) + 1) / FRAMES_PER_S
    for run in range(minutes // RUN_MINUTES):
        random = np.random.default_rng([seed, run])
        seen = seen_m(kind, np.full(len(times_s), behind_m), random)
        for name, turns in judged(plan, seen, times_s).items():
            counts[names[name]] += sum(turn.is_raise for turn in turns)
    return counts


def interval(count: int, minutes: float) -> tuple[float, float]:
    """Return the 95 % interval of a rate; the formula is that of Wilson and Hilferty, PNAS 17 (12), 1931."""
    low = count and count * (1 - 1 / (9 * count) - SURE_SIGMAS / (3 * math.sqrt(count))) ** 3
    more = count + 1
    return low / minutes, more * (1 - 1 / (9 * more) + SURE_SIGMAS / (3 * math.sqrt(more))) ** 3 / minutes


def run(minutes: int, seed: int) -> Part:
    """Count, for the report."""
    rows, facts = [], {}
    for kind in (*KINDS, OUTLIERS):
        counts = count_raises(kind, minutes, seed)
        rows.append((kind, *(_said(count, minutes) for count in counts.values())))
        facts[f"rules raises {kind}"] = counts[DEFAULT] / minutes
        facts[f"rules raises at most {kind}"] = interval(counts[DEFAULT], minutes)[1]
    text = (
        f"{minutes} minutes each, {BEHIND_SIGMAS:g} σ behind a threshold of {THRESHOLD_M:g} m; raised a minute, with "
        "the 95 % interval of that rate.\n\n" + table(("noise", DEFAULT, SAFETY), rows)
    )
    return Part(title="Raised for nothing", text=text, facts=facts)


def _said(count: int, minutes: float) -> str:
    low, high = interval(count, minutes)
    return f"{count / minutes:.3f} [{low:.3f}, {high:.3f}]"
