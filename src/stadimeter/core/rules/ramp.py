"""An output that grows with distance, or with nearness."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.condition_words import describe_unseen
from stadimeter.core.conditions.distance import distance_figure
from stadimeter.core.conditions.figures import quantity_of
from stadimeter.core.conditions.leaf import UNKNOWN, Rest
from stadimeter.core.decision import RuleStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rule_step import LevelRequest, Step, trace_of
from stadimeter.core.rules.ramp_level import flat_interval_m, ramp_level
from stadimeter.core.track import Track
from stadimeter.core.words import metres


@dataclass(frozen=True, slots=True, kw_only=True)
class RampStep(Step):
    """What a ramp does in one cycle."""

    level: float = 0.0
    """The level that it gives, 0 to 1; above zero, it holds on to noise."""


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run."""
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_ramp(rule: RampRule, before: RampStep, track: Track) -> RampStep:
    """Judge a ramp for one cycle; the step before is returned if nothing changed."""
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    return _step(rule, before, RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE, level)


def rest_of_ramp(rule: RampRule, step: RampStep, track: Track) -> Rest | None:
    """Return for how long a ramp stays at its level; None if it must be judged in every cycle."""
    figures, figure = quantity_of(track, rule.quantity), distance_figure(rule.target, rule.quantity)
    if figures is None:
        return Rest(((figure, UNKNOWN, UNKNOWN),))
    flat = flat_interval_m(rule, figures[0])
    # A level that is only held against noise ends when the noise changes.
    if flat is None or (step.level > 0 and ramp_level(rule, *figures, is_on=False) == 0):
        return None
    return Rest(((figure, *flat),))


def why(rule: RampRule, track: Track) -> str:
    """Return why a ramp does what it does, in words with figures."""
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return describe_unseen(track)
    now = metres(*figures[:2])
    if rule.points:
        (near_m, at_near), (far_m, at_far) = rule.points[0], rule.points[-1]
        table = f"the table from {near_m:.2f} m ({at_near:.0%}) to {far_m:.2f} m ({at_far:.0%})"
        return f"{now}: {ramp_level(rule, *figures, is_on=False):.0%} by {table}"
    return f"{now} between {rule.start_m:.2f} m (off) and {rule.full_m:.2f} m (full)"


def _step(rule: RampRule, before: RampStep, status: RuleStatus, level: float) -> RampStep:
    if status is before.trace.status and level == before.level:
        return before
    requests: tuple[LevelRequest, ...] = ()
    if rule.output is not None and level > 0 and not rule.observe:
        requests = (LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level),)
    trace = before.trace if status is before.trace.status else trace_of(rule, status, before.trace)
    return RampStep(trace=trace, requests=requests, level=level)
