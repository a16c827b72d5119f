"""A notification: the message that people get."""

from __future__ import annotations

from msgspec import Struct

from stadimeter.core.decision import Severity


class Notification(Struct, frozen=True, kw_only=True, tag=True):
    """One notification for people.

    Attributes:
        at_s: When it arose, on the run's monotonic clock.
        time: When it arose, the local time for people; empty if that does not matter.
    """

    title: str
    body: str
    severity: Severity = Severity.WARNING
    time: str = ""
    at_s: float = 0.0
