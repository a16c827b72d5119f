"""Judging all rules in a cycle, without judging those that rest.

Most rules have nothing to do in most cycles: the target is far from their limits, or out of sight. Such a rule says
that it rests. Only those are judged that do not rest, and those with a limit that the target crossed since the cycle
before. So a hundred rules cost little more than the few that have something to do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stadimeter.core.decision import Event, RuleTrace
from stadimeter.core.plan import AlarmRule, AnyRule, BaseOutput, FollowRule, Plan, PresenceCondition, Quantity, RampRule
from stadimeter.core.rules.alarm import AlarmStep, Sample, new_alarm, step_alarm
from stadimeter.core.rules.arbitration import arbitrate
from stadimeter.core.rules.conditions import quantity_of
from stadimeter.core.rules.crossings import Crossings, crossings_of
from stadimeter.core.rules.follow import FollowStep, new_follow, step_follow
from stadimeter.core.rules.ramp import RampStep, new_ramp, step_ramp
from stadimeter.core.rules.request import Request
from stadimeter.core.track import Track

RuleStep = AlarmStep | RampStep | FollowStep
Wanted = Mapping[str, Sequence[Request]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """All rules after a cycle.

    Attributes:
        steps: What each rule did, in the order of the plan.
        traces: The part of it that others see.
        wanted: What they want of each output, the winner first.
        restless: The positions of the rules that must be judged in every cycle.
        crossings: The limits on each figure that rules are judged by. They never change.
        figures_m: Those figures; NaN for one that is not known.
        bases: The names of the outputs that are bases. They never change.
    """

    steps: tuple[RuleStep, ...] = ()
    traces: tuple[RuleTrace, ...] = ()
    wanted: Wanted = field(default_factory=dict)
    restless: tuple[int, ...] = ()
    crossings: tuple[Crossings, ...] = ()
    figures_m: tuple[float, ...] = ()
    bases: frozenset[str] = frozenset()


def not_judged_yet(plan: Plan) -> Judged:
    """Return the rules of a plan at the start of a run.

    Args:
        plan: The plan.

    Returns:
        The rules before the first cycle.
    """
    steps = tuple(_new_step(rule) for rule in plan.rules)
    crossings = crossings_of(plan.rules)
    return Judged(
        steps=steps,
        traces=tuple(step.trace for step in steps),
        restless=tuple(range(len(steps))),
        crossings=crossings,
        figures_m=(math.nan,) * len(crossings),
        bases=frozenset(output.name for output in plan.outputs if isinstance(output, BaseOutput)),
    )


def judge(
    rules: tuple[AnyRule, ...], before: Judged, tracks: Mapping[str, Track], sample: Sample | None, cycle: Sample
) -> tuple[Judged, tuple[Event, ...]]:
    """Judge the rules for one cycle.

    Args:
        rules: The rules.
        before: The rules after the cycle before.
        tracks: The targets, by name.
        sample: The frame that is new in this cycle; None without one.
        cycle: The cycle itself. Whether a target is in sight is judged by it: that no frame comes at all is news too.

    Returns:
        The rules after this cycle, and what happened.
    """
    figures_m = tuple([_figure_m(tracks[each.target], each.quantity) for each in before.crossings])
    awake = set(before.restless)
    for crossings, before_m, now_m in zip(before.crossings, before.figures_m, figures_m, strict=True):
        awake.update(crossings.between(before_m, now_m))
    changed: dict[int, RuleStep] = {}
    events: tuple[Event, ...] = ()
    for index in sorted(awake):
        rule, last = rules[index], before.steps[index]
        is_base = rule.output in before.bases
        step, more = _step(rule, last, tracks[rule.target], sample, cycle, is_base=is_base)
        events += more
        if step is not last:
            changed[index] = step
    steps = _with(before.steps, changed)
    return Judged(
        steps=steps,
        traces=_traces(before, changed, steps),
        wanted=_wanted(before, changed, steps),
        restless=tuple([index for index in awake if not steps[index].rests]),
        crossings=before.crossings,
        figures_m=figures_m,
        bases=before.bases,
    ), events


def _with(steps: tuple[RuleStep, ...], changed: Mapping[int, RuleStep]) -> tuple[RuleStep, ...]:
    if not changed:
        return steps
    after = list(steps)
    for index, step in changed.items():
        after[index] = step
    return tuple(after)


def _traces(before: Judged, changed: Mapping[int, RuleStep], steps: tuple[RuleStep, ...]) -> tuple[RuleTrace, ...]:
    """Return the traces. The same object tells those who listen, at no cost, that nothing changed."""
    if all(step.trace is before.steps[index].trace for index, step in changed.items()):
        return before.traces
    return tuple([step.trace for step in steps])


def _wanted(before: Judged, changed: Mapping[int, RuleStep], steps: tuple[RuleStep, ...]) -> Wanted:
    requests = [(before.steps[index].request, step.request) for index, step in changed.items()]
    requests = [(last, request) for last, request in requests if request is not last]
    if not requests:
        return before.wanted
    if any(last is None or request is None for last, request in requests):
        return arbitrate(step.request for step in steps if step.request is not None)
    # The same rules want something else: who wins stays as it was.
    instead = {request.rule: request for _, request in requests if request is not None}
    wanted = dict(before.wanted)
    for output in {request.output for request in instead.values()}:
        wanted[output] = [instead.get(request.rule, request) for request in wanted[output]]
    return wanted


def _figure_m(track: Track, quantity: Quantity) -> float:
    known = quantity_of(track, quantity)
    return math.nan if known is None else known[0]


def _new_step(rule: AnyRule) -> RuleStep:
    if isinstance(rule, AlarmRule):
        return new_alarm(rule)
    return new_ramp(rule) if isinstance(rule, RampRule) else new_follow(rule)


def _step(
    rule: AnyRule, before: RuleStep, track: Track, sample: Sample | None, cycle: Sample, *, is_base: bool
) -> tuple[RuleStep, tuple[Event, ...]]:
    if isinstance(rule, AlarmRule) and isinstance(before, AlarmStep):
        judged = cycle if isinstance(rule.condition, PresenceCondition) else sample
        return step_alarm(rule, before, track, judged, cycle.at_s, is_base=is_base)
    if isinstance(rule, RampRule) and isinstance(before, RampStep):
        return step_ramp(rule, before, track), ()
    if isinstance(rule, FollowRule) and isinstance(before, FollowStep):
        return step_follow(rule, before, track), ()
    raise TypeError(f"rule {rule.name} remembers a {type(before).__name__}")
