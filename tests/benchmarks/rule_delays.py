"""What an on-delay and an off-delay do on noise, and with a condition that is interrupted. Run it for a table.

The box of `rule_policies`, at a threshold T of 2 m and of 8 m. Four questions to each delay:

* The object hovers exactly at T: how often is the alarm raised or cleared a minute?
* It stands three standard deviations behind T: how often is it raised for nothing?
* It comes at 2 m/s and stays: how long after the crossing and the delay is it raised?
* It comes in for 90 % of the delay, goes out for 50 % of it, and comes in for 90 %, with 10 standard deviations on
  either side of T, and at least 0.3 m: was it raised, though it was near throughout at no time?

The last one for the off-delay as well: away for 90 %, back for 50 %, away for 90 %. Did it clear?
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct, field
from part import Part, commit, table
from rule_policies import (
    BEHIND_SIGMAS,
    FRAMES_PER_S,
    NEAREST_M,
    SPEED_MPS,
    THRESHOLDS_M,
    Distances,
    Turn,
    judged,
    late_s,
    measure,
    plan_of,
    sigma_m,
)

from stadimeter.core.plan import Plan
from support.scenes import draw

RUNS, RUN_S, APPROACHES = 10, 60.0, 100
INTERRUPTED_SIGMAS, INTERRUPTED_LEAST_M = 10.0, 0.3
IN_SHARE, OUT_SHARE = 0.9, 0.5
BEFORE_S = 3.0

DELAYS_S = {
    "measured, for 0.5 s": 0.5,
    "measured, for 2 s": 2.0,
    "as it comes, for 0.5 s": 0.5,
    "as it comes, for 2 s": 2.0,
    "as it comes, for 10 s": 10.0,
}
"""The on-delay of each rule, by what the table calls it."""

ENDING = "as it comes, off after 10 s"
ENDING_S = 10.0


class Score(Struct, kw_only=True):
    """What one delay did at one threshold."""

    minutes: float = 0.0
    hover_turns: int = 0
    false_raises: int = 0
    late_s: list[float] = field(default_factory=list)
    interrupted: int = 0
    fooled: int = 0


Scores = dict[str, dict[float, Score]]
"""By rule and threshold."""

LEAKY_COMMIT = "bbc41ad42f"
LEAKY: list[tuple[str, ...]] = [
    ("measured, for 0.5 s", "1.00 / 1.00", "0.000 / 0.000", "0.039 / 0.019 s", "0.10 / 0.24 s", "13 / 5 %"),
    ("measured, for 2 s", "1.00 / 1.00", "0.000 / 0.000", "0.124 / 0.038 s", "0.20 / 0.20 s", "100 / 98 %"),
    ("as it comes, for 0.5 s", "1.00 / 1.00", "0.000 / 0.000", "0.045 / 0.103 s", "0.10 / 0.37 s", "11 / 5 %"),
    ("as it comes, for 2 s", "0.30 / 1.00", "0.000 / 0.000", "0.129 / 0.106 s", "0.20 / 0.33 s", "100 / 98 %"),
    ("as it comes, for 10 s", "0.00 / 0.00", "0.000 / 0.000", "0.175 / 0.229 s", "0.27 / 0.47 s", "100 / 100 %"),
    ("as it comes, off after 10 s", "1.00 / 1.00", "0.000 / 0.000", "0.007 / 0.079 s", "0.07 / 0.27 s", "100 / 100 %"),
]
"""The rows of that commit, whose timers were set back by contrary time, with the random numbers of the report."""


def _written(what: str, delay_s: float) -> str:
    if what == ENDING:
        return f'when = {{ below = "%(limit)s" }}\noff_delay = "{delay_s:g} s"\n'
    probability = ', probability = "none"' if what.startswith("measured") else ""
    return f'when = {{ below = "%(limit)s"{probability} }}\non_delay = "{delay_s:g} s"\n'


def _frames(seconds: float) -> int:
    return round(seconds * FRAMES_PER_S)


class _Trial:
    """One rule at one threshold."""

    def __init__(self, what: str, delay_s: float, limit_m: float, score: Score) -> None:
        self.what, self.delay_s, self.limit_m, self.score = what, delay_s, limit_m, score
        self._plan: Plan = plan_of({what: _written(what, delay_s)}, limit_m)[0]

    def turns(self, true_m: Distances, random: np.random.Generator) -> list[Turn]:
        times_s = np.arange(len(true_m)) / FRAMES_PER_S
        (turns,) = judged(self._plan, measure(true_m, random), times_s).values()
        return turns

    def stand(self, random: np.random.Generator, run_s: float) -> None:
        behind_m = self.limit_m + BEHIND_SIGMAS * sigma_m(self.limit_m)
        self.score.minutes += run_s / 60
        self.score.hover_turns += len(self.turns(np.full(_frames(run_s), self.limit_m), random))
        raised = self.turns(np.full(_frames(run_s), behind_m), random)
        self.score.false_raises += sum(turn.is_raise for turn in raised)

    def approach(self, random: np.random.Generator) -> None:
        times_s = np.arange(_frames(BEFORE_S + self.delay_s + 3.0)) / FRAMES_PER_S + random.random() / FRAMES_PER_S
        true_m = np.maximum(self.limit_m - SPEED_MPS * (times_s - BEFORE_S), NEAREST_M)
        wait_s = self.delay_s if self.what != ENDING else 0.0
        self.score.late_s.append(late_s(self.turns(true_m, random), BEFORE_S) - wait_s)

    def interrupt(self, random: np.random.Generator) -> None:
        """Fulfil the condition twice, each time for shorter than the delay."""
        off_m = max(INTERRUPTED_SIGMAS * sigma_m(self.limit_m), INTERRUPTED_LEAST_M)
        near_m, away_m = max(self.limit_m - off_m, NEAREST_M), self.limit_m + off_m
        if self.what == ENDING:
            near_m, away_m = away_m, near_m
        steps = ((away_m, BEFORE_S), *((near_m, IN_SHARE), (away_m, OUT_SHARE), (near_m, IN_SHARE)), (away_m, 0.3))
        lengths = [BEFORE_S if at == 0 else share * self.delay_s for at, (_, share) in enumerate(steps)]
        true_m = np.concatenate(
            [np.full(_frames(for_s), at_m) for (at_m, _), for_s in zip(steps, lengths, strict=True)]
        )
        self.score.interrupted += 1
        self.score.fooled += any(turn.is_raise is (self.what != ENDING) for turn in self.turns(true_m, random))


def simulate(seed: int, runs: int = RUNS, run_s: float = RUN_S, approaches: int = APPROACHES) -> Scores:
    """Try every delay at every threshold.

    Args:
        seed: What the random numbers begin with.
        runs: How many runs of standing.
        run_s: How long each is.
        approaches: How many approaches, and how many interrupted stays.

    Returns:
        The scores.
    """
    scores: Scores = {}
    for what, delay_s in {**DELAYS_S, ENDING: ENDING_S}.items():
        for limit_m in THRESHOLDS_M:
            score = scores.setdefault(what, {})[limit_m] = Score()
            trial, random = _Trial(what, delay_s, limit_m, score), np.random.default_rng([seed, round(limit_m)])
            for _ in range(runs):
                trial.stand(random, run_s)
            for _ in range(approaches):
                trial.approach(random)
                trial.interrupt(random)
    return scores


def rows(scores: Scores) -> list[tuple[str, ...]]:
    """Return a row of the table for each delay."""
    return [_row(what, list(each.values())) for what, each in scores.items()]


def _row(what: str, scores: Sequence[Score]) -> tuple[str, ...]:
    return (
        what,
        " / ".join(f"{score.hover_turns / score.minutes:.2f}" for score in scores),
        " / ".join(f"{score.false_raises / score.minutes:.3f}" for score in scores),
        " / ".join(f"{_mean(score.late_s):.3f}" for score in scores) + " s",
        " / ".join(f"{np.quantile(score.late_s, 0.95):.2f}" for score in scores) + " s",
        " / ".join(f"{100 * score.fooled / score.interrupted:.0f}" for score in scores) + " %",
    )


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


HEAD = (
    "rule",
    "raised or cleared a minute, at T",
    "false raises a minute, at T + 3 σ",
    "late beyond the delay: mean",
    "late: p95",
    "raised or cleared by an interrupted condition",
)


def run(seed: int) -> Part:
    """Simulate, for the report."""
    text = (
        f"{RUNS} runs of {RUN_S:g} s at T and {BEHIND_SIGMAS:g} σ behind it, {APPROACHES} approaches at {SPEED_MPS:g} "
        f"m/s, and {APPROACHES} interrupted stays, at a threshold T of 2 m / 8 m, with the noise of *Rules on noise*. "
        '*Measured* has `probability = "none"`. An interrupted stay is near for 90 % of the delay, away for 50 % of '
        "it, and near for 90 %: at no time throughout. With a delay of 0.5 s that is 0.25 s away, of which the filter "
        "shows 0.1 to 0.2 s, so that some of it is within the tolerance of 150 ms.\n\n"
    )
    now = f"Commit {commit()}, what a delay waits for lasts throughout:\n\n{table(HEAD, rows(simulate(seed)))}\n"
    before = f"Commit {LEAKY_COMMIT}, timers were set back by contrary time:\n\n{table(HEAD, LEAKY)}"
    return Part(title="Delays", text=text + now + before)


def main() -> None:
    """Simulate and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--approaches", type=int, default=APPROACHES)
    parser.add_argument("--tuning", action="store_true", help="other random numbers: those to choose defaults by")
    asked = parser.parse_args()
    seed = (draw.TUNING_SEEDS if asked.tuning else draw.REPORT_SEEDS).start
    print(table(HEAD, rows(simulate(seed, asked.runs, approaches=asked.approaches))))


if __name__ == "__main__":
    main()
