"""Rules that send messages at times: every so often, or at times of day. They drive nothing.

What was missed, since the program stood still or was not running, is sent once: at a time of day if that is less than
a minute ago, so that a message of midnight does not come at noon; every so often, at once, and then in its rhythm.
"""

from __future__ import annotations

import math

from stadimeter.core.alarms.actions import is_to_be
from stadimeter.core.alarms.alarm import OPEN, Gate, GatedStep
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus
from stadimeter.core.rule import ROUNDING_S, ReportRule, trace_of
from stadimeter.core.words import duration, time_of_day

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
