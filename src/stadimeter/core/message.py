"""What a messenger sends."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct


class Message(Struct, frozen=True, kw_only=True, tag=True):
    """One message for other programs.

    Attributes:
        topic: Where it goes, below the messenger's base topic, such as ``target/ball/state``.
        is_absolute: Whether the topic stands alone, and not below the base topic.
        qos: 0, at most once, or 1, at least once.
        retain: Whether a broker keeps it for those who subscribe later.
        expires_s: After how long it is of no use any more; None for never.
    """

    topic: str
    payload: str
    qos: int = 0
    retain: bool = False
    expires_s: int | None = None
    is_absolute: bool = False


def clearing(topics: Iterable[str]) -> tuple[Message, ...]:
    """Return what makes a broker forget topics, and who listens now take a rule that is gone for unavailable."""
    messages = []
    for topic in sorted(topics):
        if topic.endswith("/availability"):
            messages.append(Message(topic=topic, payload="offline", qos=1))
        messages.append(Message(topic=topic, payload="", qos=1, retain=True))
    return tuple(messages)
