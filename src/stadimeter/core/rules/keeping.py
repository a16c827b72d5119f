"""What alarms remember, beyond the end of a run and beyond a change of their configuration.

An alarm keeps its memory as long as its rule means the same. A rule that was changed in any way is another rule.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from enum import Enum, IntEnum
from typing import Any, TypeVar

from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.alarms.state import AlarmState, Resumed, Timers
from stadimeter.core.alarms.table import Phase
from stadimeter.core.alarms.words import dismissed
from stadimeter.core.condition import PresenceCondition, leaves
from stadimeter.core.conditions.known import Known
from stadimeter.core.decide import State
from stadimeter.core.decision import Event, RuleStatus
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.rule_step import trace_of
from stadimeter.core.rules.judging import RuleStep, not_judged_yet, with_steps
from stadimeter.core.tracking.life_cycle import TrackState

REMOVED = "removed from the configuration"
CHANGED = "its rule was changed in the configuration"

_T = TypeVar("_T")

_TIME = re.compile(r"(?:.*_)?(?:at|until|since|from|began)_s")
"""How the names of times on the run's clock end. What ends otherwise is a duration, or no time at all."""

_SHORTLY = {
    Phase.PENDING: Phase.INACTIVE,
    Phase.CLEARING: Phase.ACTIVE,
    Phase.CLEARING_UNACKNOWLEDGED: Phase.UNACKNOWLEDGED,
}
"""Phases that noise leads into and out of, and what an alarm is apart from that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptAlarm:
    """What an alarm remembers.

    Attributes:
        rule: The rule's name.
        meaning: Tells rules apart that do not mean the same.
        state: What it remembers.
        is_first_out: Whether it is the first alarm of its group.
    """

    rule: str
    meaning: str
    state: AlarmState
    is_first_out: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Absence:
    """A target that is out of sight. Some conditions go by how long it has been.

    Attributes:
        target: The target.
        since_s: Since when, on the run's clock.
    """

    target: str
    since_s: float


class Turn(IntEnum):
    """How much a cycle has changed of what alarms remember, least first."""

    NOTHING = 0
    """Nothing, or no more than a timer that runs."""
    PASSING = 1
    """Something that noise may change several times a second: a timer began, a target went out of sight."""
    LASTING = 2
    """Something that people were told of, or have said."""


def meaning_of(rule: AnyRule) -> str:
    """Return what tells rules apart that do not mean the same.

    What is as it is by default does not count, so a later version with more to configure finds the same meaning.

    Args:
        rule: The rule.

    Returns:
        64 hexadecimal digits.
    """
    return hashlib.sha256(_canonical(rule).encode()).hexdigest()


def _canonical(value: object) -> str:
    if is_dataclass(value):
        told = (
            f"{field.name}={_canonical(getattr(value, field.name))}" for field in fields(value) if _told(value, field)
        )
        return f"{type(value).__name__}({', '.join(told)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_canonical, value))})"
    return repr(value.value) if isinstance(value, Enum) else repr(value)


def _told(value: object, field: Any) -> bool:
    """Return whether a field says something: whether it is not as it is by default."""
    default = field.default_factory() if field.default_factory is not MISSING else field.default
    return bool(getattr(value, field.name) != default)


def kept(state: State) -> tuple[KeptAlarm, ...]:
    """Return what the alarms of a run remember.

    Args:
        state: What the run remembers.

    Returns:
        One for each alarm, in the order of the configuration.
    """
    return tuple(
        KeptAlarm(rule=rule.name, meaning=meaning_of(rule), state=step.state, is_first_out=step.trace.first_out)
        for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)
        if isinstance(step, AlarmStep)
    )


def absent(state: State) -> tuple[Absence, ...]:
    """Return which targets are out of sight.

    Args:
        state: What the run remembers.

    Returns:
        One for each of them.
    """
    tracks = [each.track for each in state.tracks]
    return tuple(
        Absence(target=track.target, since_s=track.since_s)
        for track in tracks
        if track.since_s is not None and not track.is_valid
    )


def turn(before: State, after: State) -> Turn:
    """Return how much a cycle has changed of what alarms remember.

    Args:
        before: What was remembered before it.
        after: What was remembered after it, by the same rules.

    Returns:
        The greatest of the changes.
    """
    found = Turn.PASSING if _begins_an_absence(before, after) else Turn.NOTHING
    if before.rules.steps is after.rules.steps:
        return found
    for last, step in zip(before.rules.steps, after.rules.steps, strict=True):
        if step is not last and isinstance(step, AlarmStep) and isinstance(last, AlarmStep):
            found = max(found, _turn(last.state, step.state))
    return found


def _begins_an_absence(before: State, after: State) -> bool:
    """Return whether a target went out of sight that a rule counts the time of."""
    gone = any(
        last.track.is_valid and not now.track.is_valid for last, now in zip(before.tracks, after.tracks, strict=True)
    )
    return gone and any(
        isinstance(leaf, PresenceCondition) and leaf.for_s > 0
        for rule in after.plan.rules
        if isinstance(rule, AlarmRule)
        for leaf in leaves(rule.condition)
    )


def _turn(before: AlarmState, after: AlarmState) -> Turn:
    if before is after:
        return Turn.NOTHING
    if _lasting(before) != _lasting(after):
        return Turn.LASTING
    return Turn.PASSING if _passing(before) != _passing(after) else Turn.NOTHING


def _lasting(state: AlarmState) -> tuple[object, ...]:
    gates = state.gates
    return (
        _SHORTLY.get(state.phase, state.phase),
        state.is_announced_only,
        state.raised_at_s,
        state.reported_at_s,
        state.notified_at_s,
        state.owes_notice,
        state.leg,
        gates.shelved_until_s,
        gates.is_one_shot,
        gates.shelved_by,
        gates.is_out_of_service,
    )


def _passing(state: AlarmState) -> tuple[object, ...]:
    is_unknown = state.unknown_since_s is None
    return state.phase, is_unknown, state.is_given_up, state.held_from_start, state.gates.is_suppressed


def restored(
    state: State,
    memories: Iterable[KeptAlarm],
    absences: Iterable[Absence] = (),
    *,
    shift_s: float,
    from_s: float,
    now_s: float,
) -> State:
    """Let the alarms of a run that begins remember what those of an earlier run did.

    Args:
        state: The state of a run that has not begun.
        memories: What the earlier alarms remembered. What means something else now is passed over.
        absences: The targets that were out of sight.
        shift_s: What to add to a time on the earlier run's clock.
        from_s: As of when they remembered it, on this run's clock.
        now_s: This run's clock.

    Returns:
        The state with which to begin.
    """
    by_rule = {memory.rule: memory for memory in memories}
    moved = _Move(shift_s=shift_s, from_s=from_s, now_s=now_s)
    steps, first_out = list(state.rules.steps), {}
    for index, rule in enumerate(state.plan.rules):
        memory = by_rule.get(rule.name)
        if memory is None or not isinstance(rule, AlarmRule) or memory.meaning != meaning_of(rule):
            continue
        steps[index] = _step(rule, moved.of(rule, memory.state))
        if memory.is_first_out:
            first_out[rule.group] = rule.name
    since_s = {absence.target: absence.since_s + shift_s for absence in absences}
    tracks = tuple(_absent_since(tracked, since_s.get(tracked.track.target)) for tracked in state.tracks)
    return replace(state, tracks=tracks, rules=with_steps(state.plan, tuple(steps), first_out))


def _absent_since(tracked: TrackState, since_s: float | None) -> TrackState:
    return tracked if since_s is None else replace(tracked, track=replace(tracked.track, since_s=since_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Move:
    """From an earlier run to this one."""

    shift_s: float
    from_s: float
    now_s: float

    def of(self, rule: AlarmRule, state: AlarmState) -> AlarmState:
        """Return what an alarm remembers, as of the beginning of this run."""
        before = shifted(state, self.shift_s)
        from_s = before.resumed.from_s if before.resumed is not None else self.from_s
        timers = before.timers
        if before.unknown_since_s is not None:
            from_s = math.inf  # time out of sight counts for no timer
            if self.now_s - before.unknown_since_s >= rule.lost.grace_s:
                timers = Timers(leaves=timers.leaves)
        return replace(before, timers=timers, resumed=Resumed(from_s=from_s, at_s=self.now_s))


def _step(rule: AlarmRule, state: AlarmState) -> AlarmStep:
    gates = state.gates.words()
    trace = trace_of(rule, RuleStatus.UNKNOWN, acknowledged=state.is_acknowledged, gates=gates)
    return AlarmStep(trace=trace, state=state)


def shifted(value: _T, shift_s: float) -> _T:
    """Return what was remembered, with its times on another clock.

    Args:
        value: What was remembered: a dataclass, with others in it.
        shift_s: What to add to a time.

    Returns:
        The same, with every time shifted.
    """
    if not is_dataclass(value) or isinstance(value, type) or shift_s == 0:
        return value
    moved = {field.name: _shifted(field.name, getattr(value, field.name), shift_s) for field in fields(value)}
    return replace(value, **moved)


def _shifted(name: str, value: Any, shift_s: float) -> Any:
    if isinstance(value, float | int) and not isinstance(value, bool) and _TIME.fullmatch(name):
        return value + shift_s
    return shifted(value, shift_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TakenOver:
    """A state that goes on with other rules.

    Attributes:
        state: What is remembered now.
        kept: The rules that mean the same as before.
        changed: Those that mean something else now. They begin anew.
        added: Those that were not there before.
        removed: Those that are not there any more.
    """

    state: State
    kept: tuple[str, ...]
    changed: tuple[str, ...]
    added: tuple[str, ...]
    removed: tuple[str, ...]


def carried_over(state: State, plan: Plan) -> TakenOver:
    """Let a run go on with other rules, between two cycles.

    Rules that mean the same go on as if nothing had happened. An alarm whose rule is removed or changed, and that was
    active, clears; the next decision tells so. What it wanted of outputs is not wanted any more.

    Args:
        state: What the run remembers.
        plan: The new rules, with the targets and outputs of the old.

    Returns:
        What it remembers now, and what became of which rule.
    """
    old = {rule.name: (rule, step) for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)}
    is_kept = {rule.name: rule == old[rule.name][0] for rule in plan.rules if rule.name in old}
    steps = tuple(
        old[rule.name][1] if is_kept.get(rule.name) else new
        for rule, new in zip(plan.rules, not_judged_yet(plan).steps, strict=True)
    )
    first_out = {group: name for group, name in state.rules.first_out.items() if is_kept.get(name)}
    removed = tuple(name for name in old if name not in is_kept)
    gone = dict.fromkeys(removed, REMOVED) | {name: CHANGED for name, same in is_kept.items() if not same}
    return TakenOver(
        state=replace(
            state,
            plan=plan,
            rules=with_steps(plan, steps, first_out),
            due=state.due + _cleared(state, old, gone),
        ),
        kept=tuple(name for name, same in is_kept.items() if same),
        changed=tuple(name for name, same in is_kept.items() if not same),
        added=tuple(rule.name for rule in plan.rules if rule.name not in old),
        removed=removed,
    )


def _cleared(state: State, old: Mapping[str, tuple[AnyRule, RuleStep]], gone: Mapping[str, str]) -> tuple[Event, ...]:
    known = Known(tracks={each.track.target: each.track for each in state.tracks}, now_s=state.now_s or 0.0)
    events: tuple[Event, ...] = ()
    for name, (rule, step) in old.items():
        if name in gone and isinstance(rule, AlarmRule) and isinstance(step, AlarmStep):
            events += dismissed(rule, step.state, known, gone[name])
    return events
