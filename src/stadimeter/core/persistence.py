"""The memory of alarms beyond the end of a run: a snapshot of them, and how a later run restores it.

An alarm keeps its memory as long as its rule means the same. A rule that was changed in any way is another rule.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from enum import Enum, IntEnum
from operator import attrgetter
from typing import Any, TypeVar, cast

from msgspec import NODEFAULT, Struct, field
from msgspec.structs import fields, replace

from stadimeter.core.alarms.actions import dismiss
from stadimeter.core.alarms.alarm import AlarmStep, OperatedStep, renew, with_record
from stadimeter.core.alarms.machine import AlarmRecord, AlarmState, as_set
from stadimeter.core.alarms.state import Resumed, Timers
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.remembered import RememberedFigure, Summary
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decide import State
from stadimeter.core.decision import Event
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, GatedRule, Step, conditions_of, gate_of
from stadimeter.core.rules.ramp import ReportStep
from stadimeter.core.rules.scheduler import new_rules, with_steps
from stadimeter.core.tracking.life_cycle import TrackState
from stadimeter.core.tracking.transverse import motions_for

# Reload: what alarms remember when their configuration is changed while they run --------------------------------------

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


_T = TypeVar("_T")

# How the names of times on the run's clock end. What ends otherwise is a duration, or no time at all.
_TIME = re.compile(r"(?:.*_)?(?:at|until|since|from|began)_s")

# States that noise leads into and out of, and what an alarm is apart from that.
_SHORTLY = {
    AlarmState.PENDING: AlarmState.NORMAL,
    AlarmState.CLEARING: AlarmState.ACKNOWLEDGED,
    AlarmState.CLEARING_UNACKNOWLEDGED: AlarmState.UNACKNOWLEDGED,
}


# How the rows of figures are called; no rule has a point in its name.
_OF_FIGURES = "figures."

# Likewise of sequences: when each was complete.
_OF_SEQUENCES = "sequences."

# Of a figure over so long a window, each of its slots that is over is written; of others what is there at the end.
_LONG_WINDOW_S = 3600.0


class AlarmSnapshot(Struct, frozen=True, kw_only=True):
    """The memory of an alarm, or of the gate of another rule; or a figure, called ``figures.NAME``."""

    rule: str
    meaning: str
    """Tells rules apart that do not mean the same."""
    record: AlarmRecord = field(name="state", default_factory=AlarmRecord)  # so it is called in state files
    is_first_out: bool = False
    last_raised_at_s: float | None = None
    """When it was raised last, for one that a sequence names."""
    sent_at_s: float | None = None
    """As in `stadimeter.core.rules.ramp.ReportStep`, and so is `sent`, its count."""
    sent: int = 0
    summary: Summary | None = None


class Absence(Struct, frozen=True, kw_only=True):
    """A target that is out of sight. Some conditions go by how long it has been."""

    target: str
    since_s: float


class SnapshotChange(IntEnum):
    """The extent to which a cycle has changed what alarms remember, least first."""

    NOTHING = 0
    """Nothing, or no more than a timer that runs."""
    PASSING = 1
    """Something that noise may change several times a second: a timer began, a target went out of sight."""
    LASTING = 2
    """Something that people were notified of, or have commanded."""


def meaning_of(rule: AnyRule | RememberedFigure) -> str:
    """Return a digest that tells rules apart that do not mean the same, in 64 hexadecimal digits.

    What is as it is by default does not count, so a later version with more to configure finds the same meaning.
    """
    return hashlib.sha256(_canonical(rule).encode()).hexdigest()


def _canonical(value: object) -> str:
    if isinstance(value, Struct):
        written = (
            f"{each.name}={_canonical(getattr(value, each.name))}" for each in fields(value) if _is_set(value, each)
        )
        return f"{type(value).__name__}({', '.join(written)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_canonical, value))})"
    return repr(value.value) if isinstance(value, Enum) else repr(value)


def _is_set(value: object, field: Any) -> bool:
    """Check whether a field is not as it is by default."""
    default = field.default_factory() if field.default_factory is not NODEFAULT else field.default
    if isinstance(value, GatedRule) and field.name == "gate":
        default = value.owning(default)
    return bool(getattr(value, field.name) != default)


def snapshot_alarms(state: State) -> tuple[AlarmSnapshot, ...]:
    """Return a snapshot of the alarms of a run, in the order of the configuration, and of what else is remembered."""
    found = [
        AlarmSnapshot(
            rule=rule.name,
            meaning=meaning_of(rule),
            record=step.record,
            is_first_out=step.trace.first_out,
            last_raised_at_s=state.rules.raised_at_s.get(rule.name),
            sent_at_s=step.sent_at_s if isinstance(step, ReportStep) else None,
            sent=step.count if isinstance(step, ReportStep) else 0,
        )
        for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)
        if isinstance(step, OperatedStep)
    ]
    figures = zip(state.plan.figures, state.figures, strict=True)
    kept = [
        AlarmSnapshot(rule=_OF_FIGURES + it.name, meaning=meaning_of(it), summary=summary) for it, summary in figures
    ]
    ends = (each for ending in state.rules.layout.sequences.values() for each in ending)
    complete = [
        AlarmSnapshot(rule=_OF_SEQUENCES + each.key, meaning="", last_raised_at_s=at_s)
        for each in dict.fromkeys(ends)
        if (at_s := state.rules.raised_at_s.get(each.key)) is not None
    ]
    return (*found, *kept, *complete)


def find_absences(state: State) -> tuple[Absence, ...]:
    """Return which targets are out of sight."""
    tracks = [each.track for each in state.tracks]
    return tuple(
        Absence(target=track.target, since_s=track.since_s)
        for track in tracks
        if track.since_s is not None and not track.is_valid
    )


def classify_change(before: State, after: State) -> SnapshotChange:
    """Return the greatest change of what alarms remember that a cycle has made, by the same rules."""
    if before.stopped != after.stopped:
        return SnapshotChange.LASTING
    found = SnapshotChange.PASSING if _begins_an_absence(before, after) else SnapshotChange.NOTHING
    if any(_has_new_slot(*each) for each in zip(after.plan.figures, before.figures, after.figures, strict=True)):
        found = SnapshotChange.PASSING
    if before.rules.steps is after.rules.steps:
        return found
    for last, step in zip(before.rules.steps, after.rules.steps, strict=True):
        if step is not last and isinstance(step, OperatedStep) and isinstance(last, OperatedStep):
            found = max(found, _change(last.record, step.record))
        if isinstance(step, ReportStep) and isinstance(last, ReportStep) and step.sent_at_s != last.sent_at_s:
            found = max(found, SnapshotChange.PASSING)
    return found


def _has_new_slot(figure: RememberedFigure, before: Summary, after: Summary) -> bool:
    return figure.window.for_s >= _LONG_WINDOW_S and after.newest_from_s != before.newest_from_s


def _begins_an_absence(before: State, after: State) -> bool:
    """Check whether a target went out of sight that a rule counts the time of."""
    gone = any(
        last.track.is_valid and not now.track.is_valid for last, now in zip(before.tracks, after.tracks, strict=True)
    )
    return gone and any(
        isinstance(leaf, PresenceCondition) and leaf.for_s > 0
        for rule in after.plan.rules
        for condition in conditions_of(rule)
        for leaf in leaves(condition)
    )


def _change(before: AlarmRecord, after: AlarmRecord) -> SnapshotChange:
    if before is after:
        return SnapshotChange.NOTHING
    lasting = _SHORTLY.get(before.state, before.state) is not _SHORTLY.get(after.state, after.state)
    if lasting or _lasting(before) != _lasting(after):
        return SnapshotChange.LASTING
    is_lost = (before.unknown_since_s is None) is not (after.unknown_since_s is None)
    return SnapshotChange.PASSING if is_lost or _passing(before) != _passing(after) else SnapshotChange.NOTHING


_lasting = attrgetter(
    "is_announced_only", "raises", "raised_at_s", "reported_at_s", "notified_at_s", "owes_notice", "is_chattering",
    "leg", "acknowledgement", "inhibits.shelved_until_s", "inhibits.is_one_shot", "inhibits.shelved_by",
    "inhibits.is_out_of_service", "inhibits.is_observed", "thresholds",
)  # fmt: skip

_passing = attrgetter("state", "is_given_up", "held_from_start", "inhibits.is_suppressed", "raises_at_s")


def restore_alarms(
    state: State,
    memories: Iterable[AlarmSnapshot],
    absences: Iterable[Absence] = (),
    *,
    shift_s: float,
    from_s: float,
    now_s: float,
) -> State:
    """Return the state of a run that begins, its alarms remembering what those of an earlier run did.

    Args:
        state: The state of a run that has not begun.
        memories: What the earlier alarms remembered. Of what means something else now, only thresholds that were set
            stay, as far as the configuration says the same in place of them; events report the others.
        shift_s: What to add to a time on the earlier run's clock.
        from_s: As of when they remembered it, on this run's clock.
    """
    by_rule = {memory.rule: memory for memory in memories}
    steps, first_out, raised_at_s = list(state.rules.steps), {}, {}
    due = state.due
    for index, rule in enumerate(state.plan.rules):
        memory = by_rule.get(rule.name)
        step = steps[index]
        if memory is None or not isinstance(step, OperatedStep):
            continue
        if memory.meaning != meaning_of(rule):
            were_set = shift_times(memory.record.thresholds, shift_s)
            steps[index], events = renew(gate_of(rule), step, were_set, RuleInputs(tracks={}, now_s=now_s))
            due += events
            continue
        alarm = gate_of(rule)
        resumed = _resume(alarm, memory.record, shift_s=shift_s, from_s=from_s, now_s=now_s)
        if isinstance(step, ReportStep) and memory.sent_at_s is not None:
            step = replace(step, sent_at_s=memory.sent_at_s + shift_s, count=memory.sent)
        steps[index] = with_record(as_set(alarm, resumed), step, resumed)
        if memory.last_raised_at_s is not None:
            raised_at_s[rule.name] = memory.last_raised_at_s + shift_s
        if memory.is_first_out:
            first_out[alarm.group] = rule.name
    since_s = {absence.target: absence.since_s + shift_s for absence in absences}
    tracks = tuple(_absent_since(tracked, since_s.get(tracked.track.target)) for tracked in state.tracks)
    for row in (each for each in by_rule.values() if each.rule.startswith(_OF_SEQUENCES)):
        raised_at_s[row.rule.removeprefix(_OF_SEQUENCES)] = (row.last_raised_at_s or 0.0) + shift_s
    rules = with_steps(state.plan, tuple(steps), first_out, raised_at_s)
    figures = tuple(
        memory.summary.resume(it, shift_s, now_s)
        if (memory := by_rule.get(_OF_FIGURES + it.name)) and memory.summary and memory.meaning == meaning_of(it)
        else Summary()
        for it in state.plan.figures
    )
    return replace(state, tracks=tracks, rules=rules, due=due, figures=figures)


def _absent_since(tracked: TrackState, since_s: float | None) -> TrackState:
    return tracked if since_s is None else replace(tracked, track=replace(tracked.track, since_s=since_s))


def _resume(rule: AlarmRule, record: AlarmRecord, *, shift_s: float, from_s: float, now_s: float) -> AlarmRecord:
    """Return the memory of an alarm, as of the beginning of this run; see `restore_alarms`."""
    before = shift_times(record, shift_s)
    if before.resumed is not None:
        from_s = before.resumed.from_s
    timers = before.timers
    if before.unknown_since_s is not None:
        from_s = math.inf  # time out of sight counts for no timer
        if now_s - before.unknown_since_s >= rule.lost.grace_s:
            timers = Timers(leaves=timers.leaves)
    return replace(before, timers=timers, resumed=Resumed(from_s=from_s, at_s=now_s))


def shift_times(value: _T, shift_s: float) -> _T:
    """Return a remembered value, a struct with others in it or several, with every time shifted to another clock."""
    if type(value) is tuple:
        return cast("_T", tuple([shift_times(each, shift_s) for each in cast("tuple[Any, ...]", value)]))
    if not isinstance(value, Struct) or shift_s == 0:
        return value
    moved = {field.name: _shifted(field.name, getattr(value, field.name), shift_s) for field in fields(value)}
    return replace(value, **moved)


def _shifted(name: str, value: Any, shift_s: float) -> Any:
    if not _TIME.fullmatch(name) or value is None:
        return shift_times(value, shift_s)
    return tuple([at_s + shift_s for at_s in value]) if isinstance(value, tuple) else value + shift_s
