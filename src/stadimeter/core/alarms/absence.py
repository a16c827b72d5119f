"""What an alarm does while there is nothing to judge it by.

It stays as it was and its timers stand still, for the grace; then the rule's policy says what happens. When there is
something to judge by again, it is compared with what the alarm was, so coming back raises nothing by itself.
"""

from __future__ import annotations

from dataclasses import replace

from stadimeter.core.alarms.state import Timers
from stadimeter.core.alarms.table import LATCHED, Trigger
from stadimeter.core.alarms.timing import clear_alarm, has_timers, raise_alarm
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.alarms.words import JUDGED_BY_ITS_END, in_words, missing_in_words
from stadimeter.core.condition import CountCondition, PresenceCondition, leaves
from stadimeter.core.conditions.known import Known
from stadimeter.core.decision import EventKind, Severity
from stadimeter.core.rule import AlarmRule, LostPolicy
from stadimeter.core.track import TrackStatus

RESUME_S = 10.0
"""A run that goes on from an earlier one takes this long at most to see its targets: until then they are not lost."""


def is_awaited(rule: AlarmRule, known: Known, resumed_at_s: float) -> bool:
    """Return whether nothing has been seen yet after a restart, so that it would be a guess that a target is lost.

    A rule for safety does not wait: to it, not seeing counts at once.

    Args:
        rule: The alarm.
        known: All that it can be judged by.
        resumed_at_s: When this run took it over from an earlier one.

    Returns:
        Whether to wait.
    """
    if known.now_s - resumed_at_s >= RESUME_S or rule.severity is Severity.SAFETY:
        return False
    if not any(isinstance(leaf, PresenceCondition | CountCondition) for leaf in leaves(rule.condition)):
        return False
    return all(track.status is TrackStatus.SEARCHING for track in known.tracks.values())


def without_target(turn: AlarmTurn) -> None:
    """Hold for the grace, then do as the policy says.

    Args:
        turn: The alarm, with nothing to judge it by.
    """
    now_s, lost, resumed = turn.known.now_s, turn.rule.lost, turn.state.resumed
    if resumed is not None:
        if now_s - resumed.at_s < RESUME_S:
            return
        turn.change(resumed=None)
    if turn.state.unknown_since_s is None:
        turn.change(unknown_since_s=now_s)
    away_s = now_s - (turn.state.unknown_since_s or 0.0)
    if away_s >= lost.grace_s:
        _forget_timers(turn)
        if lost.policy is not LostPolicy.HOLD:
            _follow_policy(turn, away_s)
            return
    remind_of_loss = turn.state.is_active and not turn.state.is_given_up and away_s >= lost.fault_after_s
    if remind_of_loss:
        missing = missing_in_words(turn.rule, turn.known)
        reason = f"active, but {missing} for {away_s:.1f} s; the output goes to its safe value"
        turn.change(is_given_up=True)
        turn.tell(EventKind.MEASUREMENT_LOST, now_s, reason, notify=not turn.is_quiet)


def _follow_policy(turn: AlarmTurn, away_s: float) -> None:
    """After the grace: not seeing counts as not holding, or as holding."""
    state, policy, now_s = turn.state, turn.rule.lost.policy, turn.known.now_s
    reason = f"{missing_in_words(turn.rule, turn.known)} for {away_s:.1f} s: {in_words(turn.rule, state, turn.known)}"
    is_holding = state.phase in JUDGED_BY_ITS_END
    if policy is LostPolicy.CLEAR and is_holding:
        clear_alarm(turn, now_s, reason)
    elif policy is LostPolicy.ASSERT and not is_holding:
        # Every part counts as holding, whatever it did when it could last be judged.
        turn.change(held_from_start=False, timers=replace(turn.state.timers, leaves=()))
        if state.phase in LATCHED:
            turn.trigger(Trigger.HOLDS)
        else:
            raise_alarm(turn, now_s, reason)
    elif policy is LostPolicy.ASSERT and state.is_announced_only:  # not seeing is a danger of its own: it acts
        turn.change(is_announced_only=False)


def _forget_timers(turn: AlarmTurn) -> None:
    """After the grace, what was counted before is too old to count on."""
    timers = turn.state.timers
    if has_timers(timers):
        turn.change(timers=Timers(was_judged=timers.was_judged, leaves=timers.leaves))


def back_in_sight(turn: AlarmTurn) -> None:
    """Go on judging, after there was nothing to judge by.

    Args:
        turn: The alarm.
    """
    state = turn.state
    if state.unknown_since_s is None:
        return
    # The time out of sight counts for no timer, so the next sample starts counting anew.
    timers = replace(state.timers, was_judged=False)
    turn.change(unknown_since_s=None, is_given_up=False, timers=timers)
    if state.is_given_up:
        now_s = turn.known.now_s
        reason = f"there is something to judge by again, after {now_s - state.unknown_since_s:.1f} s"
        turn.tell(EventKind.MEASUREMENT_BACK, now_s, reason, notify=not turn.is_quiet)
