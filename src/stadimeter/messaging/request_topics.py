"""The topics on which other programs ask for something, and what of it must not be heeded."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Collection, Sequence

from msgspec import Struct
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode

from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import MqttSettings, subscribe
from stadimeter.messaging.protocol import NoRequest, RequestMessage

# A longer message is no request.
REQUEST_MAX_BYTES = 4096

# Requests that a topic takes at once, and how fast it takes more. More are counted, and not looked into.
BURST = 16
RATE_HZ = 10.0

# A topic that more messages come on within a second is left for this long: even to read them takes the processor.
FLOOD = 200
LEFT_FOR_S = 10.0

# With MQTT 3.1.1 a broker hears of no limit, and a kept message may come again with each subscription.
OVERSIZED_MAX = 3

# MQTT allows any number below 2**28. One that an earlier run has used would revive what was sent to that.
_IDENTIFIERS = (1, 2**28 - 1)


class _Intake(Struct):
    """The messages that came on a topic of late.

    Attributes:
        left: How many more requests it may take now.
        second: The second in which `count` messages came.
        left_until_s: Until when it is not listened to.
        is_subscribed: Whether we have subscribed to it over this connection.
        refusal: Why the broker would not let us, in words.
    """

    left: float = BURST
    at_s: float = -math.inf
    second: int = 0
    count: int = 0
    left_until_s: float = -math.inf
    is_subscribed: bool = False
    refusal: str = ""

    def has_room(self, now_s: float) -> bool:
        """Note a message, and return whether it may be looked into."""
        if int(now_s) != self.second:
            self.second, self.count = int(now_s), 0
        self.count += 1
        if self.count > FLOOD:
            self.left_until_s = now_s + LEFT_FOR_S
        self.left = min(BURST, self.left + (now_s - self.at_s) * RATE_HZ)
        self.at_s = now_s
        if self.left < 1:
            return False
        self.left -= 1
        return True


class RequestTopics:
    """Knows which topics to subscribe to, and judges what comes on them. Used in the link's thread, save `trouble`.

    With MQTT 5, a message that the broker kept for us while we were away carries the identifier of a subscription of
    then. With 3.1.1 no session is kept, so there is none.

    Args:
        topics: Below the base topic.
        receive: Takes every message that comes on them; it neither waits nor fails.
    """

    def __init__(
        self, options: MqttSettings, topics: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        self._options = options
        self._receive = receive
        self._intakes = {f"{options.base}/{topic}": _Intake() for topic in topics}
        self._asked: dict[int, Sequence[str]] = {}
        self._trouble = ""
        self.identifier: int | None = None

    def begin_over(self, events: LinkEvents, *, is_v5: bool) -> None:
        """Begin anew over a connection, unless its broker is none to be listened to."""
        trouble = ""
        if events.oversized_packets >= OVERSIZED_MAX:
            trouble = (
                f"{self._options.place} sent {OVERSIZED_MAX} messages that are too large, so commands are not heard "
                "until this program is started anew; clear kept messages on its topics of requests"
            )
        elif is_v5 and not events.has_identifiers:
            trouble = (
                f"{self._options.place} cannot mark old messages (no subscription identifiers), so commands are not "
                "heard; set protocol to '3.1.1'"
            )
        self.begin(is_v5=is_v5, trouble=trouble)

    def attend(self, client: Client, events: LinkEvents) -> None:
        """Subscribe to the topics of requests, leave those that are flooded, and take note of the broker's answers."""
        for number, codes in events.take_subscribed():
            self.note_answer(number, codes)
        new, flooded = self.due(time.monotonic())
        if new:
            self.note_asked(subscribe(client, new, self.identifier), new)
        if flooded:
            client.unsubscribe(flooded)

    def begin(self, *, is_v5: bool, trouble: str = "") -> None:
        """Begin anew over another connection; with a trouble, nothing is subscribed to over it."""
        self.identifier = random.randint(*_IDENTIFIERS) if is_v5 else None  # noqa: S311 - it is no secret
        self._trouble = trouble
        self._asked.clear()
        for intake in self._intakes.values():
            intake.is_subscribed, intake.refusal = False, ""

    def due(self, now_s: float) -> tuple[list[str], list[str]]:
        """Return which topics to subscribe to now, and which to leave."""
        if self._trouble:
            return [], []
        new: list[str] = []
        flooded: list[str] = []
        for topic, intake in self._intakes.items():
            is_left = now_s < intake.left_until_s
            if intake.is_subscribed is is_left:
                (flooded if is_left else new).append(topic)
                intake.is_subscribed = not is_left
        return new, flooded

    def note_asked(self, number: int | None, topics: Sequence[str]) -> None:
        """Note that topics were subscribed to, and by which number the broker will answer."""
        if number is not None:
            self._asked[number] = topics

    def note_answer(self, number: int, codes: Sequence[ReasonCode]) -> None:
        """Note the broker's answer."""
        for topic, code in zip(self._asked.pop(number, ()), codes, strict=False):
            self._intakes[topic].refusal = str(code) if code.is_failure else ""

    def hear(self, message: MQTTMessage) -> None:
        """Take in a message; what comes on another topic, such as one of an earlier run, is passed over."""
        intake = self._intakes.get(message.topic)
        if intake is None:
            return
        now_s = time.monotonic()
        refusal = self._refusal(message, intake, now_s)
        properties = message.properties
        received = RequestMessage(
            topic=message.topic.removeprefix(f"{self._options.base}/"),
            payload=bytes(message.payload) if len(message.payload) <= REQUEST_MAX_BYTES else b"",
            at_s=now_s,
            refusal=refusal,
            response_topic=self._usable(getattr(properties, "ResponseTopic", "")),
            correlation=getattr(properties, "CorrelationData", None),
        )
        self._receive(received)

    def trouble(self) -> str:
        """Return why requests are not heard, or an empty string. May be called from any thread."""
        if self._trouble:
            return self._trouble
        now_s = time.monotonic()
        refused = {topic: intake.refusal for topic, intake in self._intakes.items() if intake.refusal}
        if refused:
            return describe_deafness(self._options, list(refused), next(iter(refused.values())))
        flooded = [topic for topic, intake in self._intakes.items() if now_s < intake.left_until_s]
        if flooded:
            return f"more than {FLOOD} messages within a second came on '{flooded[0]}': it is not listened to for 10 s"
        return ""

    def _refusal(self, message: MQTTMessage, intake: _Intake, now_s: float) -> NoRequest | None:
        if not intake.has_room(now_s):
            return "too_many"
        if message.retain:
            return "retained"
        if self.identifier is not None and self.identifier not in _identifiers(message):
            return "stale"
        return "too_large" if len(message.payload) > REQUEST_MAX_BYTES else None

    def _usable(self, topic: str) -> str:
        """Return a response topic if it can be one: with no wildcard, and none that this program or a broker owns."""
        base = self._options.base
        is_ours = topic == base or topic.startswith(f"{base}/")
        is_allowed = not is_ours or topic.startswith(f"{base}/response/")
        return topic if is_allowed and topic[:1] != "$" and not any(each in topic for each in "+#\0") else ""


def describe_deafness(options: MqttSettings, topics: Sequence[str], why: str) -> str:
    """Say that the broker lets us subscribe to no requests on some topics."""
    more = f" and {len(topics) - 1} more" if len(topics) > 1 else ""
    return (
        f"{options.place} refused the subscription to '{topics[0]}'{more} ({why}), so commands are not heard; "
        "check the broker's access list"
    )


def _identifiers(message: MQTTMessage) -> Sequence[int]:
    found: Sequence[int] = getattr(message.properties, "SubscriptionIdentifier", ())
    return found
