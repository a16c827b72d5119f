"""How often alarms flap, how often they are raised for nothing, and how late they are.

The noise is that of a box around an object: 15 frames a second, an object of 0.5 m, a focal length of 1000 px, an error
of 3 px (one standard deviation) of the box's height that is correlated from frame to frame by 0.6. That is 0.024 m at
2 m and 0.384 m at 8 m. In 1 frame of 100 the height is grossly wrong, by 30 % up to a factor of 3, too large as often
as too small; 5 of 100 frames have no box at all.

Three questions, at a threshold T of 2 m and of 8 m:

* The object hovers exactly at T for a minute: how often is the alarm raised or cleared?
* It stands three standard deviations behind T for a minute: how often is the alarm raised, for nothing?
* It comes at 2 m/s: how long after the moment in which its true distance is T is the alarm raised? A frame is on its
  way for half the time between two frames already, 0.033 s. An alarm that is raised too early counts as 0 s late.

The policies that others have judge the measured distance. Ours are rules in a configuration, with the defaults that a
user gets, judged by the filter and the rules of the core. ``--tuning`` of the report takes other
random numbers: those that defaults may be chosen by.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray
from part import Part, table

from stadimeter.config.loader import load_configuration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import measured, missed

FRAMES_PER_S = 15.0
OBJECT_M, FOCAL_PX = 0.5, 1000.0
NOISE_PX, CORRELATION = 3.0, 0.6
OUTLIERS, DROPOUTS = 0.01, 0.05
GROSS_FACTORS = (1.3, 3.0)
SMALLEST_BOX_PX = 2.0
THRESHOLDS_M = (2.0, 8.0)
SPEED_MPS = 2.0
RUNS, RUN_S = 40, 60.0
APPROACHES_A_RUN = 10
APPROACH_S, AFTER_S, NEAREST_M = 3.0, 2.0, 0.3
BEHIND_SIGMAS = 3.0

Distances = NDArray[np.float64]

OURS = {
    "p .95/.20, no band, no delay": """
when = { below = "%(limit)s", probability = 0.95, probability_off = 0.2, deadband_sigmas = 0 }
on_delay = "0 s"
off_delay = "0 s"
""",
    "ours, as it comes": 'when = { below = "%(limit)s" }',
    'ours, `severity = "safety"`': 'severity = "safety"\nwhen = { below = "%(limit)s" }',
}
"""Rules by what the table calls them. `%(limit)s` stands for the threshold."""
DEFAULT, SAFETY = list(OURS)[1:]

CONFIGURATION = """
[camera]
driver = "simulated"

[camera.model]
width_px = 640
height_px = 480
fx_px = 1000.0

[targets.object]
detector = "ideal"

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""


class Turn(Struct, frozen=True, kw_only=True):
    """An alarm was raised, or cleared."""

    at_s: float
    is_raise: bool


class Score(Struct, kw_only=True):
    """What one policy did at one threshold."""

    minutes: float = 0.0
    hover_turns: int = 0
    false_raises: int = 0
    late_s: list[float] = field(default_factory=list)

    @property
    def turns_a_minute(self) -> float:
        """How often the alarm was raised or cleared while the object hovered at the threshold."""
        return self.hover_turns / self.minutes

    @property
    def false_raises_a_minute(self) -> float:
        """How often it was raised while the object stood behind the threshold."""
        return self.false_raises / self.minutes

    @property
    def mean_late_s(self) -> float:
        """How late it was raised, on average."""
        return float(np.mean(self.late_s))


Scores = dict[str, dict[float, Score]]
"""By policy and threshold."""


def sigma_m(distance_m: float) -> float:
    """Return the standard deviation of a measured distance: that of the box, scaled."""
    return distance_m**2 * NOISE_PX / (FOCAL_PX * OBJECT_M)


def measure(true_m: Distances, random: np.random.Generator) -> Distances:
    """Return what is measured of true distances, a frame each; NaN where there is no box."""
    noise_px = NOISE_PX * correlated(len(true_m), random)
    box_px = FOCAL_PX * OBJECT_M / true_m + noise_px
    least, most = np.log(GROSS_FACTORS)
    wrong_by = np.exp(random.uniform(least, most, len(true_m)) * random.choice((-1.0, 1.0), len(true_m)))
    box_px = np.where(random.random(len(true_m)) < OUTLIERS, box_px * wrong_by, box_px)
    measured_m = FOCAL_PX * OBJECT_M / np.maximum(box_px, SMALLEST_BOX_PX)
    return np.where(random.random(len(true_m)) < DROPOUTS, np.nan, measured_m)


def correlated(count: int, random: np.random.Generator) -> Distances:
    """Return noise of unit variance that keeps `CORRELATION` of itself from frame to frame."""
    fresh = random.normal(size=count)
    fresh[1:] *= math.sqrt(1 - CORRELATION**2)
    noise = np.empty(count)
    last = 0.0
    for index, each in enumerate(fresh):
        last = noise[index] = CORRELATION * last + each
    return noise


def plain(distances_m: Distances, times_s: Distances, limit_m: float, band_m: float = 0.0) -> Iterator[Turn]:
    """Judge as most do: the measured distance below the threshold, with a fixed band for the way back."""
    is_active = False
    for at_s, distance_m in zip(times_s, distances_m, strict=True):
        if math.isnan(distance_m):
            continue
        is_below = distance_m < limit_m + band_m * is_active
        if is_below != is_active:
            is_active = is_below
            yield Turn(at_s=float(at_s), is_raise=is_active)


def held_for(distances_m: Distances, times_s: Distances, limit_m: float, hold_s: float) -> Iterator[Turn]:
    """Judge like ``for:`` of well-known home automations: one frame to the contrary starts the wait anew."""
    is_active, since_s = False, math.inf
    for at_s, distance_m in zip(times_s, distances_m, strict=True):
        if math.isnan(distance_m):
            continue
        is_below = distance_m < limit_m
        since_s = min(since_s, at_s) if is_below else math.inf
        should_be = is_below and at_s - since_s >= hold_s - 1e-9
        if should_be != is_active:
            is_active = should_be
            yield Turn(at_s=float(at_s), is_raise=is_active)


PEERS: dict[str, Callable[[Distances, Distances, float], Iterator[Turn]]] = {
    "measured < T": plain,
    "measured < T, fixed band of 0.10 m": lambda seen_m, times_s, limit_m: plain(seen_m, times_s, limit_m, 0.10),
    "measured < T for 0.5 s": lambda seen_m, times_s, limit_m: held_for(seen_m, times_s, limit_m, 0.5),
}


def plan_for(limit_m: float, policies: Sequence[str] = tuple(OURS)) -> tuple[Plan, dict[str, str]]:
    """Return our rules for a threshold, and what the table calls each."""
    return plan_of({what: OURS[what] for what in policies}, limit_m)


def plan_of(rules_by_name: Mapping[str, str], limit_m: float) -> tuple[Plan, dict[str, str]]:
    """Return rules for a threshold, which stands for `%(limit)s` in each, and what the table calls each."""
    names = {f"rule-{number}": what for number, what in enumerate(rules_by_name)}
    written = {name: rules_by_name[what] % {"limit": f"{limit_m} m"} for name, what in names.items()}
    rules = "\n".join(f"[rules.{name}]\n{text}" for name, text in written.items())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policies.toml"
        path.write_text(CONFIGURATION + rules)
        return load_configuration(path).plan, names


def judged(plan: Plan, distances_m: Distances, times_s: Distances) -> dict[str, list[Turn]]:
    """Run the core over measured distances, and return what each rule did."""
    state = initial_state(plan)
    turns: dict[str, list[Turn]] = {rule.name: [] for rule in plan.rules}
    for number, (at_s, distance_m) in enumerate(zip(times_s.tolist(), distances_m.tolist(), strict=True)):
        state, decision = decide(state, _observation(number, at_s, distance_m))
        for event in decision.events:
            if event.source in turns and event.kind in {EventKind.RAISED, EventKind.CLEARED}:
                turns[event.source].append(Turn(at_s=at_s, is_raise=event.kind is EventKind.RAISED))
    return turns


def _observation(number: int, at_s: float, distance_m: float) -> Observation:
    if math.isnan(distance_m):
        seen = missed("object", at_s)
    else:
        seen = measured("object", at_s, distance_m, sigma_m(distance_m))
    return Observation(now_s=at_s, frame=FrameStamp(sequence=number, captured_at_s=at_s), measurements=(seen,))


def late_s(turns: Sequence[Turn], crossed_at_s: float) -> float:
    """Return how long after the object crossed the threshold the alarm stood; infinite if it never did."""
    is_active = False
    for turn in turns:
        if turn.at_s >= crossed_at_s and (is_active or turn.is_raise):
            return 0.0 if is_active else turn.at_s - crossed_at_s
        is_active = turn.is_raise
    return 0.0 if is_active else math.inf


def simulate(seed: int, runs: int = RUNS, run_s: float = RUN_S) -> Scores:
    """Try every policy at every threshold.

    Args:
        seed: What the random numbers begin with.
        runs: How many runs.
        run_s: How long the object hovers, and stands behind the threshold, in each.

    Returns:
        The scores.
    """
    scores: Scores = {what: {limit_m: Score() for limit_m in THRESHOLDS_M} for what in (*PEERS, *OURS)}
    for limit_m in THRESHOLDS_M:
        policies = _Policies(limit_m)
        for run in range(runs):
            _one_run(policies, np.random.default_rng([seed, round(limit_m), run]), run_s, scores)
    return scores


class _Policies:
    """Every policy at one threshold."""

    def __init__(self, limit_m: float) -> None:
        self.limit_m = limit_m
        self._plan, self._names = plan_for(limit_m)

    def __call__(self, true_m: Distances, times_s: Distances, random: np.random.Generator) -> dict[str, list[Turn]]:
        seen_m = measure(true_m, random)
        turns = {what: list(policy(seen_m, times_s, self.limit_m)) for what, policy in PEERS.items()}
        ours = judged(self._plan, seen_m, times_s)
        return turns | {what: ours[name] for name, what in self._names.items()}


def _one_run(policies: _Policies, random: np.random.Generator, run_s: float, scores: Scores) -> None:
    limit_m = policies.limit_m
    times_s = np.arange(1, round(run_s * FRAMES_PER_S) + 1) / FRAMES_PER_S
    for what, turns in policies(np.full(len(times_s), limit_m), times_s, random).items():
        scores[what][limit_m].minutes += run_s / 60
        scores[what][limit_m].hover_turns += len(turns)
    behind_m = limit_m + BEHIND_SIGMAS * sigma_m(limit_m)
    for what, turns in policies(np.full(len(times_s), behind_m), times_s, random).items():
        scores[what][limit_m].false_raises += sum(turn.is_raise for turn in turns)
    for _ in range(APPROACHES_A_RUN):
        times_s = (random.random() + np.arange(round((APPROACH_S + AFTER_S) * FRAMES_PER_S))) / FRAMES_PER_S
        true_m = np.maximum(limit_m - SPEED_MPS * (times_s - APPROACH_S), NEAREST_M)
        for what, turns in policies(true_m, times_s, random).items():
            scores[what][limit_m].late_s.append(late_s(turns, APPROACH_S))


def markdown(scores: Scores) -> str:
    """Return the scores as a Markdown table."""
    head = ("policy", "raised or cleared a minute, at T", "false raises a minute, at T + 3 σ", "late at 2 m/s: mean")
    return table((*head, "late: p95"), [_row(what, list(each.values())) for what, each in scores.items()])


def _row(what: str, scores: Sequence[Score]) -> tuple[str, ...]:
    return (
        what,
        " / ".join(f"{score.turns_a_minute:.2f}" for score in scores),
        " / ".join(f"{score.false_raises_a_minute:.3f}" for score in scores),
        " / ".join(f"{score.mean_late_s:.3f}" for score in scores) + " s",
        " / ".join(f"{np.quantile(score.late_s, 0.95):.2f}" for score in scores) + " s",
    )


def facts(scores: Scores) -> dict[str, float]:
    """Return the figures that the goals are judged by: those of our alarm as it comes."""
    found: dict[str, float] = {}
    for limit_m, score in scores[DEFAULT].items():
        found[f"rules hover {limit_m:g} m"] = score.turns_a_minute
        found[f"rules false {limit_m:g} m"] = score.false_raises_a_minute
        found[f"rules late {limit_m:g} m"] = score.mean_late_s
    return found


def run(runs: int, seed: int) -> Part:
    """Simulate, for the report.

    Args:
        runs: How many runs.
        seed: What the random numbers begin with.

    Returns:
        The part of the report.
    """
    scores = simulate(seed, runs)
    text = (
        f"{runs} runs of {RUN_S:.0f} s each, and {runs * APPROACHES_A_RUN} approaches, at a threshold T of 2 m / 8 m; "
        "15 frames a second, an object of 0.5 m, a focal length of 1000 px, 3 px of noise correlated by 0.6 from frame "
        "to frame (0.024 m at 2 m, 0.384 m at 8 m), 1 % of frames wrong by 30 % to a factor of 3, 5 % without a "
        "measurement. Lateness counts from the moment in which the true distance is T; waiting for the next frame is "
        "0.033 s of it, and an alarm that is early counts as 0 s late.\n\n" + markdown(scores)
    )
    return Part(title="Rules on noise", text=text, facts=facts(scores))
