"""An output that grows with distance, or with nearness."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.verdict import no_figures, quantity_of
from stadimeter.core.decision import RuleStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rules.ramp_level import is_flat, ramp_level
from stadimeter.core.rules.request import LevelRequest
from stadimeter.core.rules.step import Step, trace_of
from stadimeter.core.rules.words import metres
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True)
class RampStep(Step):
    """What a ramp does in one cycle.

    Attributes:
        level: The level that it gives; above zero, it holds on to noise.
    """

    level: float = 0.0


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run.

    Args:
        rule: The ramp.

    Returns:
        Its step before the first cycle.
    """
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_ramp(rule: RampRule, before: RampStep, track: Track) -> RampStep:
    """Judge a ramp for one cycle.

    Args:
        rule: The ramp.
        before: Its step in the cycle before.
        track: Its target.

    Returns:
        What it does.
    """
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0, rests=True)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    status = RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE
    # A level that is only held against noise ends when the noise changes.
    rests = is_flat(rule, figures[0]) and (level == 0 or ramp_level(rule, *figures, is_on=False) > 0)
    return _step(rule, before, status, level, rests=rests)


def why(rule: RampRule, track: Track) -> str:
    """Return why a ramp does what it does, in words with figures.

    Args:
        rule: The ramp.
        track: Its target.

    Returns:
        The words.
    """
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return no_figures(track)
    now = metres(*figures[:2])
    if rule.points:
        (near_m, at_near), (far_m, at_far) = rule.points[0], rule.points[-1]
        table = f"the table from {near_m:.2f} m ({at_near:.0%}) to {far_m:.2f} m ({at_far:.0%})"
        return f"{now}: {ramp_level(rule, *figures, is_on=False):.0%} by {table}"
    return f"{now} between {rule.start_m:.2f} m (off) and {rule.full_m:.2f} m (full)"


def _step(rule: RampRule, before: RampStep, status: RuleStatus, level: float, *, rests: bool) -> RampStep:
    if status is before.trace.status and level == before.level and rests is before.rests:
        return before
    requests: tuple[LevelRequest, ...] = ()
    if rule.output is not None and level > 0 and not rule.observe:
        requests = (LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level),)
    trace = trace_of(rule, status, before.trace)
    return RampStep(trace=trace, requests=requests, rests=rests, level=level)
