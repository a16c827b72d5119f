"""The messages that a messenger sends."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.decision import Severity

# An event that goes out this long after it arose, or later, is history to those who get it. As long may an alarm be
# undelivered before it is overdue.
NEWS_S = 5.0

# What waits for longer is given up, save what is about safety.
KEPT_S = 7 * 86_400.0

_REPLAYED = ',"replayed":true}'


class Message(Struct, frozen=True, kw_only=True, tag=True):
    """One message for other programs.

    Attributes:
        topic: Where it goes, below the messenger's base topic, such as ``target/ball/state``.
        is_absolute: Whether the topic stands alone, and not below the base topic.
        qos: 0, at most once, or 1, at least once.
        retain: Whether a broker keeps it for those who subscribe later.
        expires_s: After how long it is of no use any more; None for never.
        severity: How much it matters. Where too many wait, what matters least is given up first, and ``safety`` never.
        at_s: When it arose, on the run's monotonic clock.
    """

    topic: str
    payload: str
    qos: int = 0
    retain: bool = False
    expires_s: int | None = None
    severity: Severity = Severity.INFO
    at_s: float = 0.0
    is_absolute: bool = False


def as_history(message: Message) -> Message:
    """Return an event that says that it is no news: ``"replayed": true``. Any other message is returned as it is."""
    payload = message.payload
    if not message.topic.startswith("event/") or not payload.endswith("}") or payload.endswith(_REPLAYED):
        return message
    return replace(message, payload=payload.removesuffix("}") + _REPLAYED)


def clearing(topics: Iterable[str]) -> tuple[Message, ...]:
    """List what makes a broker forget topics, and who listens now take a rule that is gone for unavailable."""
    messages = []
    for topic in sorted(topics):
        if topic.endswith("/availability"):
            messages.append(Message(topic=topic, payload="offline", qos=1))
        messages.append(Message(topic=topic, payload="", qos=1, retain=True))
    return tuple(messages)


# A notification: the message that people get --------------------------------------------------------------------------


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
