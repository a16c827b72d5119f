"""The effect of a cycle on an alarm. The effect of an operator command on it is in `operating`.

A cycle judges the condition, hands the verdict to the machine (`machine`), and lets the actions follow (`actions`).
"""

from __future__ import annotations

from collections.abc import Container
from typing import NamedTuple

from msgspec import field
from msgspec.structs import replace

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.actions import Evaluation, requests_of, stand
from stadimeter.core.alarms.machine import LATCHED, AlarmRecord, AlarmState, as_set, keep_thresholds
from stadimeter.core.alarms.state import NO_INHIBITS, Sample, SetThreshold, is_too_frequent
from stadimeter.core.conditions.compounds import judge, leaves
from stadimeter.core.conditions.evidence import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus, RuleTrace, Severity
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.rule import ALWAYS, OBSERVED, ROUNDING_S, AlarmRule, LostPolicy, Step, keep_if_same, trace_of
from stadimeter.core.words import duration, figure_in_words

# The actions of an alarm, and what it waits for, in words with figures ------------------------------------------------


def latched_until(rule: AlarmRule, record: AlarmRecord) -> str:
    """Return until when an alarm that latched stays active, such as ``latched until it is reset``."""
    if rule.ack_resets:
        return "latched until it is acknowledged"
    return f"latched until it is {'' if record.is_acknowledged else 'acknowledged and '}reset"


def describe_alarm(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Return why an alarm does what it does, after a cycle, in words with figures."""
    if record.unknown_since_s is None:
        return in_words(rule, record, inputs)
    is_held = record.is_active and not record.has_let_go
    is_held = is_held and machine.decided_by_policy(rule, record, inputs.now_s) is None
    return f"{'held: ' if is_held else ''}{missing_in_words(rule, record, inputs)}: {in_words(rule, record, inputs)}"


def in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs, *, with_probability: bool = False) -> str:
    """Return the figures behind the condition of an alarm."""
    return describe_verdict(
        rule.condition,
        inputs,
        record.timers.leaves,
        is_active=record.is_judged_by_its_end,
        with_probability=with_probability,
    )


def missing_in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Say what is missing to judge by, for how long, and what it counts as. It need not be the rule's own target."""
    away_s = 0.0 if record.unknown_since_s is None else inputs.now_s - record.unknown_since_s
    seen = "not known" if inputs.tracks[rule.target].is_valid else "not seen"
    return f"{seen} for {away_s:.1f} s{policy_in_words(rule, record, inputs.now_s)}"


def given_up_in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Say what becomes of an active alarm that has had nothing to judge by for too long."""
    is_latched = record.state in machine.LATCHED
    then = f"it stays {latched_until(rule, record)}" if is_latched else "the output goes to its safe value"
    return f"active, but {missing_in_words(rule, record, inputs)}; {then}"


def why_not_latched(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Return why there is nothing to reset in an alarm."""
    if not record.is_active:
        return "it is not latched"
    if not rule.latch:
        return "it does not latch, and clears by itself"
    if record.unknown_since_s is None:
        return "its condition still holds"
    if rule.lost.policy is LostPolicy.HOLD:
        late = f"after {duration(rule.lost.fault_after_s)} (lost.fault_after)"
        return (
            f"its condition held when last known; {missing_in_words(rule, record, inputs)}, and it can be reset {late}"
        )
    return f"its condition counts as holding: {missing_in_words(rule, record, inputs)} (lost.policy)"


def policy_in_words(rule: AlarmRule, record: AlarmRecord, now_s: float) -> str:
    """Say what not seeing counts as, such as ``, which counts as danger``; empty while it counts as nothing."""
    decided = machine.decided_by_policy(rule, record, now_s)
    return "" if decided is None else ", which counts as danger" if decided else ", which counts as over"


# At the start of a run, and after a restart, a target may take this long to be seen: until then it is not lost.
AWAITED_S = 10.0


class OperatedStep(Step, frozen=True, kw_only=True):
    """The step of a rule in one cycle, and what it, or its gate, remembers of operators among others."""

    record: AlarmRecord = field(default_factory=AlarmRecord)


class AlarmStep(OperatedStep, frozen=True, kw_only=True):
    """The step of an alarm in one cycle, and what it remembers."""


class Stepped(NamedTuple):
    """An alarm after a cycle: what it does, what happened, and what is to be sent."""

    step: AlarmStep
    """That of the cycle before, if nothing changed."""
    events: tuple[Event, ...]
    notices: tuple[Notice, ...]


def new_alarm(rule: AlarmRule) -> AlarmStep:
    """Return an alarm before the first cycle of a run."""
    return AlarmStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def with_record(rule: AlarmRule, step: OperatedStep, record: AlarmRecord) -> OperatedStep:
    """Return a rule that has another record since its step, by a command or by a restart.

    Args:
        rule: The alarm, or the gate of another rule.
    """
    if not isinstance(step, AlarmStep):
        return replace(step, record=record)
    active = record.is_active or None
    return replace(step, trace=_trace(rule, record, step.trace.status, active, step.trace), record=record)


def renew(
    rule: AlarmRule, step: OperatedStep, were_set: tuple[SetThreshold, ...], inputs: RuleInputs
) -> tuple[OperatedStep, tuple[Event, ...]]:
    """Return a rule that begins anew since it was changed; thresholds stay set as far as they may.

    The events tell which do not.

    Args:
        rule: The alarm, or the gate of another rule.
        step: That with which it begins.
    """
    kept, gone = keep_thresholds(rule, were_set)
    record = AlarmRecord(thresholds=kept)
    evaluation = Evaluation(as_set(rule, record), record, inputs)
    for each in gone:
        was = f"{each.key} was {figure_in_words(each.value, each.unit)}, set by {each.by or 'an operator'}"
        reason = f"{was}; the configuration was changed, and counts"
        evaluation.add_event(EventKind.THRESHOLD_WITHDRAWN, reason, notify=False)
    return with_record(evaluation.rule, step, record), evaluation.events


# ---- One cycle ----


def step_alarm(
    rule: AlarmRule,
    before: AlarmStep,
    inputs: RuleInputs,
    sample: Sample | None,
    bases: Container[str],
    *,
    is_first: bool = False,
) -> Stepped:
    """Evaluate an alarm in one cycle.

    Args:
        before: Its step in the cycle before.
        sample: The frame that is new in this cycle; None without one.
        bases: The names of the outputs that are bases. An alarm stops them.
        is_first: Whether no other alarm of its group has been raised.
    """
    if _stays(rule, before, inputs):
        return Stepped(before, (), ())
    evaluation = Evaluation(rule, before.record, inputs, is_first=is_first)
    record = evaluation.record
    if inputs.is_after_gap:
        machine.restart_timers(record, inputs.now_s)
    verdict = evaluation.judge(rule.condition, record.timers.leaves, is_active=record.is_judged_by_its_end)
    is_awaited = _is_awaited(rule, record, inputs)
    holds = None if is_awaited else verdict.value
    if record.is_chattering:
        record.is_chattering = is_too_frequent(record.raises_at_s, rule.raises_per_min_max, inputs.now_s)
        evaluation.report()
    if holds is None:
        _without_verdict(evaluation, is_awaited=is_awaited)
    else:
        _with_verdict(evaluation, holds, verdict.held, sample)
    stand(evaluation)
    return Stepped(_step(before, evaluation, bases, holds), evaluation.events, evaluation.notices)


def _stays(rule: AlarmRule, before: AlarmStep, inputs: RuleInputs) -> bool:
    """Check whether an alarm surely stays as it is in this cycle, as most do: half the time of an evaluation."""
    record = before.record
    if record.state is AlarmState.NORMAL:
        goes_on = record.leg is not None and bool(rule.escalation)
    else:
        goes_on = record.owes_notice or rule.realarm_s is not None or rule.pattern is not None or bool(rule.escalation)
    if (
        goes_on
        or before.trace.active is not record.is_active  # an operator has changed it
        or inputs.is_after_gap
        or rule.suppress_when is not None
        or record.inhibits is not NO_INHIBITS
        or record.is_chattering
        or record.unknown_since_s is not None
    ):
        return False
    verdict = judge(rule.condition, inputs, record.timers.leaves, is_active=record.is_judged_by_its_end)
    return verdict.value is not None and machine.is_settled(record, verdict.value, verdict.held)


def _with_verdict(evaluation: Evaluation, holds: bool, held: tuple[bool, ...], sample: Sample | None) -> None:
    rule, inputs, record = evaluation.rule, evaluation.inputs, evaluation.record
    if record.unknown_since_s is not None:
        was_given_up, away_s = record.is_given_up, inputs.now_s - record.unknown_since_s
        machine.come_back(rule, record, inputs.now_s)
        if was_given_up:
            reason = f"there is something to judge by again, after {away_s:.1f} s"
            evaluation.add_event(EventKind.MEASUREMENT_BACK, reason, notify=not evaluation.is_quiet)
    if sample is None or machine.is_settled(record, holds, held):
        return
    # A frame whose measurement was refused as an outlier contradicts the track that the condition is judged by: it
    # counts neither way, for both delays.
    if inputs.tracks[rule.target].rejected > 0:
        machine.pass_over(record, sample.since_s)
    else:
        machine.take_sample(rule, record, sample, holds, held, now_s=inputs.now_s)
        evaluation.report()


def _without_verdict(evaluation: Evaluation, *, is_awaited: bool) -> None:
    rule, inputs, record = evaluation.rule, evaluation.inputs, evaluation.record
    if record.resumed is not None:
        if inputs.now_s - record.resumed.at_s < AWAITED_S:
            return
        record.resumed = None
    if is_awaited:
        return
    was_active, was_given_up = record.is_active, record.is_given_up
    machine.take_nothing(rule, record, inputs.now_s)
    has_turned = record.is_active is not was_active
    evaluation.report(
        f"{missing_in_words(rule, record, inputs)}: {in_words(rule, record, inputs)}" if has_turned else ""
    )
    if record.is_given_up and not was_given_up:
        reason = given_up_in_words(rule, record, inputs)
        evaluation.add_event(EventKind.MEASUREMENT_LOST, reason, notify=not evaluation.is_quiet)


def _is_awaited(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> bool:
    """Check whether it would be a guess that a target is lost: at the start none has been seen yet.

    A rule for safety does not wait: to it, not seeing counts at once.
    """
    if rule.severity is Severity.SAFETY or not inputs.tracks:
        return False
    for track in inputs.tracks.values():  # a loop: `any` with a generator takes three times as long
        if track.status is not TrackStatus.SEARCHING:
            return False
    if record.resumed is not None:
        began_s = record.resumed.at_s
    elif record.is_active or record.unknown_since_s is not None:
        return False  # it has gone on from an earlier run, and has waited already
    else:
        began_s = max(inputs.now_s if track.since_s is None else track.since_s for track in inputs.tracks.values())
    if inputs.now_s - began_s + ROUNDING_S >= AWAITED_S:
        return False
    return any(leaf.is_on_sight for leaf in leaves(rule.condition))


def _step(before: AlarmStep, evaluation: Evaluation, bases: Container[str], holds: bool | None) -> AlarmStep:
    """Return the step of an alarm after its evaluation; that of the cycle before if nothing has changed."""
    rule, record, was = evaluation.rule, evaluation.record, before.trace
    if holds is None:
        holds = machine.decided_by_policy(rule, record, evaluation.inputs.now_s)
    status, active = _status(record, holds), record.is_active or (None if holds is None else False)
    requests = requests_of(evaluation, before.requests, bases)
    is_same = (
        status is was.status
        and active is was.active
        and record.is_acknowledged is was.acknowledged
        and record.is_chattering is was.chattering
        and record.inhibits is before.record.inhibits
    )
    if is_same and requests is before.requests and record == before.record:
        return before
    trace = was if is_same else _trace(rule, record, status, active, was)
    return AlarmStep(trace=trace, requests=requests, record=record)


_STATUS = {
    AlarmState.UNACKNOWLEDGED: RuleStatus.ACTIVE,
    AlarmState.ACKNOWLEDGED: RuleStatus.ACTIVE,
    AlarmState.CLEARING_UNACKNOWLEDGED: RuleStatus.CLEARING,
    AlarmState.CLEARING: RuleStatus.CLEARING,
    AlarmState.LATCHED_UNACKNOWLEDGED: RuleStatus.LATCHED,
    AlarmState.LATCHED: RuleStatus.LATCHED,
    AlarmState.RTN_UNACKNOWLEDGED: RuleStatus.RETURNED,
    AlarmState.PENDING: RuleStatus.PENDING,
    AlarmState.NORMAL: RuleStatus.IDLE,
}


def _status(record: AlarmRecord, holds: bool | None) -> RuleStatus:
    if record.has_let_go:
        return RuleStatus.UNKNOWN
    if holds is not None or record.state in LATCHED or record.state is AlarmState.RTN_UNACKNOWLEDGED:
        return _STATUS[record.state]
    return RuleStatus.ACTIVE if record.is_active else RuleStatus.UNKNOWN


def _trace(
    rule: AlarmRule, record: AlarmRecord, status: RuleStatus, active: bool | None, before: RuleTrace
) -> RuleTrace:
    inhibits = record.inhibits.words() if record.inhibits is not NO_INHIBITS else ()
    now = RuleTrace(
        rule=rule.name,
        status=status,
        output=rule.output,
        acknowledged=record.is_acknowledged,
        inhibits=(*inhibits, OBSERVED) if rule.observe else inhibits,
        active=active,
        chattering=record.is_chattering,
    )
    return keep_if_same(now, before)


# The gate of a rule that acts in proportion: whether it may act, and what keeps it quiet ------------------------------
#
# A gate is judged as an alarm is, with hysteresis, and operators shelve it, take it out of service and put it back
# as one. It has no delays: it is open while its condition holds, and closed while it does not. Where that is not
# known the rule does not act either, whatever was before: nothing moves by guess.


class GatedStep(OperatedStep, frozen=True, kw_only=True):
    """The step of a rule with a gate in one cycle, and what it remembers.

    Attributes:
        is_open: Whether the condition of its gate held; None if that was not known.
        held: Whether each part of that condition did.
    """

    is_open: bool | None = None
    held: tuple[bool, ...] = ()


class Gate(NamedTuple):
    """A gate after a cycle."""

    record: AlarmRecord | None
    """None if it is that of the cycle before."""
    is_open: bool | None
    held: tuple[bool, ...]
    inhibits: tuple[str, ...]
    """What keeps the rule quiet, in words."""
    events: tuple[Event, ...]

    @property
    def lets_move(self) -> bool | None:
        """True if a base may be driven; None if that is not known. One that is only observed goes on being judged."""
        return False if any(word != OBSERVED for word in self.inhibits) else self.is_open


# The gate of a rule that has none.
OPEN = Gate(None, True, (), (), ())
_OPEN_OBSERVED = OPEN._replace(inhibits=(OBSERVED,))


def step_gate(rule: AlarmRule, before: GatedStep, inputs: RuleInputs) -> Gate:
    """Judge a gate for one cycle.

    Args:
        before: The step of its rule in the cycle before.
    """
    record = before.record
    if rule.condition is ALWAYS and rule.suppress_when is None and record.inhibits is NO_INHIBITS:
        return _OPEN_OBSERVED if rule.observe else OPEN
    evaluation = Evaluation(rule, record, inputs)
    verdict = evaluation.judge(rule.condition, before.held, is_active=before.is_open is True)
    stand(evaluation)
    is_same = evaluation.record == record
    words = evaluation.record.inhibits.words()
    inhibits = (*words, OBSERVED) if rule.observe else words
    after = None if is_same else evaluation.record
    return Gate(after, verdict.value, verdict.held, inhibits, evaluation.events)


def describe_gate(rule: AlarmRule, step: GatedStep, inputs: RuleInputs) -> str:
    """Return why a gate does not let its rule act, in words with figures; empty where it does."""
    if step.is_open:
        return ""
    words = describe_verdict(rule.condition, inputs, step.held, is_active=False)
    return f"its `when` {'cannot be known' if step.is_open is None else 'does not hold'}: {words}"
