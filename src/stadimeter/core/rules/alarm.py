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

from dataclasses import dataclass, replace

from stadimeter.core.decision import Event, EventKind, RuleStatus, RuleTrace, Severity
from stadimeter.core.plan import AlarmRule, LostPolicy
from stadimeter.core.rules.conditions import Verdict, judge
from stadimeter.core.rules.request import LevelRequest, Request, TwistRequest
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmState:
    """What an alarm remembers.

    Attributes:
        is_active: Whether it is raised.
        held_s: For how long its condition has held, on its way to being raised.
        held_last: Whether it held in the newest sample; only the time between two samples that both held counts.
        recent: Whether it held in each of the newest frames, oldest first.
        ended_s: For how long its condition has not held, on its way to being cleared.
        judged_at_s: The time of the newest sample that was judged.
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
    judged_at_s: float | None = None
    unknown_since_s: float | None = None
    is_given_up: bool = False
    held_from_start: bool = True
    is_announced_only: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmStep:
    """What an alarm does in one cycle.

    Attributes:
        state: What it remembers from now on.
        events: What happened.
        request: What it wants of its output, None if nothing.
        trace: What it is doing, and why.
    """

    state: AlarmState
    events: tuple[Event, ...]
    request: Request | None
    trace: RuleTrace


def step_alarm(
    rule: AlarmRule, state: AlarmState, track: Track, sample_at_s: float | None, now_s: float, *, is_base: bool
) -> AlarmStep:
    """Judge an alarm for one cycle.

    Args:
        rule: The alarm.
        state: What it remembers.
        track: Its target.
        sample_at_s: Capture time of the frame that is new in this cycle; None without one.
        now_s: The run's monotonic clock.
        is_base: Whether its output is a base, which it then stops.

    Returns:
        What it does.
    """
    verdict = judge(rule.condition, track, is_active=state.is_active)
    if verdict.holds is None:
        after, events = _without_target(rule, state, track, now_s, verdict)
    else:
        after, events = _back_in_sight(rule, state, track, now_s)
        if sample_at_s is not None:
            after, more = _judged(rule, after, track, sample_at_s, verdict)
            events += more
    return AlarmStep(
        state=after,
        events=events,
        request=_request(rule, after, verdict.reason, is_base=is_base),
        trace=RuleTrace(
            rule=rule.name, status=_status(after, verdict), reason=_reason(after, verdict, now_s), output=rule.output
        ),
    )


def _judged(
    rule: AlarmRule, state: AlarmState, track: Track, at_s: float, verdict: Verdict
) -> tuple[AlarmState, tuple[Event, ...]]:
    """Take in one sample for which the condition is known."""
    since_s = max(0.0, at_s - state.judged_at_s) if state.judged_at_s is not None else 0.0
    holds = bool(verdict.holds)
    held_before = state.held_last
    state = replace(state, judged_at_s=at_s, held_last=holds, held_from_start=state.held_from_start and holds)
    if state.is_active:
        return _while_active(rule, state, track, since_s, verdict)
    delay = rule.on_delay
    held_s = state.held_s + since_s * held_before if holds else max(0.0, state.held_s - since_s)
    recent = (*state.recent, holds)[-delay.of_frames :] if delay.of_frames else ()
    state = replace(state, held_s=held_s, recent=recent)
    if not holds or held_s < delay.hold_s or sum(recent) < delay.frames:
        return state, ()
    return _raised(rule, state, track, verdict.reason)


def _while_active(
    rule: AlarmRule, state: AlarmState, track: Track, since_s: float, verdict: Verdict
) -> tuple[AlarmState, tuple[Event, ...]]:
    if verdict.holds:
        return replace(state, ended_s=max(0.0, state.ended_s - since_s)), ()
    ended_s = state.ended_s + since_s
    if ended_s < rule.off_delay_s:
        return replace(state, ended_s=ended_s), ()
    return _cleared(rule, state, track, verdict.reason)


def _raised(rule: AlarmRule, state: AlarmState, track: Track, reason: str) -> tuple[AlarmState, tuple[Event, ...]]:
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
    return state, (_event(rule, EventKind.RAISED, track, state.judged_at_s or 0.0, reason),)


def _cleared(rule: AlarmRule, state: AlarmState, track: Track, reason: str) -> tuple[AlarmState, tuple[Event, ...]]:
    at_s = state.judged_at_s or 0.0
    state = replace(state, is_active=False, ended_s=0.0, held_s=0.0, recent=(), is_announced_only=False)
    return state, (_event(rule, EventKind.CLEARED, track, at_s, reason),)


def _without_target(
    rule: AlarmRule, state: AlarmState, track: Track, now_s: float, verdict: Verdict
) -> tuple[AlarmState, tuple[Event, ...]]:
    """There is nothing to judge by: hold for the grace, then do as the policy says."""
    since_s = now_s if state.unknown_since_s is None else state.unknown_since_s
    state = replace(state, unknown_since_s=since_s)
    away_s = now_s - since_s
    policy = rule.lost.policy
    if away_s < rule.lost.grace_s or policy is LostPolicy.HOLD:
        return _give_up_if_late(rule, state, track, now_s)
    reason = f"not seen for {away_s:.1f} s: {verdict.reason}"
    state = replace(state, judged_at_s=now_s)
    if policy is LostPolicy.CLEAR and state.is_active:
        return _cleared(rule, state, track, reason)
    if policy is LostPolicy.ASSERT and not state.is_active:
        return _raised(rule, replace(state, held_from_start=False), track, reason)
    return state, ()


def _give_up_if_late(
    rule: AlarmRule, state: AlarmState, track: Track, now_s: float
) -> tuple[AlarmState, tuple[Event, ...]]:
    """Stop acting on an alarm that nothing can confirm any more. An alarm that is not raised has nothing to give up."""
    away_s = now_s - (state.unknown_since_s or now_s)
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
    back = replace(state, unknown_since_s=None, is_given_up=False, judged_at_s=None)
    if not state.is_given_up:
        return back, ()
    reason = f"its target was seen again after {now_s - state.unknown_since_s:.1f} s"
    return back, (_event(rule, EventKind.MEASUREMENT_BACK, track, now_s, reason),)


def _request(rule: AlarmRule, state: AlarmState, reason: str, *, is_base: bool) -> Request | None:
    if rule.output is None or not state.is_active or state.is_given_up or state.is_announced_only:
        return None
    if is_base:
        return TwistRequest(
            rule=rule.name,
            output=rule.output,
            priority=rule.priority,
            linear_mps=0.0,
            angular_radps=0.0,
            reason=f"stop: {reason}",
        )
    return LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=rule.level, reason=reason)


def _status(state: AlarmState, verdict: Verdict) -> RuleStatus:
    if verdict.holds is None:
        return RuleStatus.ACTIVE if state.is_active and not state.is_given_up else RuleStatus.UNKNOWN
    if state.is_active:
        return RuleStatus.ACTIVE if verdict.holds else RuleStatus.CLEARING
    return RuleStatus.PENDING if verdict.holds else RuleStatus.IDLE


def _reason(state: AlarmState, verdict: Verdict, now_s: float) -> str:
    if state.unknown_since_s is None:
        return verdict.reason
    held = "held: " if state.is_active and not state.is_given_up else ""
    return f"{held}not seen for {now_s - state.unknown_since_s:.1f} s: {verdict.reason}"


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
