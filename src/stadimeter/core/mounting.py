"""A check that the camera is still mounted as when its view was saved, and how a person confirms that it may be so.

A camera that was turned, zoomed or refocused measures on, and wrongly: nothing in a single measurement shows
it. Distances count as *unconfirmed* from then on. They drive outputs as before, unless the configuration says
otherwise: an alarm that falls silent because its camera was touched would be the greater harm.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from msgspec import Struct

from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.operator import AnyCommand, OperatorAnswer, OperatorCommand
from stadimeter.operator_actions import OperatorAction

MOUNTING = "mounting"


class MountingStatus(StrEnum):
    """The known state of the mounting."""

    AS_SAVED = "as_saved"
    NOT_JUDGED = "not_judged"
    """It cannot be judged at present, such as in the dark; it was as saved before."""
    UNCONFIRMED = "unconfirmed"
    """It is not as it was saved, and no one has confirmed it."""


class Mounting(Struct, frozen=True, kw_only=True):
    """Result of the newest check of the mounting.

    Attributes:
        reason: Why it is unconfirmed or not judged, in words; empty if it is as saved.
    """

    status: MountingStatus = MountingStatus.AS_SAVED
    reason: str = ""

    @property
    def is_unconfirmed(self) -> bool:
        """True while distances are unconfirmed."""
        return self.status is MountingStatus.UNCONFIRMED


def step_mounting(
    *, was_unconfirmed: bool, mounting: Mounting | None, commands: Iterable[AnyCommand], now_s: float
) -> tuple[bool, tuple[OperatorAnswer, ...], tuple[Event, ...]]:
    """Check whether distances are unconfirmed now, and list the answers to those who confirm them and what happened.

    Args:
        mounting: What the newest check says; None where nothing is watched.
    """
    is_unconfirmed = mounting is not None and mounting.is_unconfirmed
    events: list[Event] = []
    answers: list[OperatorAnswer] = []
    if mounting is not None and is_unconfirmed and not was_unconfirmed:
        events.append(_event(EventKind.FAULT, now_s, f"the camera is not mounted as it was saved: {mounting.reason}"))
    elif was_unconfirmed and not is_unconfirmed:
        events.append(_event(EventKind.FAULT_CLEARED, now_s, "the camera is as it was saved again"))
    for command in commands:
        if not isinstance(command, OperatorCommand) or command.action is not OperatorAction.CONFIRM_MOUNTING:
            continue
        words = "nothing is to be confirmed: no check of the mounting has found anything"
        if is_unconfirmed:
            words = "the mounting is confirmed; the present view is saved in place of the former one"
            events.append(_event(EventKind.FAULT_CLEARED, now_s, f"confirmed {command.said}", command.by))
        answers.append(OperatorAnswer(id=command.id, accepted=is_unconfirmed, words=words))
        is_unconfirmed = False
    return is_unconfirmed, tuple(answers), tuple(events)


def _event(kind: EventKind, now_s: float, reason: str, by: str = "") -> Event:
    severity = Severity.SAFETY if kind is EventKind.FAULT else Severity.INFO
    return Event(kind=kind, source=MOUNTING, at_s=now_s, severity=severity, reason=reason, by=by)
