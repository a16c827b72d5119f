"""Evaluating all rules in a cycle.

A rule that asks for another is judged after it, so it never acts on what was true a cycle ago. What has not changed is
the same object as before: those who listen see at no cost that there is nothing new.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from graphlib import TopologicalSorter
from operator import attrgetter

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.alarms.alarm import AlarmStep, OperatedStep, Stepped, new_alarm, step_alarm, step_gate, with_record
from stadimeter.core.alarms.machine import as_set
from stadimeter.core.alarms.operating import operate
from stadimeter.core.alarms.state import Sample
from stadimeter.core.conditions.compounds import depends_on, judged_by_cycle, leaves
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import SequenceCondition
from stadimeter.core.conditions.quantities import motion_of
from stadimeter.core.decision import Event, EventKind, Notice, RuleTrace
from stadimeter.core.plan import BaseOutput, Output, Plan
from stadimeter.core.rule import (
    AlarmRule,
    AnyRule,
    FollowRule,
    LevelRequest,
    RampRule,
    ReportRule,
    Request,
    Step,
    TwistRequest,
    conditions_of,
    gate_of,
)
from stadimeter.core.rules.follow import FollowStep, new_follow, step_follow
from stadimeter.core.rules.ramp import RampStep, ReportStep, new_ramp, new_report, step_ramp, step_report
from stadimeter.core.tracking.transverse import AskedMotion
from stadimeter.operator_actions import OperatorAnswer, OperatorCommand

# The choice of the winner of an output --------------------------------------------------------------------------------

# The requests for each output that has any, the winner first.
Wanted = Mapping[str, Sequence[Request]]


def arbitrate(requests: Iterable[Request], outputs: Mapping[str, Output] | None = None) -> dict[str, list[Request]]:
    """Sort the requests for each output, the winner first.

    The highest priority wins. Between equals, the output's combination decides.

    Args:
        requests: What the rules want, in the order of the configuration.
        outputs: The outputs, by name.
    """
    by_output: dict[str, list[Request]] = defaultdict(list)
    for request in sorted(requests, key=attrgetter("priority"), reverse=True):  # equals stay in order
        by_output[request.output].append(request)
    for name, wanted in by_output.items():
        if len(wanted) > 1 and outputs and name in outputs:
            by_output[name] = _combine(wanted, outputs[name])
    return by_output


def _combine(wanted: list[Request], output: Output) -> list[Request]:
    equals = [request for request in wanted if request.priority == wanted[0].priority]
    if len(equals) == 1:
        return wanted
    rest = wanted[len(equals) :]
    if isinstance(output, BaseOutput):
        return [_most_restrictive(equals), *rest]
    levels = [request for request in equals if isinstance(request, LevelRequest)]
    levels.sort(key=attrgetter("level"), reverse=output.combine == "max")
    return [*levels, *rest]


def _most_restrictive(equals: list[Request]) -> Request:
    """Return the slower of each speed. Rules that want to go opposite ways stand still."""
    twists = [request for request in equals if isinstance(request, TwistRequest)]
    return TwistRequest(
        rule="+".join(request.rule for request in twists),
        output=twists[0].output,
        priority=twists[0].priority,
        linear_mps=_slowest([request.linear_mps for request in twists]),
        angular_radps=_slowest([request.angular_radps for request in twists]),
        tilt_radps=_slowest([request.tilt_radps for request in twists]),
        is_gentle=all(request.is_gentle for request in twists),
    )


def _slowest(speeds: list[float]) -> float:
    slowest = min(speeds, key=abs)
    return slowest if all(math.copysign(1.0, speed) == math.copysign(1.0, slowest) for speed in speeds) else 0.0


# Facts worked out once for the rules of a plan: the order in which they are judged, and what they take ----------------


class Layout(Struct, frozen=True, kw_only=True):
    """Facts that are worked out once for a plan.

    Attributes:
        order: The positions of the rules in the order of judging: each after those that it asks for.
        asked_for: The positions of the rules that others ask for.
        motions: The motions across the line of sight that any rule takes.
        outputs: The outputs, by name.
        bases: Those that are bases.
        grouped: The positions of the alarms that belong to a group.
        by_cycle: The positions of the alarms that are judged in every cycle, with or without a new frame.
        positions: The position of each rule, by its name.
        sequences: For each rule that a sequence names, by its name, the sequences that it is the last of.
    """

    order: tuple[int, ...] = ()
    asked_for: frozenset[int] = frozenset()
    motions: frozenset[AskedMotion] = frozenset()
    outputs: Mapping[str, Output] = field(default_factory=dict)
    bases: Mapping[str, BaseOutput] = field(default_factory=dict)
    grouped: tuple[int, ...] = ()
    by_cycle: frozenset[int] = frozenset()
    positions: Mapping[str, int] = field(default_factory=dict)
    sequences: Mapping[str, tuple[SequenceCondition, ...]] = field(default_factory=dict)


def layout_of(plan: Plan) -> Layout:
    """Work out what the rules of a plan are judged with.

    Raises:
        CycleError: Rules ask for each other in a circle; a configuration with such rules is refused before.
    """
    positions = {rule.name: index for index, rule in enumerate(plan.rules)}
    asked = {index: [positions[name] for name in sorted(asks_for(rule))] for index, rule in enumerate(plan.rules)}
    alarms = [(index, rule) for index, rule in enumerate(plan.rules) if isinstance(rule, AlarmRule)]
    return Layout(
        order=tuple(TopologicalSorter(asked).static_order()),  # where none asks, in the order of the plan
        asked_for=frozenset().union(*asked.values()),
        motions=frozenset(each for rule in plan.rules for each in _motions(rule)),
        outputs={output.name: output for output in plan.outputs},
        bases={output.name: output for output in plan.outputs if isinstance(output, BaseOutput)},
        grouped=tuple(index for index, rule in alarms if rule.group),
        by_cycle=frozenset(index for index, rule in alarms if judged_by_cycle(rule.condition)),
        positions=positions,
        sequences=_sequences(plan.rules),
    )


def _motions(rule: AnyRule) -> Iterator[AskedMotion]:
    taken = [leaf.motion for condition in conditions_of(rule) for leaf in leaves(condition)]
    if isinstance(rule, RampRule):
        taken.append(motion_of(rule.target, rule.quantity))
    return (each for each in taken if each is not None)


def _sequences(rules: Sequence[AnyRule]) -> dict[str, tuple[SequenceCondition, ...]]:
    parts = (leaf for rule in rules for condition in conditions_of(rule) for leaf in leaves(condition))
    found = list(dict.fromkeys(part for part in parts if isinstance(part, SequenceCondition)))
    named = {name for each in found for name in each.rules}
    return {name: tuple(each for each in found if each.rules[-1] == name) for name in named}


def asks_for(rule: AnyRule) -> frozenset[str]:
    """Return the names of the rules that a rule asks for, by any of its conditions."""
    return frozenset().union(*map(depends_on, conditions_of(rule)))


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
        wanted=_wanted(steps, layout),
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
        "active", "before", "cycle", "events", "first_out", "inputs", "notices", "raised_at_s", "rules", "sample",
        "steps",
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
        self.steps = list(before.steps)
        self.events: list[Event] = []
        self.notices: list[Notice] = []

    def operate(self, command: OperatorCommand) -> OperatorAnswer:
        """Do what an operator wants, before the rules are judged."""
        alarms = {
            rule.name: (index, gate_of(rule), step)
            for index, rule in enumerate(self.rules)
            if isinstance(step := self.steps[index], OperatedStep)
        }
        answer, evaluations = operate(alarms, self.inputs, command)
        for index, evaluation in evaluations:
            _, rule, step = alarms[evaluation.rule.name]
            self.steps[index] = with_record(evaluation.rule, step, evaluation.record)
            if evaluation.rule is not rule:
                set_rule = _with_gate(self.rules[index], evaluation.rule)
                self.rules = (*self.rules[:index], set_rule, *self.rules[index + 1 :])
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
        steps, traces, wanted = before.steps, before.traces, before.wanted
        changed = [pair for pair in zip(before.steps, self.steps, strict=True) if pair[0] is not pair[1]]
        if changed:
            steps = tuple(self.steps)
        # The same object tells those who listen, at no cost, that nothing changed.
        if any(was.trace is not step.trace for was, step in changed):
            traces = tuple([step.trace for step in steps])
        if any(was.requests is not step.requests for was, step in changed):
            wanted = _wanted(steps, before.layout)
        return EvaluatedRules(
            rules=self.rules,
            steps=steps,
            traces=traces,
            wanted=wanted,
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

    def _judge(self, index: int) -> None:
        rule, last = self.rules[index], self.steps[index]
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
        self.steps[index] = step

    def _alarm(self, index: int, rule: AlarmRule, last: AlarmStep) -> Stepped:
        judged = self.cycle if index in self.before.layout.by_cycle else self.sample
        is_first = bool(rule.group) and rule.group not in self.first_out
        return step_alarm(rule, last, self.inputs, judged, self.before.layout.bases, is_first=is_first)

    def _tell_others(self, index: int) -> None:
        """Note whether a rule is active, for those that ask for it."""
        name, is_active = self.rules[index].name, self.steps[index].trace.active
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
        standing = {rule.group for index, rule in alarms if _is_unsettled(self.steps[index])}
        if not standing.issuperset(self.first_out):
            self.first_out = {group: name for group, name in self.first_out.items() if group in standing}
        for index, rule in alarms:
            step, is_first = self.steps[index], self.first_out.get(rule.group) == rule.name
            if step.trace.first_out is not is_first:
                self.steps[index] = replace(step, trace=replace(step.trace, first_out=is_first))


def _is_unsettled(step: Step) -> bool:
    return isinstance(step, AlarmStep) and (step.record.is_active or not step.record.is_acknowledged)


def _wanted(steps: Iterable[Step], layout: Layout) -> Wanted:
    return arbitrate([request for step in steps for request in step.requests], layout.outputs)


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
