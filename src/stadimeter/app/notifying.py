"""What rules send when something happens to them: messages of their own, and notifications for people."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from stadimeter.core import templates
from stadimeter.core.decision import Decision, Notice
from stadimeter.core.message import Message
from stadimeter.core.notification import Notification
from stadimeter.core.rule import AlarmRule, AnyRule, Send, Template

LocalTime = Callable[[], str]

TITLE_LONGEST = 120


@dataclass(frozen=True, slots=True, kw_only=True)
class Outgoing:
    """What is to be sent after a cycle; notifications go with the name of their notifier."""

    messages: tuple[Message, ...] = ()
    notifications: tuple[tuple[str, Notification], ...] = ()


NOTHING = Outgoing()


class Notifying:
    """Fills in what rules send. It does no I/O and reads no clock."""

    def __init__(self, rules: Iterable[AnyRule]) -> None:
        self._alarms: Mapping[str, AlarmRule] = {}
        self.take(rules)

    def take(self, rules: Iterable[AnyRule]) -> None:
        """Go by other rules from now on."""
        self._alarms = {rule.name: rule for rule in rules if isinstance(rule, AlarmRule)}

    def outgoing(self, decision: Decision, local_time: LocalTime) -> Outgoing:
        """Return what is to be sent after a cycle, in the order of the rules.

        The time (RFC 3339) is asked for if needed.
        """
        if not decision.notices:
            return NOTHING
        time = local_time()
        messages: list[Message] = []
        notifications: list[tuple[str, Notification]] = []
        for notice in decision.notices:
            rule = self._alarms[notice.rule]
            send = rule.sequence[notice.step].send
            if send is None:
                continue
            values = _values(rule, notice, decision, time)
            if send.topic:
                messages.append(_message(send, values))
            else:
                notifications.append((send.notifier, _notification(rule, notice, send, values, time)))
        return Outgoing(messages=tuple(messages), notifications=tuple(notifications))


def _values(rule: AlarmRule, notice: Notice, decision: Decision, time: str) -> dict[str, templates.Value]:
    track = next((track for track in decision.tracks if track.target == rule.target), None)
    return templates.fields(rule, notice, track, time, rule.group)


def _message(send: Send, values: Mapping[str, templates.Value]) -> Message:
    return Message(topic=send.topic, payload=templates.render(send.template, values), qos=1, retain=send.retain)


def _notification(
    rule: AlarmRule, notice: Notice, send: Send, values: Mapping[str, templates.Value], time: str
) -> Notification:
    title = templates.render(Template(text=send.title), values) if send.title else rule.name
    title = " ".join(title.split())[:TITLE_LONGEST] or rule.name
    body = templates.render(send.template, values).strip() or title
    return Notification(title=title, body=body, severity=notice.event.severity, time=time)
