"""The states of an alarm and what leads from one to another. Every transition is in this file.

::

    inactive ──holds──▶ pending ──on-delay──▶ active ──ended──▶ clearing ──off-delay──▶ inactive
                                               ▲   ▲                │ │
                                               │   └──holds again───┘ ├──▶ latched, until somebody resets it
                                               └──── on-delay ────────┴──▶ returned, until somebody acknowledges it

Active, clearing and latched alarms exist in two kinds: acknowledged and not. An alarm that nobody needs to acknowledge
is of the first kind from its beginning. After OPC 10000-9, "Alarms and Conditions", chapter 5.8.

What keeps an alarm quiet (shelved, suppressed, out of service) is no state of it: the alarm goes on beneath, so that it
is right when the quiet ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Phase(StrEnum):
    """Where an alarm is."""

    INACTIVE = "inactive"
    PENDING = "pending"
    """Its condition holds, but not yet for long enough."""
    UNACKNOWLEDGED = "unacknowledged"
    """Active, and somebody must acknowledge it."""
    ACTIVE = "active"
    """Active, and nobody needs to acknowledge it, or somebody has."""
    CLEARING_UNACKNOWLEDGED = "clearing_unacknowledged"
    """Active, its condition has ended, but not yet for long enough."""
    CLEARING = "clearing"
    LATCHED_UNACKNOWLEDGED = "latched_unacknowledged"
    """Active, its condition has ended for good, and somebody must acknowledge and then reset it."""
    LATCHED = "latched"
    """Active, its condition has ended for good, and somebody must reset it."""
    RETURNED = "returned"
    """No longer active, and somebody must still acknowledge it."""


class Trigger(StrEnum):
    """What happens to an alarm."""

    HOLDS = "holds"
    """Its condition holds."""
    ENDED = "ended"
    """Its condition does not hold."""
    RAISE = "raise"
    """Its condition has held for long enough, and somebody must acknowledge that."""
    RAISE_ACKNOWLEDGED = "raise acknowledged"
    """Its condition has held for long enough, and nobody needs to acknowledge that."""
    CLEAR = "clear"
    """Its condition has ended for long enough."""
    LATCH = "latch"
    """Its condition has ended for long enough, but the rule latches."""
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    REALARM = "realarm"
    """It has stood for so long that somebody must acknowledge it again."""


_P, _T = Phase, Trigger

TRANSITIONS: Mapping[Phase, Mapping[Trigger, Phase]] = {
    _P.INACTIVE: {
        _T.HOLDS: _P.PENDING,
        _T.RAISE: _P.UNACKNOWLEDGED,
        _T.RAISE_ACKNOWLEDGED: _P.ACTIVE,
    },
    _P.PENDING: {
        _T.ENDED: _P.INACTIVE,
        _T.RAISE: _P.UNACKNOWLEDGED,
        _T.RAISE_ACKNOWLEDGED: _P.ACTIVE,
    },
    _P.UNACKNOWLEDGED: {
        _T.ENDED: _P.CLEARING_UNACKNOWLEDGED,
        _T.CLEAR: _P.RETURNED,
        _T.LATCH: _P.LATCHED_UNACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.ACTIVE,
    },
    _P.ACTIVE: {
        _T.ENDED: _P.CLEARING,
        _T.CLEAR: _P.INACTIVE,
        _T.LATCH: _P.LATCHED,
        _T.REALARM: _P.UNACKNOWLEDGED,
    },
    _P.CLEARING_UNACKNOWLEDGED: {
        _T.HOLDS: _P.UNACKNOWLEDGED,
        _T.CLEAR: _P.RETURNED,
        _T.LATCH: _P.LATCHED_UNACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.CLEARING,
    },
    _P.CLEARING: {
        _T.HOLDS: _P.ACTIVE,
        _T.CLEAR: _P.INACTIVE,
        _T.LATCH: _P.LATCHED,
        _T.REALARM: _P.CLEARING_UNACKNOWLEDGED,
    },
    _P.LATCHED_UNACKNOWLEDGED: {
        _T.HOLDS: _P.UNACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.LATCHED,
    },
    _P.LATCHED: {
        _T.HOLDS: _P.ACTIVE,
        _T.RESET: _P.INACTIVE,
        _T.REALARM: _P.LATCHED_UNACKNOWLEDGED,
    },
    _P.RETURNED: {
        _T.RAISE: _P.UNACKNOWLEDGED,
        _T.RAISE_ACKNOWLEDGED: _P.ACTIVE,
        _T.ACKNOWLEDGE: _P.INACTIVE,
    },
}
"""Where a trigger leads from a phase. A trigger that is not there changes nothing."""

STANDING = frozenset(Phase) - {Phase.INACTIVE, Phase.PENDING, Phase.RETURNED}
"""The phases in which an alarm is active: it drives its output."""

UNACKNOWLEDGED = frozenset(
    {Phase.UNACKNOWLEDGED, Phase.CLEARING_UNACKNOWLEDGED, Phase.LATCHED_UNACKNOWLEDGED, Phase.RETURNED}
)
"""The phases in which somebody must acknowledge the alarm."""

LATCHED = frozenset({Phase.LATCHED_UNACKNOWLEDGED, Phase.LATCHED})
"""The phases that only a reset ends, or the condition holding again."""


def after(phase: Phase, trigger: Trigger) -> Phase:
    """Return where an alarm is after something happened to it.

    Args:
        phase: Where it is.
        trigger: What happens.

    Returns:
        Where it is then; the same phase if that changes nothing.
    """
    return TRANSITIONS[phase].get(trigger, phase)
