"""Evaluating all rules in a cycle.

A rule that asks for another is judged after it, so it never acts on what was true a cycle ago. What has not changed is
the same object as before: those who listen see at no cost that there is nothing new.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.alarms.alarm import AlarmStep, OperatedStep, Stepped, new_alarm, step_alarm, with_record
from stadimeter.core.alarms.gate import step_gate
from stadimeter.core.alarms.operating import operate
from stadimeter.core.alarms.settings import as_set
from stadimeter.core.alarms.state import Sample
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Event, EventKind, Notice, RuleTrace
from stadimeter.core.operator import OperatorAnswer, OperatorCommand
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule, ReportRule, gate_of
from stadimeter.core.rule_step import Step
from stadimeter.core.rules.arbitration import Wanted, arbitrate, rearrange
from stadimeter.core.rules.follow import FollowStep, new_follow, step_follow
from stadimeter.core.rules.layout import Layout, layout_of
from stadimeter.core.rules.ramp import RampStep, new_ramp, step_ramp
from stadimeter.core.rules.report import ReportStep, new_report, step_report

_T = TypeVar("_T")


class EvaluatedRules(Struct, frozen=True, kw_only=True):
    """All rules after a cycle.

    Attributes:
        rules: The rules as they are judged, in the order of the plan: with what operators have set.
        steps: What each rule did.
        traces: The part of it that others see.
        wanted: What they want of each output, the winner first.
        active: Whether each rule that others ask for is active; None for unknown.
        first_out: For each group with an alarm that was raised, the name of the first one.
        raised_at_s: As in `stadimeter.core.conditions.leaf.RuleInputs`.
    """

    rules: tuple[AnyRule, ...] = ()
    steps: tuple[Step, ...] = ()
    traces: tuple[RuleTrace, ...] = ()
    wanted: Wanted = field(default_factory=dict)
    active: Mapping[str, bool | None] = field(default_factory=dict)
    first_out: Mapping[str, str] = field(default_factory=dict)
    raised_at_s: Mapping[str, float] = field(default_factory=dict)
    layout: Layout = field(default_factory=Layout)


class Outcome(Struct, frozen=True, kw_only=True):
    """Result of evaluating all rules."""

    events: tuple[Event, ...] = ()
    notices: tuple[Notice, ...] = ()
    answers: tuple[OperatorAnswer, ...] = ()


_NOTHING = Outcome()


def new_rules(plan: Plan) -> EvaluatedRules:
    """Return the rules of a plan at the start of a run.

    Raises:
        CycleError: Rules ask for each other in a circle.
    """
    return with_steps(plan, tuple(_new_step(rule) for rule in plan.rules))


def with_steps(
    plan: Plan,
    steps: tuple[Step, ...],
    first_out: Mapping[str, str] | None = None,
    raised_at_s: Mapping[str, float] | None = None,
) -> EvaluatedRules:
    """Return the rules of a plan as they were remembered.

    Raises:
        CycleError: Rules ask for each other in a circle.
    """
    layout = layout_of(plan)
    sequences = [each for ending in layout.sequences.values() for each in ending]
    raised_at_s = raised_at_s or {}
    known = {*layout.sequences, *(each.key for each in sequences if raised_at_s.keys() >= {*each.rules})}
    in_sequences = {name: at_s for name, at_s in raised_at_s.items() if name in known}
    for sequence in sequences:
        if sequence.is_complete(in_sequences):
            in_sequences[sequence.key] = in_sequences[sequence.rules[-1]]
    return EvaluatedRules(
        rules=tuple(_as_judged(rule, step) for rule, step in zip(plan.rules, steps, strict=True)),
        steps=steps,
        traces=tuple(step.trace for step in steps),
        wanted=arbitrate((request for step in steps for request in step.requests), layout.combined),
        active={plan.rules[index].name: steps[index].trace.active for index in layout.asked_for},
        first_out=first_out or {},
        raised_at_s=in_sequences,
        layout=layout,
    )


def judge(
    before: EvaluatedRules,
    inputs: RuleInputs,
    sample: Sample | None,
    cycle: Sample,
    commands: tuple[OperatorCommand, ...] = (),
) -> tuple[EvaluatedRules, Outcome]:
    """Judge the rules for one cycle.

    Args:
        before: The rules after the cycle before.
        sample: The frame that is new in this cycle; None without one.
        cycle: The cycle itself. Whether a target is in sight is judged by it: that no frame comes at all is news too.
    """
    evaluation = _Evaluation(before, inputs, sample, cycle)
    answers = tuple([evaluation.operate(command) for command in commands])
    evaluation.judge()
    return evaluation.evaluated_rules(), evaluation.outcome(answers)


class _Evaluation:
    """Evaluates rules one after another, and collects what changes."""

    __slots__ = (
        "active", "before", "changed", "cycle", "events", "first_out", "inputs", "notices", "raised_at_s", "rules",
        "sample",
    )  # fmt: skip

    def __init__(self, before: EvaluatedRules, inputs: RuleInputs, sample: Sample | None, cycle: Sample) -> None:
        self.rules = before.rules
        self.before = before
        self.sample = sample
        self.cycle = cycle
        self.active = before.active
        self.raised_at_s = before.raised_at_s
        asked_for = {"active": before.active, "raised_at_s": before.raised_at_s}
        self.inputs = replace(inputs, **asked_for) if before.active else inputs
        self.first_out = before.first_out
        self.changed: dict[int, Step] = {}
        self.events: list[Event] = []
        self.notices: list[Notice] = []

    def operate(self, command: OperatorCommand) -> OperatorAnswer:
        """Do what an operator wants, before the rules are judged."""
        alarms = {
            rule.name: (index, gate_of(rule), step)
            for index, rule in enumerate(self.rules)
            if isinstance(step := self._step(index), OperatedStep)
        }
        answer, evaluations = operate(alarms, self.inputs, command)
        for index, evaluation in evaluations:
            _, rule, step = alarms[evaluation.rule.name]
            self.changed[index] = with_record(evaluation.rule, step, evaluation.record)
            if evaluation.rule is not rule:
                self.rules = _with(self.rules, {index: _with_gate(self.rules[index], evaluation.rule)})
            self.events += evaluation.events
        return answer

    def judge(self) -> None:
        """Judge every rule, each after those that it asks for."""
        asked_for = self.before.layout.asked_for
        for index in self.before.layout.order:
            self._judge(index)
            if index in asked_for:
                self._tell_others(index)

    def evaluated_rules(self) -> EvaluatedRules:
        """Return the rules after the cycle."""
        before = self.before
        self._mark_first_out()
        changed = {index: step for index, step in self.changed.items() if step is not before.steps[index]}
        steps = _with(before.steps, changed)
        return EvaluatedRules(
            rules=self.rules,
            steps=steps,
            traces=_traces(before, changed),
            wanted=_merge_requests(before, changed, steps),
            active=self.active,
            first_out=self.first_out,
            raised_at_s=self.raised_at_s,
            layout=before.layout,
        )

    def outcome(self, answers: tuple[OperatorAnswer, ...]) -> Outcome:
        """Return the result of it."""
        if not (self.events or self.notices or answers):
            return _NOTHING
        return Outcome(events=tuple(self.events), notices=tuple(self.notices), answers=answers)

    def _step(self, index: int) -> Step:
        return self.changed.get(index, self.before.steps[index])

    def _judge(self, index: int) -> None:
        rule, last = self.rules[index], self._step(index)
        if isinstance(rule, AlarmRule) and isinstance(last, AlarmStep):
            stepped = self._alarm(index, rule, last)
            step: Step = stepped.step
            self.events += stepped.events
            self.notices += stepped.notices
            if rule.group and stepped.events:
                self._note_first_out(rule, stepped.events)
        elif isinstance(rule, RampRule) and isinstance(last, RampStep):
            gate = step_gate(rule.gate, last, self.inputs)
            step = step_ramp(rule, last, self.inputs, gate)
            if gate.events:
                self.events += gate.events
        elif isinstance(rule, FollowRule) and isinstance(last, FollowStep):
            gate, base = step_gate(rule.gate, last, self.inputs), self.before.layout.bases.get(rule.output or "")
            step, events = step_follow(rule, last, self.inputs, base, gate)
            self.events += events
        elif isinstance(rule, ReportRule) and isinstance(last, ReportStep):
            gate = step_gate(rule.gate, last, self.inputs)
            step, notices = step_report(rule, last, self.inputs, gate)
            self.events += gate.events
            self.notices += notices
        else:
            raise TypeError(f"rule {rule.name} remembers a {type(last).__name__}")
        if step is not last:
            self.changed[index] = step

    def _alarm(self, index: int, rule: AlarmRule, last: AlarmStep) -> Stepped:
        judged = self.cycle if index in self.before.layout.by_cycle else self.sample
        is_first = bool(rule.group) and rule.group not in self.first_out
        return step_alarm(rule, last, self.inputs, judged, self.before.layout.bases, is_first=is_first)

    def _tell_others(self, index: int) -> None:
        """Note whether a rule is active, for those that ask for it."""
        name, is_active = self.rules[index].name, self._step(index).trace.active
        if self.active.get(name) is is_active:
            return
        self.active = {**self.active, name: is_active}
        ending = self.before.layout.sequences.get(name)
        if ending is not None and is_active:
            now_s = self.inputs.now_s
            raised = {**self.raised_at_s, name: now_s}
            self.raised_at_s = {**raised, **{each.key: now_s for each in ending if each.is_complete(raised)}}
        self.inputs = replace(self.inputs, active=self.active, raised_at_s=self.raised_at_s)

    def _note_first_out(self, rule: AlarmRule, events: Iterable[Event]) -> None:
        is_raised = any(event.kind is EventKind.RAISED for event in events)
        if is_raised and rule.group not in self.first_out:
            self.first_out = {**self.first_out, rule.group: rule.name}

    def _mark_first_out(self) -> None:
        """Forget the first of a group that has no alarm left, and show it in the traces."""
        if not (self.first_out or self.before.first_out):
            return
        alarms = [
            (index, rule) for index in self.before.layout.grouped if isinstance(rule := self.rules[index], AlarmRule)
        ]
        standing = {rule.group for index, rule in alarms if _is_unsettled(self._step(index))}
        if not standing.issuperset(self.first_out):
            self.first_out = {group: name for group, name in self.first_out.items() if group in standing}
        for index, rule in alarms:
            step, is_first = self._step(index), self.first_out.get(rule.group) == rule.name
            if step.trace.first_out is not is_first:
                self.changed[index] = replace(step, trace=replace(step.trace, first_out=is_first))


def _is_unsettled(step: Step) -> bool:
    return isinstance(step, AlarmStep) and (step.record.is_active or not step.record.is_acknowledged)


def _with(items: tuple[_T, ...], changed: Mapping[int, _T]) -> tuple[_T, ...]:
    if not changed:
        return items
    after = list(items)
    for index, item in changed.items():
        after[index] = item
    return tuple(after)


def _traces(before: EvaluatedRules, changed: Mapping[int, Step]) -> tuple[RuleTrace, ...]:
    """Return the traces. The same object tells those who listen, at no cost, that nothing changed."""
    renewed = {index: step.trace for index, step in changed.items() if step.trace is not before.steps[index].trace}
    return _with(before.traces, renewed)


def _merge_requests(before: EvaluatedRules, changed: Mapping[int, Step], steps: tuple[Step, ...]) -> Wanted:
    pairs = [(before.steps[index].requests, step.requests) for index, step in changed.items()]
    pairs = [(was, now) for was, now in pairs if now is not was]
    if not pairs:
        return before.wanted
    gone = [request for was, _ in pairs for request in was]
    come = [request for _, now in pairs for request in now]
    layout = before.layout
    if layout.combined and any(request.output in layout.combined for request in (*gone, *come)):
        return arbitrate((request for step in steps for request in step.requests), layout.combined)
    return rearrange(before.wanted, gone, come, layout.positions)


def _as_judged(rule: AnyRule, step: Step) -> AnyRule:
    return _with_gate(rule, as_set(gate_of(rule), step.record)) if isinstance(step, OperatedStep) else rule


def _with_gate(rule: AnyRule, alarm: AlarmRule) -> AnyRule:
    """Return a rule as operators have set it."""
    if isinstance(rule, AlarmRule):
        return alarm
    return rule if alarm is rule.gate else replace(rule, gate=alarm, observe=alarm.observe)


def _new_step(rule: AnyRule) -> Step:
    if isinstance(rule, AlarmRule):
        return new_alarm(rule)
    if isinstance(rule, ReportRule):
        return new_report(rule)
    return new_ramp(rule) if isinstance(rule, RampRule) else new_follow(rule)
