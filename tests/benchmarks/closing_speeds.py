"""How often a safety rule about speed stops for a target that is slower, and how late for one that is faster.

A target rests at 4 m for 2 to 3 s, sets off with 5 m/s², and comes at a steady speed. The rule is `severity = "safety"`
with ``closing_speed = { above = "1 m/s" }``. A stop for a target of 0.7 m/s is false. For one that is faster, lateness
counts from the moment in which its true speed is 1 m/s. The noise is that of the box of `rule_policies` at 15 frames a
second, and that of a ball at 30: independent from frame to frame, 0.5 % of the distance at 4 m.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from part import Part, table
from rule_policies import CORRELATION, FRAMES_PER_S, Distances, correlated, plan_of, sigma_m

from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import measured

RUNS = 250
LIMIT_MPS, SLOW_MPS, FAST_MPS = 1.0, 0.7, (1.1, 1.3, 1.5, 2.0)
FROM_M, TO_M, ACCELERATION_MPS2, AT_REST_S = 4.0, 0.5, 5.0, 2.0

RULES = {
    "even odds, `probability = 0.5`": ", probability = 0.5",
    "as it comes": "",
}
BEFORE, DEFAULT = RULES


class Noise(Struct, frozen=True, kw_only=True):
    """Noise of measurements: its share of the distance at `FROM_M`, which grows with the distance."""

    name: str
    rate_hz: float
    share: float
    correlation: float


NOISES = (
    Noise(name="box", rate_hz=FRAMES_PER_S, share=sigma_m(FROM_M) / FROM_M, correlation=CORRELATION),
    Noise(name="ball", rate_hz=30.0, share=0.005, correlation=0.0),
)


def rules() -> tuple[Plan, dict[str, str]]:
    """Return the rules, and what the table calls each."""
    text = 'severity = "safety"\nwhen = {{ closing_speed = {{ above = "{limit} m/s"{more} }} }}\n'
    return plan_of({what: text.format(limit=LIMIT_MPS, more=more) for what, more in RULES.items()}, 0.0)


def distances(speed_mps: float, times_s: Distances, sets_off_s: float) -> Distances:
    """Return the true distances of a target that sets off to a speed."""
    gone_s, speeds_up_s = np.maximum(0.0, times_s - sets_off_s), speed_mps / ACCELERATION_MPS2
    there_m = speed_mps * (gone_s - speeds_up_s / 2)
    return FROM_M - np.where(gone_s < speeds_up_s, ACCELERATION_MPS2 * gone_s**2 / 2, there_m)


def stops_after_s(plan: Plan, speed_mps: float, noise: Noise, random: np.random.Generator) -> dict[str, float]:
    """Return how long after the target set off each rule was raised first; infinite for never."""
    sets_off_s = AT_REST_S + random.random()
    times_s = np.arange(1, round((sets_off_s + (FROM_M - TO_M) / speed_mps) * noise.rate_hz)) / noise.rate_hz
    true_m = distances(speed_mps, times_s, sets_off_s)
    sigmas_m = noise.share * true_m**2 / FROM_M
    errors = correlated(len(times_s), random) if noise.correlation else random.normal(size=len(times_s))
    state, raised = initial_state(plan), {rule.name: math.inf for rule in plan.rules}
    for number, (at_s, seen_m) in enumerate(zip(times_s.tolist(), (true_m + sigmas_m * errors).tolist(), strict=True)):
        stamp = FrameStamp(sequence=number, captured_at_s=at_s)
        sight = measured("object", at_s, seen_m, float(sigmas_m[number]))
        state, decision = decide(state, Observation(now_s=at_s, frame=stamp, measurements=(sight,)))
        for event in decision.events:
            if event.kind is EventKind.RAISED and math.isinf(raised[event.source]):
                raised[event.source] = at_s - sets_off_s
    return raised


def simulate(seed: int, runs: int = RUNS) -> dict[tuple[str, str, float], Distances]:
    """Return how long after the target set off each rule was raised, by noise, rule and speed."""
    plan, names = rules()
    found: dict[tuple[str, str, float], list[float]] = {}
    for noise in NOISES:
        for speed_mps in (SLOW_MPS, *FAST_MPS):
            for run in range(runs):
                random = np.random.default_rng([seed, round(noise.rate_hz), round(10 * speed_mps), run])
                for name, after_s in stops_after_s(plan, speed_mps, noise, random).items():
                    found.setdefault((noise.name, names[name], speed_mps), []).append(after_s)
    return {key: np.array(each) for key, each in found.items()}


def late_s(after_s: Distances) -> Distances:
    """Return how late a rule was, from how long after the target set off it was raised."""
    return np.maximum(0.0, after_s - LIMIT_MPS / ACCELERATION_MPS2)


def run(runs: int, seed: int) -> Part:
    """Simulate, for the report."""
    found, rows = simulate(seed, runs), []
    for noise in NOISES:
        for what in RULES:
            stopped = np.isfinite(found[noise.name, what, SLOW_MPS]).sum()
            late = [late_s(found[noise.name, what, speed_mps]) for speed_mps in FAST_MPS]
            figures = [f"{np.mean(each):.2f} / {np.quantile(each, 0.95):.2f} s" for each in late]
            rows.append((noise.name, what, f"{stopped} of {runs}", *figures))
    head = (
        "noise",
        "rule",
        f"false stops at {SLOW_MPS} m/s",
        *(f"late at {each} m/s: mean / p95" for each in FAST_MPS),
    )
    text = (
        f"A target that rests at {FROM_M:g} m sets off with {ACCELERATION_MPS2:g} m/s²; the rule has "
        f'`severity = "safety"` and `closing_speed = {{ above = "{LIMIT_MPS:g} m/s" }}`. Lateness counts from when '
        "its true speed is that; an alarm that is early counts as 0 s late. The box is that of *Rules on "
        "noise*, at 15 frames a second; the ball has independent noise of 0.5 % of the distance at 4 m, at 30 frames a "
        "second.\n\n" + table(head, rows)
    )
    return Part(title="Closing speed for safety", text=text)
