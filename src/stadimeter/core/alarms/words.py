"""Why an alarm does what it does, in words with figures."""

from __future__ import annotations

from stadimeter.core.alarms.state import AlarmState
from stadimeter.core.alarms.table import Phase
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.conditions.known import Known
from stadimeter.core.decision import Event, EventKind
from stadimeter.core.rule import AlarmRule

JUDGED_BY_ITS_END = frozenset({Phase.UNACKNOWLEDGED, Phase.ACTIVE, Phase.CLEARING_UNACKNOWLEDGED, Phase.CLEARING})
"""A condition that latched has ended. To hold again it must begin again."""


def why(rule: AlarmRule, state: AlarmState, known: Known) -> str:
    """Return why an alarm does what it does, in words with figures.

    Args:
        rule: The alarm.
        state: What it remembers after the cycle.
        known: All that it was judged by.

    Returns:
        The words.
    """
    words = in_words(rule, state, known)
    if state.unknown_since_s is None:
        return words
    held = "held: " if state.is_active and not state.is_given_up else ""
    return f"{held}{missing_in_words(rule, known)} for {known.now_s - state.unknown_since_s:.1f} s: {words}"


def missing_in_words(rule: AlarmRule, known: Known) -> str:
    """Return what the matter is while there is nothing to judge by: it need not be the rule's own target.

    Args:
        rule: The alarm.
        known: All that it was judged by.

    Returns:
        The words.
    """
    return "not known" if known.tracks[rule.target].is_valid else "not seen"


def in_words(rule: AlarmRule, state: AlarmState, known: Known) -> str:
    """Return the figures behind the condition of an alarm.

    Args:
        rule: The alarm.
        state: What it remembers.
        known: All that it is judged by.

    Returns:
        The words.
    """
    is_active = state.phase in JUDGED_BY_ITS_END
    return conditions.in_words(rule.condition, known, state.timers.leaves, is_active=is_active)


def is_judged_by_its_end(state: AlarmState) -> bool:
    """Return whether the condition of an alarm is judged by what ends it, not by what begins it.

    Args:
        state: What the alarm remembers.

    Returns:
        Whether it is.
    """
    return state.phase in JUDGED_BY_ITS_END


def dismissed(rule: AlarmRule, state: AlarmState, known: Known, reason: str) -> tuple[Event, ...]:
    """Return what is to be told of an alarm that ceases to be, with its rule.

    Args:
        rule: The alarm.
        state: What it remembers.
        known: All that it was judged by.
        reason: Why it ceases to be.

    Returns:
        That it cleared, if it was active; else nothing.
    """
    turn = AlarmTurn(rule, state, known)
    if state.is_active:
        turn.tell(EventKind.CLEARED, known.now_s, reason, notify=not turn.is_quiet and not state.owes_notice)
    return turn.events
