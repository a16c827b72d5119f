"""One alarm while it is being judged: what it remembers so far, and what has happened."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stadimeter.core.alarms.state import AlarmState
from stadimeter.core.alarms.table import Trigger, after
from stadimeter.core.conditions.known import Known
from stadimeter.core.decision import Event, EventKind, Notice, Severity
from stadimeter.core.rule import AlarmRule
from stadimeter.core.track import Track

_GOOD_NEWS = frozenset({EventKind.MEASUREMENT_BACK, EventKind.UNSHELVED, EventKind.UNSUPPRESSED, EventKind.IN_SERVICE})
_NOBODY = Track(target="")


class AlarmTurn:
    """Collects what a cycle makes of an alarm. It lives for one cycle only.

    Args:
        rule: The alarm.
        state: What it remembers from the cycle before.
        known: All that it can be judged by.
        is_first: Whether no other alarm of its group has been raised.

    Attributes:
        state: What it remembers now.
        events: What happened, in order.
        notices: What is to be sent.
    """

    __slots__ = ("events", "is_first", "known", "notices", "rule", "state")

    def __init__(self, rule: AlarmRule, state: AlarmState, known: Known, *, is_first: bool = False) -> None:
        self.rule = rule
        self.state = state
        self.known = known
        self.is_first = is_first
        self.events: tuple[Event, ...] = ()
        self.notices: tuple[Notice, ...] = ()

    @property
    def is_quiet(self) -> bool:
        """Whether anything keeps the alarm from acting and from telling people."""
        gates = self.state.gates
        return self.rule.observe or gates.is_suppressed or gates.is_out_of_service or gates.shelved_until_s is not None

    @property
    def has_patterns(self) -> bool:
        """Whether a level that the alarm asks for changes by itself."""
        return self.rule.pattern is not None or any(step.pattern is not None for step in self.rule.sequence)

    def change(self, **fields: Any) -> None:
        """Remember something else.

        Args:
            fields: Fields of the state, with their new values.
        """
        self.state = replace(self.state, **fields)

    def trigger(self, trigger: Trigger) -> None:
        """Go to the phase that follows.

        Args:
            trigger: What happened.
        """
        phase = after(self.state.phase, trigger)
        if phase is not self.state.phase:
            self.change(phase=phase)

    def tell(self, kind: EventKind, at_s: float, reason: str, *, notify: bool, by: str = "") -> Event:
        """Add an event.

        Args:
            kind: What happened.
            at_s: When.
            reason: Why.
            notify: Whether people are to be told.
            by: Who caused it.

        Returns:
            The event.
        """
        track = self.known.tracks.get(self.rule.target, _NOBODY)
        event = Event(
            kind=kind,
            source=self.rule.name,
            at_s=at_s,
            severity=Severity.INFO if kind in _GOOD_NEWS else self.rule.severity,
            reason=reason,
            distance_m=track.distance_m if track.is_valid else None,
            sigma_m=track.sigma_m if track.is_valid else None,
            notify=notify,
            first_out=self.is_first and kind is EventKind.RAISED,
            by=by,
        )
        self.events += (event,)
        return event
