"""Reasons why a rule does what it does, and does not do what one might expect: in a sentence, and in figures.

A decision keeps all that this takes, so any moment of a run or of its journal can be asked about.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.alarm import (
    AlarmStep,
    GatedStep,
    OperatedStep,
    describe_alarm,
    describe_gate,
    in_words,
    latched_until,
    policy_in_words,
)
from stadimeter.core.alarms.machine import LATCHED, AlarmRecord, AlarmState, describe_thresholds
from stadimeter.core.conditions.evidence import Evidence, collect_evidence, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Decision, OutputTrace, RuleStatus, SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule, ReportRule, Step, gate_of
from stadimeter.core.rules.follow import FollowStep, describe_follow
from stadimeter.core.rules.ramp import ReportStep, describe_ramp, describe_report
from stadimeter.core.rules.scheduler import EvaluatedRules
from stadimeter.core.words import rounded_duration


class Reasons(Mapping[str, str]):
    """The reason of each rule, by its name. Put into words when it is read: a hundred at every frame cost too much."""

    __slots__ = ("inputs", "judged", "plan")

    def __init__(self, *, plan: Plan, judged: EvaluatedRules, inputs: RuleInputs) -> None:
        self.plan = plan
        self.judged = judged
        self.inputs = inputs

    def __getitem__(self, name: str) -> str:
        rule, step = self.step(name)
        match rule, step:
            case AlarmRule(), AlarmStep():
                return describe_alarm(rule, step.record, self.inputs_of_rules())
            case RampRule() | FollowRule(), GatedStep() if not step.is_open:
                return describe_gate(rule.gate, step, self.inputs_of_rules())
            case RampRule(), _:
                return describe_ramp(rule, self.inputs)
            case FollowRule(), FollowStep():
                return describe_follow(rule, step, self.inputs.tracks[rule.target])
            case ReportRule(), ReportStep():
                gate = describe_gate(rule.gate, step, self.inputs_of_rules())
                return "; ".join(filter(None, (describe_report(rule, step), gate)))
            case _:
                raise TypeError(f"rule {rule.name} remembers a {type(step).__name__}")

    def __iter__(self) -> Iterator[str]:
        return (rule.name for rule in self.plan.rules)

    def __len__(self) -> int:
        return len(self.plan.rules)

    def step(self, name: str) -> tuple[AnyRule, Step]:
        """Return a rule as it was judged, and what it does.

        Raises:
            KeyError: There is no such rule.
        """
        position = self.judged.layout.positions[name]
        return self.judged.rules[position], self.judged.steps[position]

    def record_of(self, name: str) -> tuple[AlarmRule, AlarmRecord] | None:
        """Return an alarm, or the gate of another rule, as it was judged, and what it remembers."""
        rule, step = self.step(name)
        return (gate_of(rule), step.record) if isinstance(step, OperatedStep) else None

    def inputs_of_rules(self) -> RuleInputs:
        """Return all that the rules were judged by, with which of them are active."""
        return replace(self.inputs, active=self.judged.active, raised_at_s=self.judged.raised_at_s)


class Explanation(Struct, frozen=True, kw_only=True):
    """All there is to say of a rule at a moment.

    Attributes:
        at_s: The moment, on the run's clock.
        sentence: All that matters, in words.
        evidence: The figures behind its condition, for each part of it; none for ramps and follow rules.
    """

    rule: str
    at_s: float
    status: RuleStatus
    sentence: str
    evidence: tuple[Evidence, ...] = ()


def explain(decision: Decision, name: str, *, with_probability: bool = True) -> Explanation:
    """Explain a rule.

    Args:
        decision: What was decided at that moment, as `stadimeter.core.decide.decide` returned it.
        with_probability: Whether the sentence says how likely its condition is, and what is remarked on the newest
            measurement, such as which cameras made it: for `explain`, and for no view, which has both elsewhere.

    Raises:
        KeyError: There is no such rule.
        TypeError: The decision was read from a file, and does not know its reasons; decide again.
    """
    reasons = decision.reasons
    if not isinstance(reasons, Reasons):
        raise TypeError("a decision that was read from a file does not know its reasons; decide again")
    rule, step = reasons.step(name)
    inputs = reasons.inputs_of_rules()
    output = next((trace for trace in decision.outputs if trace.output == rule.output), None)
    if isinstance(rule, AlarmRule) and isinstance(step, AlarmStep):
        alarm = _alarm(rule, step, inputs, with_probability=with_probability)
        does = _consequence(rule, step, decision, inputs, output)
        clauses = [*alarm, *does, *describe_thresholds(step.record, inputs.now_s)]
        leaves = step.record.timers.leaves
        found = collect_evidence(rule.condition, inputs, leaves, is_active=step.record.is_judged_by_its_end)
    else:
        inhibits, found = "", ()
        are_set: tuple[str, ...] = ()
        if isinstance(step, GatedStep):
            gate = gate_of(rule)
            inhibits = ", ".join(_inhibits(gate, step.record, inputs))
            are_set = describe_thresholds(step.record, inputs.now_s)
            found = collect_evidence(gate.condition, inputs, step.held, is_active=step.is_open is True)
        quiet = [f"kept quiet: {inhibits}"] if inhibits else []
        does = _consequence(rule, step, decision, inputs, output)
        clauses = [f"{step.trace.status.value}: {reasons[name]}", *quiet, *does, *are_set]
    clauses += _about_target(inputs, rule, with_remark=with_probability)
    return Explanation(
        rule=name, at_s=inputs.now_s, status=step.trace.status, sentence="; ".join(clauses), evidence=found
    )


# Noise that was found to be larger than stated by this factor is told.
NOISY_FACTOR = 1.5


def _about_target(inputs: RuleInputs, rule: AnyRule, *, with_remark: bool) -> Iterator[str]:
    track = inputs.tracks.get(rule.target)
    if track is None:
        return
    if with_remark and track.status is TrackStatus.TRACKING and track.reason:
        yield f"newest measurement of `{rule.target}`: {track.reason}"
    if track.is_valid and track.noise_factor >= NOISY_FACTOR:
        yield f"`{rule.target}` was found to be {track.noise_factor:.1f} times as noisy as its measurements state"


def _alarm(rule: AlarmRule, step: AlarmStep, inputs: RuleInputs, *, with_probability: bool) -> Iterator[str]:
    """Say where an alarm is and why, and what would change that."""
    record = step.record
    words = in_words(rule, record, inputs, with_probability=with_probability)
    if record.unknown_since_s is not None:
        yield _unseen(rule, record, words, inputs.now_s)
        yield from _timers(rule, record, inputs.now_s)
        return
    yield f"{_where(rule, record, inputs.now_s)}: {words}"
    yield from _timers(rule, record, inputs.now_s)
    yield from _turning_points(rule, record, inputs)


_STATES = {
    AlarmState.NORMAL: "not raised",
    AlarmState.PENDING: "not raised yet",
    AlarmState.UNACKNOWLEDGED: "raised{ago}, not acknowledged",
    AlarmState.ACKNOWLEDGED: "raised{ago}",
    AlarmState.CLEARING_UNACKNOWLEDGED: "raised{ago}, about to clear, not acknowledged",
    AlarmState.CLEARING: "raised{ago}, about to clear",
    AlarmState.LATCHED_UNACKNOWLEDGED: "raised{ago}, {latched}",
    AlarmState.LATCHED: "raised{ago}, {latched}",
    AlarmState.RTN_UNACKNOWLEDGED: "over, not acknowledged",
}


def _where(rule: AlarmRule, record: AlarmRecord, now_s: float) -> str:
    ago = f" {rounded_duration(now_s - record.raised_at_s)} ago" if record.raised_at_s is not None else ""
    return _STATES[record.state].format(ago=ago, latched=latched_until(rule, record))


def _unseen(rule: AlarmRule, record: AlarmRecord, words: str, now_s: float) -> str:
    since_s = now_s if record.unknown_since_s is None else record.unknown_since_s
    counts = policy_in_words(rule, record, now_s)
    unseen = f"there is nothing to judge by for {rounded_duration(now_s - since_s)}{counts}: {words}"
    if counts or record.state in LATCHED or record.state is AlarmState.RTN_UNACKNOWLEDGED:
        return f"{_where(rule, record, now_s)}; {unseen}"
    return f"{'held as it was, raised' if record.is_active else 'not raised'}, since {unseen}"


def _timers(rule: AlarmRule, record: AlarmRecord, now_s: float) -> Iterator[str]:
    timers, delay = record.timers, rule.on_delay
    if not record.is_active and (timers.held_last or timers.held_s or any(timers.recent)):
        if delay.hold_s:
            yield f"held for {rounded_duration(timers.held_s)} of the {rounded_duration(delay.hold_s)} that it takes"
        if delay.frames:
            yield f"held in {sum(timers.recent)} of the newest {delay.of_frames} frames; it takes {delay.frames}"
    ended_s = machine.ended_s(rule, record, now_s)
    if ended_s and record.is_active and record.state not in LATCHED:
        yield f"ended for {rounded_duration(ended_s)} of the {rounded_duration(rule.off_delay_s)} that it takes"
    if record.is_chattering:
        calm_s = machine.calms_s(rule, record) - now_s
        yield f"chattering: it does not clear for another {rounded_duration(calm_s)} at least"


def _turning_points(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> Iterator[str]:
    """Say at which figure the verdict on a simple condition would change, unless a delay runs that ends with it."""
    is_on = record.is_judged_by_its_end
    found = collect_evidence(rule.condition, inputs, record.timers.leaves, is_active=is_on)
    if len(found) != 1 or (found[0].holds and not is_on):
        return
    points = found[0].ends_at if is_on else found[0].begins_at
    back = "would hold again" if record.is_active else "would raise"
    verb = "would clear" if found[0].holds else back
    if points:
        yield f"{verb} at {points}"


def _inhibits(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> Iterator[str]:
    inhibits, now_s = record.inhibits, inputs.now_s
    if rule.observe:
        yield "it is only observed" + (", as an operator wants" if record.inhibits.is_observed else "")
    if inhibits.shelved_until_s is not None:
        by = f" by {inhibits.shelved_by}" if inhibits.shelved_by else ""
        until = " at most" if inhibits.is_one_shot else ""
        yield f"shelved{by} for another {rounded_duration(inhibits.shelved_until_s - now_s)}{until}"
    if inhibits.is_suppressed and rule.suppress_when is not None:
        yield f"suppressed: {describe_verdict(rule.suppress_when, inputs, inhibits.leaves, is_active=True)}"
    if inhibits.is_out_of_service:
        yield "out of service"


def _consequence(
    rule: AnyRule, step: Step, decision: Decision, inputs: RuleInputs, output: OutputTrace | None
) -> Iterator[str]:
    """Say what an active rule drives, or why it does not."""
    if isinstance(step, AlarmStep) and isinstance(rule, AlarmRule):
        record, now_s = step.record, inputs.now_s
        inhibits = list(_inhibits(rule, record, inputs))
        if inhibits:
            yield f"kept quiet: {', '.join(inhibits)}"
            return
        if not record.is_active:
            return
        yield from _owed_notice(rule, record, now_s)
        if record.is_announced_only:
            yield "it held when the target was seen first, so it is announced and drives nothing"
        elif record.has_let_go:
            yield "its output was given up: nothing confirms the alarm any more"
    if output is not None and step.requests:
        yield from _commanded(rule, decision, output)


def _owed_notice(rule: AlarmRule, record: AlarmRecord, now_s: float) -> Iterator[str]:
    if record.owes_notice and record.notified_at_s is not None:
        left_s = record.notified_at_s + rule.cooldown_s - now_s
        yield f"no notification for another {rounded_duration(max(0.0, left_s))} (cooldown)"


def _advantage(rule: AnyRule, decision: Decision, output: OutputTrace) -> str:
    """Say what the winner of an output has before a rule."""
    reasons = decision.reasons
    is_equal = isinstance(reasons, Reasons) and reasons.step(output.winner.split("+")[0])[0].priority == rule.priority
    return "the same priority and the level that counts" if is_equal else f"a higher priority than {rule.priority}"


def _commanded(rule: AnyRule, decision: Decision, output: OutputTrace) -> Iterator[str]:
    if output.held_by:
        yield f"but '{output.output}' is held by {output.held_by}, to try it"
    elif rule.name in output.winner.split("+"):
        others = f", before {' and '.join(output.losers)}" if output.losers else ""
        yield f"it commands '{output.output}'{others}"
    elif output.winner == "safety":
        why = output.reason or decision.safety_reason
        yield f"but '{output.output}' is kept safe: {why}"
    else:
        yield f"but '{output.winner}' commands '{output.output}', with {_advantage(rule, decision, output)}"
    if decision.safety is not SafetyMode.ACTIVE and output.winner != "safety":
        yield f"outputs are kept safe: {decision.safety_reason}"
