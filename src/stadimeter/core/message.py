"""The messages that a messenger sends, and the topics of the program's own.

Payloads are JSON objects whose keys and their order are fixed; ``v`` is the version of that form. Numbers are in SI
units, rounded to the millimetre and the milliradian. What is not known is null, never NaN. Times are labels for
people: receivers order by ``seq`` and ``id``, since the clock of a Raspberry Pi jumps at its first time sync.
"""

from __future__ import annotations

import math
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


class OwnTopic(Struct, frozen=True, kw_only=True):
    """A topic of the program's own, below the base topic, and how its messages are sent.

    Attributes:
        path: Its levels; ``*`` stands for the name of a target, a rule, a figure and so on.
        qos: As of `Message`, and so are `retain` and `expires_s`.
        interval_s: Changes that can wait are published this far apart.
        heartbeat_s: What has not changed is published again after this time.
    """

    path: str
    qos: int = 1
    retain: bool = False
    expires_s: int | None = None
    interval_s: float = 0.0
    heartbeat_s: float = math.inf

    @property
    def first_level(self) -> str:
        """The first level, which no topic of a user's own may have."""
        return self.path.partition("/")[0]

    @property
    def is_state(self) -> bool:
        """True if its messages say how things are, and not that something happened or shall happen."""
        return self.retain or not self.qos

    @property
    def is_kept_by_name(self) -> bool:
        """True if a broker keeps its messages for ever, and the configuration's names decide whether there are any."""
        return self.retain and self.expires_s is None and self.first_level in {"figure", "rule"}

    def of(self, name: str) -> str:
        """Return the topic of what has this name."""
        return self.path.replace("*", name, 1)

    def matches(self, topic: str) -> bool:
        """Check whether a topic is of this form."""
        own, found = self.path.split("/"), topic.split("/")
        return len(own) == len(found) and all(a == b or (a == "*" and b) for a, b in zip(own, found, strict=True))


# A state that a broker keeps for ever would show a distance of last week to those who subscribe today.
EXPIRES_S = 10
HEARTBEAT_S = 5.0

AVAILABILITY = OwnTopic(path="availability", retain=True)
"""`online` or `offline`; the broker says `offline` for a run that died, with MQTT 5 after 5 s."""
INFO = OwnTopic(path="info", retain=True)
"""What runs: sent at the start and after a reload. Nodes with one `configuration_sha256` run one configuration."""
TARGET_STATE = OwnTopic(
    path="target/*/state", qos=0, retain=True, expires_s=EXPIRES_S, interval_s=0.5, heartbeat_s=HEARTBEAT_S
)
"""A target: when its status changes, when it moved by 1 cm and half a standard deviation, and every 5 s."""
RULE_STATE = OwnTopic(path="rule/*/state", retain=True, interval_s=0.5)
"""A rule: when it becomes active or stops being so, or one of its marks changes. `active` is null while unknown."""
RULE_AVAILABILITY = OwnTopic(path="rule/*/availability", retain=True)
"""`online` while it is known whether the rule is active, else `offline`."""
RULE_SETTINGS = OwnTopic(path="rule/*/settings", retain=True)
"""What operators set of a rule: its thresholds, whether it is in service, whether it is observed only."""
FIGURE_STATE = OwnTopic(path="figure/*/state", retain=True, interval_s=2.0)
"""A remembered figure, in the SI unit, when it changes, every 2 s at most."""
CAMERA_STATE = OwnTopic(path="camera/state", retain=True)
"""`online` while pictures come; `offline` when there was none for 2 s: then nothing is known of any target."""
CAMERA_POSE = OwnTopic(
    path="camera/pose", qos=0, retain=True, expires_s=EXPIRES_S, interval_s=0.2, heartbeat_s=HEARTBEAT_S
)
"""Where the camera is, with `[landmarks]`: when it moved or became unknown, and every 5 s."""
HEALTH = OwnTopic(path="health", qos=0, heartbeat_s=30.0)
"""How the run is doing, every 30 s."""
ALARM_EVENT = OwnTopic(path="event/alarm")
"""Something happened to a rule. `replayed` is true if it goes out more than 5 s late: a repeat has the same `id`."""
SYSTEM_EVENT = OwnTopic(path="event/system")
"""Something happened to a target, the camera, an output or the run."""
REQUEST = OwnTopic(path="request/*")
"""Where other programs ask for something, see below."""
RESPONSE = OwnTopic(path="response/*", qos=0)
"""The answer to a request: `status` is `ok` or `error`."""
SNAPSHOT = OwnTopic(path="snapshot", qos=0)
"""The newest picture as JPEG, after the request `snapshot`."""

OWN_TOPICS = (
    AVAILABILITY, INFO, TARGET_STATE, RULE_STATE, RULE_AVAILABILITY, RULE_SETTINGS, FIGURE_STATE, CAMERA_STATE,
    CAMERA_POSE, HEALTH, ALARM_EVENT, SYSTEM_EVENT, REQUEST, RESPONSE, SNAPSHOT,
)  # fmt: skip

OWN_FIRST_LEVELS = frozenset(each.first_level for each in OWN_TOPICS)
_STATES = frozenset(each.first_level for each in OWN_TOPICS if each.is_state)


def is_state(item: Message | Notification) -> bool:
    """Check if it says how things are, and not what happened: each run says so anew, so no older one is sent again."""
    return isinstance(item, Message) and item.topic.partition("/")[0] in _STATES


def is_kept_by_name(topic: str) -> bool:
    """Check whether it is the topic of a rule or a figure, of which a broker keeps the newest message for ever."""
    return any(each.is_kept_by_name and each.matches(topic) for each in OWN_TOPICS)


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
