"""An output that grows with a figure of its target, such as its nearness: along a curve, or by a table of points.

How fast a level may change is a matter of the output (`rise_per_s`, `fall_per_s`), not of the ramp: an output that two
rules drive in turn has one motor, and one answer to how fast that may speed up.
"""

from __future__ import annotations

import math
from bisect import bisect_right

from stadimeter.core.alarms.actions import is_to_be
from stadimeter.core.alarms.alarm import OPEN, Gate, GatedStep
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.leaf import RuleInputs, describe_unread
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of, uncertain_of
from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus
from stadimeter.core.rule import ROUNDING_S, LevelRequest, RampRule, ReportRule, trace_of
from stadimeter.core.words import duration, short_figure, time_of_day, uncertain_figure

# An output that has begun goes on until the target is this far back, in standard deviations of the noise: noise at the
# start must not switch it.
HOLD_ON_SIGMAS = 2.0


class RampStep(GatedStep, frozen=True, kw_only=True):
    """The action of a ramp in one cycle."""

    level: float = 0.0
    """The level that it gives, 0 to 1; above zero, it holds on to noise."""


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run."""
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_ramp(rule: RampRule, before: RampStep, inputs: RuleInputs, gate: Gate = OPEN) -> RampStep:
    """Judge a ramp for one cycle; the step before is returned if nothing changed."""
    figures = uncertain_of(inputs, rule.target, rule.quantity)
    if gate.is_open is False:
        return _step(rule, before, RuleStatus.IDLE, 0.0, gate)
    if figures is None or gate.is_open is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0, gate)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    return _step(rule, before, RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE, level, gate)


def describe_ramp(rule: RampRule, inputs: RuleInputs) -> str:
    """Return why a ramp does what it does, in words with figures."""
    figures = uncertain_of(inputs, rule.target, rule.quantity)
    if figures is None:
        return describe_unread((inputs.tracks[rule.target],), noun_of(rule.quantity))
    now = uncertain_figure(noun_of(rule.quantity), *figures[:2], QUANTITIES[rule.quantity].unit)
    if rule.points:
        (low, at_low), (high, at_high) = rule.points[0], rule.points[-1]
        table = f"the table from {_at(rule, low)} ({at_low:.0%}) to {_at(rule, high)} ({at_high:.0%})"
        return f"{now}: {ramp_level(rule, *figures, is_on=False):.0%} by {table}"
    return f"{now} between {_at(rule, rule.start)} (off) and {_at(rule, rule.full)} (full)"


def _at(rule: RampRule, value: float) -> str:
    return short_figure(value, QUANTITIES[rule.quantity].unit)


def _step(rule: RampRule, before: RampStep, status: RuleStatus, level: float, gate: Gate) -> RampStep:
    is_same = status is before.trace.status and gate.inhibits == before.trace.inhibits
    is_gate_same = gate.record is None and gate.is_open is before.is_open and gate.held == before.held
    if is_same and level == before.level and is_gate_same:
        return before
    record = before.record if gate.record is None else gate.record
    requests: tuple[LevelRequest, ...] = ()
    if rule.output is not None and level > 0 and not gate.inhibits:
        requests = (LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level),)
    trace = before.trace if is_same else trace_of(rule, status, before.trace, gate.inhibits)
    return RampStep(trace=trace, requests=requests, level=level, record=record, is_open=gate.is_open, held=gate.held)


# The level at a figure


def ramp_level(rule: RampRule, value: float, sigma: float, noise: float, *, is_on: bool) -> float:
    """Return the level that a ramp gives.

    Along the curve, with u the share of the way from start to full, limited to 0…1: 0 where u = 0, else
    min + u^gamma · (max − min). By the table: between two points in proportion, beyond the ends as at the ends. What is
    below the dead zone is 0.

    Args:
        value: The ramp's quantity, in its SI unit.
        sigma: Its standard deviation; the bias is within that.
        noise: The part of that which differs from frame to frame.
        is_on: Whether the output is above zero now.
    """
    if rule.bias == "neutral":
        level = _level(rule, value)
    elif rule.bias == "cautious":
        level = max(_levels_within(rule, value, sigma))
    else:
        level = min(_levels_within(rule, value, sigma))
    if level > 0 or not is_on:
        return level
    held = max(rule.dead_zone, 0.0 if rule.points else rule.level_min)
    return held if _is_near_start(rule, value, sigma, noise) else 0.0


def _is_near_start(rule: RampRule, value: float, sigma: float, noise: float) -> bool:
    """Check whether noise alone may have taken a target there from where the output begins."""
    reach = HOLD_ON_SIGMAS * noise + {"neutral": 0.0, "cautious": sigma, "quiet": -sigma}[rule.bias]
    if reach >= 0:
        return max(_levels_within(rule, value, reach)) > 0
    # A quiet ramp begins well within its range, and gives that up only as far as the noise goes.
    return min(_levels_within(rule, value, -reach)) > 0


def _level(rule: RampRule, value: float) -> float:
    level = _by_table(rule, value) if rule.points else _along_curve(rule, value)
    return level if level >= rule.dead_zone else 0.0


def _levels_within(rule: RampRule, value: float, reach: float) -> list[float]:
    """Return the levels among which the least and the greatest within some distance of a value are."""
    low, high = value - reach, value + reach
    between = [at for at, _ in rule.points if low < at < high]
    return [_level(rule, at) for at in (low, *between, high)]


def _along_curve(rule: RampRule, value: float) -> float:
    share = (value - rule.start) / (rule.full - rule.start)
    if share <= 0:
        return 0.0
    if share >= 1:
        return rule.level_max  # exactly: a sum may be rounded to more, and more than 1 is no level
    level = rule.level_min + math.pow(share, rule.gamma) * (rule.level_max - rule.level_min)
    return min(level, max(rule.level_min, rule.level_max))


def _by_table(rule: RampRule, value: float) -> float:
    (before_at, before), (after_at, after) = _neighbours(rule, value)
    if before == after:
        return before
    level = before + (after - before) * (value - before_at) / (after_at - before_at)
    return min(max(level, min(before, after)), max(before, after))  # whatever was rounded


def _neighbours(rule: RampRule, value: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the points around a value; beyond the ends, the same level goes on for ever."""
    index = bisect_right(rule.points, (value, math.inf))
    before = rule.points[index - 1] if index > 0 else (-math.inf, rule.points[0][1])
    after = rule.points[index] if index < len(rule.points) else (math.inf, rule.points[-1][1])
    return before, after


# Rules that send messages at times: every so often, or at times of day. They drive nothing ----------------------------
#
# What was missed, since the program stood still or was not running, is sent once: at a time of day if that is less
# than a minute ago, so that a message of midnight does not come at noon; every so often, at once, and then in its
# rhythm.

# So late a time of day still counts. Two messages are at least twice this apart: a clock that is put back a little, as
# by time synchronisation, sends none again.
LATE_S = 60.0


class ReportStep(GatedStep, frozen=True, kw_only=True):
    """The memory of a rule that sends at times.

    Attributes:
        sent_at_s: When it was last to send, on the run's clock, or began; None before the first cycle, or the first
            message at a time of day.
        count: How often it has sent.
    """

    sent_at_s: float | None = None
    count: int = 0


def new_report(rule: ReportRule) -> ReportStep:
    """Return a rule that sends at times, at the start of a run."""
    return ReportStep(trace=trace_of(rule, RuleStatus.IDLE))


def step_report(
    rule: ReportRule, before: ReportStep, inputs: RuleInputs, gate: Gate = OPEN
) -> tuple[ReportStep, tuple[Notice, ...]]:
    """Send what is due in one cycle.

    What is due while its gate is closed, or it is kept quiet, is not sent later either. Where it is not known whether
    the gate is open, it is sent.
    """
    due, sent_at_s = _due(rule, before, inputs)
    notices = _notices(rule, before.count + 1, inputs, due) if due and gate.lets_move is not False else ()
    trace = trace_of(rule, RuleStatus.IDLE, before.trace, gate.inhibits)
    step = ReportStep(
        trace=trace,
        record=before.record if gate.record is None else gate.record,
        is_open=gate.is_open,
        held=gate.held,
        sent_at_s=sent_at_s,
        count=before.count + bool(notices),
    )
    return before if step == before else step, () if rule.observe else notices


def _due(rule: ReportRule, before: ReportStep, inputs: RuleInputs) -> tuple[str, float | None]:
    """Return why a message is due, empty if none is; and when it was last to send."""
    now_s, every_s = inputs.now_s, rule.every_s
    if every_s is None:
        at = _time_due(rule, before, inputs)
        return (f"at {at}", now_s) if at else ("", before.sent_at_s)
    last_s = now_s if before.sent_at_s is None else before.sent_at_s
    times = math.floor((now_s - last_s + ROUNDING_S) / every_s)
    sent_at_s = last_s + times * every_s if times > 0 else last_s
    return f"every {duration(every_s)}" if times > 0 else "", sent_at_s


def _time_due(rule: ReportRule, before: ReportStep, inputs: RuleInputs) -> str | None:
    """Return the time of day that a message is due for, in words; None for none."""
    if inputs.wall is None or (before.sent_at_s is not None and inputs.now_s - before.sent_at_s < 2 * LATE_S):
        return None
    late_s = {at: (inputs.wall.second_of_day - at) % DAY_S for at in rule.at_seconds}
    return next((time_of_day(at) for at, late in late_s.items() if late < LATE_S), None)


def _notices(rule: ReportRule, count: int, inputs: RuleInputs, reason: str) -> tuple[Notice, ...]:
    event = Event(kind=EventKind.REPORT, source=rule.name, at_s=inputs.now_s, severity=rule.severity, reason=reason)
    steps = [position for position, step in enumerate(rule.gate.escalation) if is_to_be(step, inputs)]
    return tuple(Notice(rule=rule.name, step=position, event=event, count=count) for position in steps)


def when_in_words(rule: ReportRule) -> str:
    """Return when it sends, such as ``every 1 min`` or ``at 00:00 and 12:00``."""
    if rule.every_s is not None:
        return f"every {duration(rule.every_s)}"
    return f"at {' and '.join(map(time_of_day, rule.at_seconds))}"


def describe_report(rule: ReportRule, step: ReportStep) -> str:
    """Return when it sends, and how often it has, in words."""
    return f"sends {when_in_words(rule)}; {step.count} times until now"
