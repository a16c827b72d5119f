"""Reload: what alarms remember when their configuration is changed while they run."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms.actions import dismiss
from stadimeter.core.alarms.alarm import AlarmStep, OperatedStep, renew
from stadimeter.core.alarms.settings import as_set
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.summary import Summary
from stadimeter.core.decide import State
from stadimeter.core.decision import Event
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, Step, gate_of
from stadimeter.core.rules.scheduler import new_rules, with_steps
from stadimeter.core.tracking.transverse import motions_for

REMOVED = "removed from the configuration"
CHANGED = "its rule was changed in the configuration"


class ReloadedState(Struct, frozen=True, kw_only=True):
    """A state that goes on with other rules, and what became of which rule."""

    state: State
    kept: tuple[str, ...]
    """The rules that mean the same as before."""
    changed: tuple[str, ...]
    """Those that mean something else now. They begin anew."""
    added: tuple[str, ...]
    removed: tuple[str, ...]


def reload(state: State, plan: Plan) -> ReloadedState:
    """Return a run that goes on with other rules, between two cycles.

    Rules that mean the same go on as if nothing had happened. An alarm whose rule is removed or changed, and that was
    active, clears; the next decision holds the event. What it wanted of outputs is not wanted any more.
    A threshold that an operator has set stays set while the configuration says the same in place of it.

    Args:
        plan: The new rules, with the targets and outputs of the old.
    """
    figures = dict(zip(state.plan.figures, state.figures, strict=True))
    old = {rule.name: (rule, step) for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)}
    is_kept = {rule.name: rule == old[rule.name][0] for rule in plan.rules if rule.name in old}
    now = RuleInputs(
        tracks={each.track.target: each.track for each in state.tracks},
        now_s=0.0 if state.now_s is None else state.now_s,
    )
    first_out = {group: name for group, name in state.rules.first_out.items() if is_kept.get(name)}
    renewed = [
        (old[rule.name][1], ()) if is_kept.get(rule.name) else _renewed(rule, new, old.get(rule.name), now)
        for rule, new in zip(plan.rules, new_rules(plan).steps, strict=True)
    ]
    rules = with_steps(plan, tuple(step for step, _ in renewed), first_out, state.rules.raised_at_s)
    removed = tuple(name for name in old if name not in is_kept)
    gone = dict.fromkeys(removed, REMOVED) | {name: CHANGED for name, same in is_kept.items() if not same}
    return ReloadedState(
        state=replace(
            state,
            plan=plan,
            rules=rules,
            motions=motions_for(rules.layout.motions, state.motions),
            figures=tuple(figures.get(figure, Summary()) for figure in plan.figures),
            due=state.due + _clear_dropped(now, old, gone) + tuple(event for _, events in renewed for event in events),
        ),
        kept=tuple(name for name, same in is_kept.items() if same),
        changed=tuple(name for name, same in is_kept.items() if not same),
        added=tuple(rule.name for rule in plan.rules if rule.name not in old),
        removed=removed,
    )


def _renewed(
    rule: AnyRule, new: Step, old: tuple[AnyRule, Step] | None, inputs: RuleInputs
) -> tuple[Step, tuple[Event, ...]]:
    """Return the step of a rule that is new or means something else, and the events of thresholds that were set."""
    if old is None or not isinstance(new, OperatedStep) or not isinstance(old[1], OperatedStep):
        return new, ()
    return renew(gate_of(rule), new, old[1].record.thresholds, inputs)


def _clear_dropped(
    inputs: RuleInputs, old: Mapping[str, tuple[AnyRule, Step]], gone: Mapping[str, str]
) -> tuple[Event, ...]:
    events: tuple[Event, ...] = ()
    for name, (rule, step) in old.items():
        if name in gone and isinstance(rule, AlarmRule) and isinstance(step, AlarmStep):
            events += dismiss(as_set(rule, step.record), step.record, inputs, gone[name])
    return events
