"""A notification: the message that people get."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.decision import Severity


@dataclass(frozen=True, slots=True, kw_only=True)
class Notification:
    """One notification for people.

    Attributes:
        time: When it arose, the local time for people; empty if that does not matter.
    """

    title: str
    body: str
    severity: Severity = Severity.WARNING
    time: str = ""
