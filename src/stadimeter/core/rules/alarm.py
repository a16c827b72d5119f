"""The life of an alarm: a condition, delays, and what happens without a target.

::

    idle ──holds──▶ pending ──for the on-delay──▶ active ──ended──▶ clearing ──for the off-delay──▶ idle
                       └──holds no longer──▶ idle    ▲──holds again────┘

Timers run on the capture times of the frames that were judged, so a recording gives the same alarms. A frame to the
contrary sets a timer back by its own time instead of to zero: under noise a timer that restarts may never end. While
the target is out of sight nothing is judged: the alarm stays as it was and timers stand still, for the grace; then
the rule's policy says what happens. When the target comes back, it is compared with what the alarm was, so coming back
raises nothing by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stadimeter.core.decision import Event, EventKind, RuleStatus, Severity
from stadimeter.core.plan import AlarmRule, DistanceCondition, LostPolicy
from stadimeter.core.rules import conditions
from stadimeter.core.rules.request import LevelRequest, Request, TwistRequest
from stadimeter.core.rules.step import Step, trace_of
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What is judged in a cycle.

    Attributes:
        at_s: The capture time of the frame that is new; for the presence of a target, the time of the cycle.
        since_s: How long after the frame before, or the cycle before, that is; 0 for the first.
    """

    at_s: float
    since_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmState:
    """What an alarm remembers.

    Attributes:
        is_active: Whether it is raised.
        held_s: For how long its condition has held, on its way to being raised.
        held_last: Whether it held in the newest sample; only the time between two samples that both held counts.
        recent: Whether it held in each of the newest frames, oldest first.
        ended_s: For how long its condition has not held, on its way to being cleared.
        was_judged: Whether the newest sample was judged; only the time between two samples that both were counts.
        unknown_since_s: Since when there is nothing to judge by; None while there is.
        is_given_up: Whether the target has been away for so long that the output went to its safe value.
        held_from_start: Whether the condition has held in every sample of the run so far.
        is_announced_only: Whether it was raised by the first sight of the target, and shall not move its output.
    """

    is_active: bool = False
    held_s: float = 0.0
    held_last: bool = False
    recent: tuple[bool, ...] = ()
    ended_s: float = 0.0
    was_judged: bool = False
    unknown_since_s: float | None = None
    is_given_up: bool = False
    held_from_start: bool = True
    is_announced_only: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmStep(Step):
    """What an alarm does in one cycle.

    Attributes:
        state: What it remembers.
    """

    state: AlarmState = field(default_factory=AlarmState)


def new_alarm(rule: AlarmRule) -> AlarmStep:
    """Return an alarm at the start of a run.

    Args:
        rule: The alarm.

    Returns:
        Its step before the first cycle.
    """
    return AlarmStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_alarm(
    rule: AlarmRule, before: AlarmStep, track: Track, sample: Sample | None, now_s: float, *, is_base: bool
) -> tuple[AlarmStep, tuple[Event, ...]]:
    """Judge an alarm for one cycle.

    Args:
        rule: The alarm.
        before: Its step in the cycle before.
        track: Its target.
        sample: The frame that is new in this cycle; None without one.
        now_s: The run's monotonic clock.
        is_base: Whether its output is a base, which it then stops.

    Returns:
        What it does, and what happened.
    """
    holds = conditions.holds(rule.condition, track, is_active=before.state.is_active)
    if holds is None:
        state, events = _without_target(rule, before.state, track, now_s)
    else:
        state, events = _back_in_sight(rule, before.state, track, now_s)
        if sample is not None and not _is_settled(state, holds=holds):
            state, more = _judged(rule, state, track, sample, holds=holds)
            events += more
    status = _status(state, holds=holds)
    rests = _rests(rule, state, track, holds=holds)
    if state is before.state and status is before.trace.status and rests is before.rests:
        return before, events
    trace = trace_of(rule, status, before.trace)
    request = _request(rule, state, before.request, is_base=is_base)
    return AlarmStep(trace=trace, request=request, state=state, rests=rests), events


def why(rule: AlarmRule, state: AlarmState, track: Track, now_s: float) -> str:
    """Return why an alarm does what it does, in words with figures.

    Args:
        rule: The alarm.
        state: What it remembers after the cycle.
        track: Its target.
        now_s: The run's monotonic clock.

    Returns:
        The words.
    """
    words = conditions.in_words(rule.condition, track, is_active=state.is_active)
    if state.unknown_since_s is None:
        return words
    held = "held: " if state.is_active and not state.is_given_up else ""
    return f"{held}not seen for {now_s - state.unknown_since_s:.1f} s: {words}"


def _is_settled(state: AlarmState, *, holds: bool | None) -> bool:
    """Return whether a sample changes nothing: it is like the one before, and no timer runs."""
    if not state.was_judged or holds is not state.held_last or holds is not state.is_active:
        return False
    return state.ended_s == 0.0 if holds else state.held_s == 0.0 and not any(state.recent)


def _rests(rule: AlarmRule, state: AlarmState, track: Track, *, holds: bool | None) -> bool:
    """Return whether nothing changes until the distance crosses a limit, or the target comes or goes."""
    condition = rule.condition
    if not isinstance(condition, DistanceCondition):
        return False
    if holds is None:
        is_silent = not state.is_active and rule.lost.policy is not LostPolicy.ASSERT
        return (is_silent and not _has_timers(state)) or (state.is_given_up and rule.lost.policy is LostPolicy.HOLD)
    figures = conditions.quantity_of(track, condition.quantity)
    if figures is None or not _is_settled(state, holds=holds):
        return False
    return conditions.rests(condition, figures[0], is_active=state.is_active)


def _judged(
    rule: AlarmRule, state: AlarmState, track: Track, sample: Sample, *, holds: bool
) -> tuple[AlarmState, tuple[Event, ...]]:
    """Take in one sample for which the condition is known."""
    since_s = sample.since_s if state.was_judged else 0.0
    from_start = state.held_from_start and holds
    if state.is_active:
        ended_s = max(0.0, state.ended_s - since_s) if holds else state.ended_s + since_s
        state = replace(state, was_judged=True, held_last=holds, held_from_start=from_start, ended_s=ended_s)
        if holds or ended_s < rule.off_delay_s:
            return state, ()
        return _cleared(rule, state, track, sample.at_s)
    delay = rule.on_delay
    held_s = state.held_s + since_s * state.held_last if holds else max(0.0, state.held_s - since_s)
    recent = (*state.recent, holds)[-delay.of_frames :] if delay.of_frames else ()
    state = replace(state, was_judged=True, held_last=holds, held_from_start=from_start, held_s=held_s, recent=recent)
    if not holds or held_s < delay.hold_s or sum(recent) < delay.frames:
        return state, ()
    return _raised(rule, state, track, sample.at_s)


def _raised(
    rule: AlarmRule, state: AlarmState, track: Track, at_s: float, reason: str = ""
) -> tuple[AlarmState, tuple[Event, ...]]:
    reason = reason or conditions.in_words(rule.condition, track, is_active=False)
    if state.held_from_start:
        reason = f"so from the start: {reason}"
    state = replace(
        state,
        is_active=True,
        ended_s=0.0,
        held_s=0.0,
        recent=(),
        is_announced_only=state.held_from_start and not rule.act_at_start,
    )
    return state, (_event(rule, EventKind.RAISED, track, at_s, reason),)


def _cleared(
    rule: AlarmRule, state: AlarmState, track: Track, at_s: float, reason: str = ""
) -> tuple[AlarmState, tuple[Event, ...]]:
    reason = reason or conditions.in_words(rule.condition, track, is_active=True)
    state = replace(state, is_active=False, ended_s=0.0, held_s=0.0, recent=(), is_announced_only=False)
    return state, (_event(rule, EventKind.CLEARED, track, at_s, reason),)


def _without_target(
    rule: AlarmRule, state: AlarmState, track: Track, now_s: float
) -> tuple[AlarmState, tuple[Event, ...]]:
    """There is nothing to judge by: hold for the grace, then do as the policy says."""
    if state.unknown_since_s is None:
        state = replace(state, unknown_since_s=now_s)
    away_s = now_s - (state.unknown_since_s or 0.0)
    policy = rule.lost.policy
    if away_s < rule.lost.grace_s:
        return _give_up_if_late(rule, state, track, now_s)
    state = _without_timers(state)
    if policy is LostPolicy.HOLD:
        return _give_up_if_late(rule, state, track, now_s)
    words = conditions.in_words(rule.condition, track, is_active=state.is_active)
    reason = f"not seen for {away_s:.1f} s: {words}"
    if policy is LostPolicy.CLEAR and state.is_active:
        return _cleared(rule, state, track, now_s, reason)
    if policy is LostPolicy.ASSERT and not state.is_active:
        return _raised(rule, replace(state, held_from_start=False), track, now_s, reason)
    if policy is LostPolicy.ASSERT and state.is_announced_only:  # not seeing is a danger of its own: it acts
        state = replace(state, is_announced_only=False)
    return state, ()


def _has_timers(state: AlarmState) -> bool:
    return bool(state.held_s or state.ended_s or state.recent or state.held_last)


def _without_timers(state: AlarmState) -> AlarmState:
    """After the grace, what was counted before is too old to count on."""
    if not _has_timers(state):
        return state
    return replace(state, held_s=0.0, ended_s=0.0, recent=(), held_last=False)


def _give_up_if_late(
    rule: AlarmRule, state: AlarmState, track: Track, now_s: float
) -> tuple[AlarmState, tuple[Event, ...]]:
    """Stop acting on an alarm that nothing can confirm any more. An alarm that is not raised has nothing to give up."""
    away_s = now_s - (state.unknown_since_s or 0.0)
    if state.is_given_up or not state.is_active or away_s < rule.lost.fault_after_s:
        return state, ()
    reason = f"active, but its target was not seen for {away_s:.1f} s; the output goes to its safe value"
    return replace(state, is_given_up=True), (_event(rule, EventKind.MEASUREMENT_LOST, track, now_s, reason),)


def _back_in_sight(
    rule: AlarmRule, state: AlarmState, track: Track, now_s: float
) -> tuple[AlarmState, tuple[Event, ...]]:
    if state.unknown_since_s is None:
        return state, ()
    # The time out of sight counts for no timer, so the next sample starts counting anew.
    back = replace(state, unknown_since_s=None, is_given_up=False, was_judged=False)
    if not state.is_given_up:
        return back, ()
    reason = f"its target was seen again after {now_s - state.unknown_since_s:.1f} s"
    return back, (_event(rule, EventKind.MEASUREMENT_BACK, track, now_s, reason),)


def _request(rule: AlarmRule, state: AlarmState, before: Request | None, *, is_base: bool) -> Request | None:
    if rule.output is None or not state.is_active or state.is_given_up or state.is_announced_only:
        return None
    if before is not None:  # an alarm always asks for the same
        return before
    if is_base:
        return TwistRequest(
            rule=rule.name, output=rule.output, priority=rule.priority, linear_mps=0.0, angular_radps=0.0
        )
    return LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=rule.level)


def _status(state: AlarmState, *, holds: bool | None) -> RuleStatus:
    if holds is None:
        return RuleStatus.ACTIVE if state.is_active and not state.is_given_up else RuleStatus.UNKNOWN
    if state.is_active:
        return RuleStatus.ACTIVE if holds else RuleStatus.CLEARING
    return RuleStatus.PENDING if holds else RuleStatus.IDLE


def _event(rule: AlarmRule, kind: EventKind, track: Track, at_s: float, reason: str) -> Event:
    severity = Severity.INFO if kind is EventKind.MEASUREMENT_BACK else rule.severity
    return Event(
        kind=kind,
        source=rule.name,
        at_s=at_s,
        severity=severity,
        reason=reason,
        distance_m=track.distance_m if track.is_valid else None,
        sigma_m=track.sigma_m if track.is_valid else None,
    )
