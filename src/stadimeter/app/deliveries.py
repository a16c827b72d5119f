"""Sending of messages, and what of them is not delivered: waiting, left by an earlier run, given up."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from stadimeter.core.decision import Severity
from stadimeter.core.message import KEPT_S, Message, Notification, as_history, is_state
from stadimeter.errors import StadimeterError
from stadimeter.messaging.protocol import Discoverable, Subscribes, TakesRequests

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.messaging.protocol import Messenger, Notifier


# Period of the check for alarms that are not delivered.
LOOK_EVERY_S = 0.5

# Number of published messages, and of topics with their newest message, that are kept for the views or shown there.
PUBLISHED_MAX = 50
TOPICS_MAX = 40

# Stands for the messenger where else the name of a notifier stands.
MESSENGER = ""

# Who has not delivered it yet, `MESSENGER` or the name of a notifier; and what.
Undelivered = tuple[str, Message | Notification]


class Deliveries:
    """Knows what messenger and notifiers have not delivered. It may be asked from any thread.

    States of rules are left out: each run tells them anew.

    Attributes:
        published: The newest messages with the time of each on the run's clock, newest first.
    """

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._unwanted: Counter[str] = Counter()
        self._reasons: list[str] = []
        self._began_s: float | None = None
        self._looked_at_s = -math.inf
        self._alarm_waits_since_s: float | None = None
        self.published: deque[tuple[float, Message]] = deque(maxlen=PUBLISHED_MAX)
        self._by_topic: dict[str, tuple[float, Message]] = {}

    def publish(self, at_s: float, messages: Iterable[Message]) -> None:
        """Publish messages, if there is a messenger."""
        if self._parts.messenger is None:
            return
        for message in messages:
            self._parts.messenger.publish(message)
            self.note_published(at_s, message)

    def note_published(self, at_s: float, message: Message) -> None:
        """Remember a message for the views. An empty one has cleared its topic."""
        self.published.appendleft((at_s, message))
        self._by_topic.pop(message.topic, None)
        if message.payload:
            self._by_topic[message.topic] = (at_s, message)

    def send(self, at_s: float, name: str, item: Message | Notification) -> None:
        """Publish a message of a rule, or hand a notification to its notifier."""
        if isinstance(item, Message):
            self.publish(at_s, (item,))
        else:
            self._parts.notifiers[name].notify(item)

    def kept(self, *, is_everything: bool) -> list[Message]:
        """Return the newest message of each topic that a broker keeps: states, or the user's own messages too."""
        newest = (message for _, message in self._by_topic.values())
        lasting = (each for each in newest if each.retain and each.expires_s is None)
        return [each for each in lasting if is_everything or is_state(each)]

    def link(self) -> dict[str, Any] | None:
        """Return where the messenger publishes and how it is, for people who watch; None if there is no messenger.

        ``topics`` are the newest message of each topic, with its time, newest first.
        """
        messenger, choice = self._parts.messenger, self._parts.configuration.messenger
        if messenger is None or choice is None:
            return None
        options: object = choice.options
        newest = list(self._by_topic.values())[: -TOPICS_MAX - 1 : -1]
        place = messenger.discovery_place if isinstance(messenger, Discoverable) else None
        return {
            "broker": options.place if isinstance(options, Subscribes) else "",
            "base": options.base if isinstance(options, Subscribes) else "",
            "trouble": messenger.trouble(),
            "undelivered": len(messenger.undelivered()),
            "given_up": messenger.given_up,
            "dropped": messenger.dropped,
            "commands": messenger.commands if isinstance(messenger, TakesRequests) else "off",
            "deafness": messenger.deafness() if isinstance(messenger, TakesRequests) else "",
            "home_assistant": place.topic if place is not None else "",
            "topics": [{"at_s": round(at_s, 3), "topic": each.topic, "payload": each.payload} for at_s, each in newest],
        }

    def retain_only(self, topics: frozenset[str]) -> None:
        """Have a broker keep only what is published on these topics, and Home Assistant show what this run has."""
        messenger: object = self._parts.messenger
        if not isinstance(messenger, Discoverable):
            return
        if messenger.discovery_place is not None:
            from stadimeter.app.discovery import announcement  # noqa: PLC0415 - only who is discovered needs it

            plan = self._parts.configuration.plan
            messenger.announce(announcement(plan, messenger.discovery_place, messenger.orders))
        messenger.retain_only(topics)

    def undelivered(self) -> tuple[Undelivered, ...]:
        """Return the messages that are neither delivered nor given up, oldest first."""
        return tuple(
            (name, each) for name, sender in self._senders() for each in sender.undelivered() if not is_state(each)
        )

    def alarm_waits_since_s(self, now_s: float) -> float | None:
        """Return since when this run has had an alarm that it could not deliver, the oldest; None for none.

        Whatever is more than ``info`` counts. On the run's clock; looked for twice a second. One that an earlier run
        left waits since the beginning of this.
        """
        if self._began_s is None:
            self._began_s = now_s
        if now_s - self._looked_at_s >= LOOK_EVERY_S:
            self._looked_at_s = now_s
            since_s = min(
                (item.at_s for _, item in self.undelivered() if item.severity is not Severity.INFO), default=None
            )
            self._alarm_waits_since_s = None if since_s is None else max(since_s, self._began_s)
        return self._alarm_waits_since_s

    def given_up(self) -> dict[str, int]:
        """Return by name how much was given up so far; nothing for those who gave up nothing."""
        counts = dict(self._unwanted)
        for name, sender in self._senders():
            if count := sender.given_up:
                counts[name] = counts.get(name, 0) + count
        return counts

    def send_again(self, left: Iterable[Undelivered], now_s: float, shift_s: float) -> None:
        """Send what an earlier run has left, before anything of this one.

        A message says itself when it arose, and by its id whether it came before; an event says that it is history. A
        notification that does not say its time is given it, so that last night's alarm does not look like one of now.

        Args:
            shift_s: From the clock of the run that has left it to this run's.
        """
        for name, found in left:
            item = replace(found, at_s=found.at_s + shift_s)
            messenger, notifier = self._parts.messenger, self._parts.notifiers.get(name)
            try:
                if now_s - item.at_s > KEPT_S and item.severity is not Severity.SAFETY:
                    self._unwanted[name] += 1
                elif isinstance(item, Message) and messenger is not None:
                    messenger.publish(as_history(item))
                elif isinstance(item, Notification) and notifier is not None:
                    notifier.notify(_with_its_time(item))
                else:
                    self._unwanted[name] += 1
            except StadimeterError:  # its topic cannot be one any more, for example
                self._unwanted[name] += 1

    def figures(self) -> list[dict[str, Any]]:
        """Return, for programs, how much waits and how much was given up."""
        waiting, given_up = Counter(name for name, _ in self.undelivered()), self.given_up()
        names = dict.fromkeys([*(name for name, _ in self._senders()), *given_up])
        return [
            {"to": name or "messenger", "waiting": waiting[name], "given_up": given_up.get(name, 0)} for name in names
        ]

    def closing(self) -> None:
        """Note why something waits, for `last_words`: once they are closed, they say nothing else."""
        self._reasons = [words for _, sender in self._senders() if (words := sender.trouble())]

    def last_words(self, kept: Iterable[Undelivered]) -> list[str]:
        """Say at the end of a run, in lines, what becomes of what was not delivered, some of it kept for the next."""
        left = Counter(name for name, _ in self.undelivered())
        later = left & Counter(name for name, _ in kept)
        lost = left - later + Counter(self.given_up())
        why = f" ({'; '.join(self._reasons)})" if self._reasons else ""
        lines = [f"not delivered yet, the next run sends them: {in_words(later)}{why}"] if later else []
        return lines + ([f"given up: {in_words(lost)}{why}"] if lost else [])

    def _senders(self) -> Iterator[tuple[str, Messenger | Notifier]]:
        if self._parts.messenger is not None:
            yield MESSENGER, self._parts.messenger
        yield from self._parts.notifiers.items()


def in_words(counts: Mapping[str, int]) -> str:
    """Return counts in words, such as ``3 messages, 1 notification for phone``."""
    return ", ".join(
        f"{count} {'notification' if name else 'message'}{'' if count == 1 else 's'}{f' for {name}' if name else ''}"
        for name, count in counts.items()
    )


def _with_its_time(notification: Notification) -> Notification:
    if not notification.time or notification.time in notification.body:
        return notification
    return replace(notification, body=f"{notification.body}\n({notification.time})")
