"""Rules that send messages at times: every so often, or at times of day. They drive nothing.

What was missed, since the program stood still or was not running, is sent once: at a time of day if that is less than
a minute ago, so that a message of midnight does not come at noon; every so often, at once, and then in its rhythm.
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from stadimeter.core.conditions.leaf import Rest, RuleInputs
from stadimeter.core.conditions.summary import DAY_S
from stadimeter.core.decision import Event, EventKind, Notice
from stadimeter.core.rule import ROUNDING_S, ReportRule
from stadimeter.core.rule_step import Step
from stadimeter.core.words import duration, time_of_day

# So late a time of day still counts. Two messages are at least twice this apart: a clock that is put back a little, as
# by time synchronisation, sends none again.
LATE_S = 60.0


class ReportStep(Step, frozen=True, kw_only=True):
    """What a rule that sends at times remembers.

    Attributes:
        sent_at_s: When it sent last, on the run's clock, or began; None before the first cycle, or the first message
            at a time of day.
        count: How often it has sent.
    """

    sent_at_s: float | None = None
    count: int = 0


def step_report(
    rule: ReportRule, before: ReportStep, inputs: RuleInputs
) -> tuple[ReportStep, tuple[Notice, ...], Rest | None]:
    """Send what is due in one cycle; return also for how long there is nothing to send.

    One that goes by the time of day is judged in every cycle: that goes by another clock, which may jump.
    """
    now_s, every_s = inputs.now_s, rule.every_s
    if every_s is None:
        due = _time_due(rule, before, inputs)
        return (before, (), None) if due is None else (*_sent(rule, before, inputs, now_s, f"at {due}"), None)
    last_s = now_s if before.sent_at_s is None else before.sent_at_s
    times = math.floor((now_s - last_s + ROUNDING_S) / every_s)
    sent_at_s = last_s + times * every_s
    rest = Rest(due_s=sent_at_s + every_s)
    if times > 0:
        return (*_sent(rule, before, inputs, sent_at_s, f"every {duration(every_s)}"), rest)
    return (before if before.sent_at_s is not None else replace(before, sent_at_s=now_s)), (), rest


def _time_due(rule: ReportRule, before: ReportStep, inputs: RuleInputs) -> str | None:
    """Return the time of day that a message is due for, in words; None for none."""
    if inputs.wall is None or (before.sent_at_s is not None and inputs.now_s - before.sent_at_s < 2 * LATE_S):
        return None
    late_s = {at: (inputs.wall.second_of_day - at) % DAY_S for at in rule.at_seconds}
    return next((time_of_day(at) for at, late in late_s.items() if late < LATE_S), None)


def _sent(
    rule: ReportRule, before: ReportStep, inputs: RuleInputs, sent_at_s: float, reason: str
) -> tuple[ReportStep, tuple[Notice, ...]]:
    count, severity = before.count + 1, rule.severity
    event = Event(kind=EventKind.REPORT, source=rule.name, at_s=inputs.now_s, severity=severity, reason=reason)
    steps = range(0 if rule.observe else len(rule.escalation))
    notices = [Notice(rule=rule.name, step=step, event=event, count=count) for step in steps]
    return replace(before, sent_at_s=sent_at_s, count=count), tuple(notices)


def when_in_words(rule: ReportRule) -> str:
    """Return when it sends, such as ``every 1 min`` or ``at 00:00 and 12:00``."""
    if rule.every_s is not None:
        return f"every {duration(rule.every_s)}"
    return f"at {' and '.join(map(time_of_day, rule.at_seconds))}"


def describe_report(rule: ReportRule, step: ReportStep) -> str:
    """Return when it sends, and how often it has, in words."""
    return f"sends {when_in_words(rule)}; {step.count} times until now"
