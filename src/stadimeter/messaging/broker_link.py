"""One connection to a broker, kept up by a thread: what the broker keeps, what is sent, and what others ask for."""

from __future__ import annotations

import os
import random
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import MQTTException  # type: ignore[attr-defined] # paho 2.1 and 2.2 both have it there

from stadimeter.core.home_assistant import Announcement, announce, announced_platforms
from stadimeter.core.message import AVAILABILITY, OWN_TOPICS, Message, clearing, is_kept_by_name
from stadimeter.messaging.mqtt_client import (
    OFFLINE,
    ONLINE,
    LinkEvents,
    MqttSettings,
    Secrets,
    make_client,
    publish_properties,
    say_goodbye,
    subscribe,
)
from stadimeter.messaging.outbox import DirectMessage, MemoryOutbox, PendingMessage, pending
from stadimeter.messaging.protocol import BackOff, NoRequest, Patience, RequestMessage

# What a broker keeps of a run, and what Home Assistant discovers of it, over every connection -------

# Time after the confirmed subscription within which everything arrives that a broker has kept.
KEPT_ARRIVES_S = 0.5


class RetainedTopics:
    """Clears what the broker has kept of an earlier run and this one lacks, and announces this node to Home Assistant.

    At the beginning of a connection the broker itself is asked: it sends each message that it keeps of a rule, of a
    figure, or as this node's announcement. What else it keeps is never touched, whoever wrote it.

    `retain_only`, `announce` and what is taken may be called in any thread, all else in the link's.

    Attributes:
        is_reading: Whether kept messages may still come.
    """

    def __init__(self, options: MqttSettings, queue: SendQueue) -> None:
        self._options = options
        self._queue = queue
        self._lock = threading.Lock()  # of the four that follow
        self._topics: frozenset[str] | None = None
        self._announcement: Announcement | None = None
        self._kept: dict[str, bytes] = {}
        self._is_read = False
        self.is_reading = False
        self._subscription: int | None = None
        self._device_topic = options.discovery_at.topic
        self._birth_topic = f"{options.discovery_prefix}/status"  # there Home Assistant says that it begins
        self._connections = 0
        self._are_states_due = self._is_forgotten = False

    def retain_only(self, topics: frozenset[str]) -> None:
        """Take on which topics messages are published for the broker to keep, below the base topic."""
        with self._lock:
            self._topics = topics  # a broker may have answered before a run knows what it publishes
        self._queue.wake()

    def announce(self, announcement: Announcement | None) -> None:
        """Have Home Assistant discover this from now on, and no more what was announced before."""
        with self._lock:
            before, self._announcement = self._announcement, announcement
            if self._is_read:
                self._send(announce(announcement, before.platforms if before else {}, self._device_topic))

    def take_states_due(self) -> bool:
        """Return, once each time, whether Home Assistant or the broker began anew, and may know no states."""
        if not self._are_states_due:
            return False
        self._are_states_due = False
        return True

    def take_forgotten(self) -> bool:
        """Return, once each time, whether the broker has forgotten all that this run had it keep."""
        is_forgotten, self._is_forgotten = self._is_forgotten, False
        return is_forgotten

    def begin_over(self, client: Client) -> None:
        """Begin anew over a connection."""
        self._connections += 1
        self._are_states_due = self._connections > 1
        if self._options.home_assistant:
            client.subscribe(self._birth_topic, qos=0)

    def end(self) -> None:
        """Forget what was read over a connection that is no more."""
        with self._lock:
            self._kept, self._is_read, self.is_reading, self._subscription = {}, False, False, None

    def attend(self, client: Client, events: LinkEvents, *, is_last: bool = False) -> None:
        """Do what is due: ask for what is kept, and act on it when it has arrived."""
        if self.is_reading:
            subscribed_at_s = events.subscribed_at_s.get(self._subscription)
            if subscribed_at_s is not None and (is_last or time.monotonic() - subscribed_at_s >= KEPT_ARRIVES_S):
                self._finish(client)
            return
        if self._is_read or self._topics is None:
            return
        self.is_reading = True
        _, self._subscription = client.subscribe([(each, 0) for each in self._filters()])

    def hear(self, message: MQTTMessage) -> None:
        """Take in a message that the broker has kept, or the word of Home Assistant that it has begun anew."""
        if message.topic == self._birth_topic:
            if message.payload == b"online" and not message.retain:
                self._are_states_due = True
                with self._lock:
                    self._send(announce(self._announcement, {}, self._device_topic))
        elif message.retain and message.payload:
            self._kept[message.topic] = bytes(message.payload)

    def _finish(self, client: Client) -> None:
        """Clear what is published no more, and announce this node."""
        with self._lock:
            published = self._topics or frozenset()
            below = {topic.removeprefix(f"{self._options.base}/") for topic in self._kept}
            if self._connections > 1 and published and not self._kept:
                self._is_forgotten = True
            before = announced_platforms(self._kept.get(self._device_topic, b""))
            self.is_reading, self._is_read, self._kept = False, True, {}
            self._send(clearing(filter(is_kept_by_name, below - published)))
            self._send(announce(self._announcement, before, self._device_topic))
        client.unsubscribe(list(self._filters()))

    def _filters(self) -> tuple[str, ...]:
        own = (f"{self._options.base}/{each.of('+')}" for each in OWN_TOPICS if each.is_kept_by_name)
        return (*own, self._device_topic)

    def _send(self, messages: Iterable[Message]) -> None:
        for message in messages:
            self._queue.send(message)


# The connection, and the queue of what is to be sent ------------------------------------------------------------------

# Interval, during a pause, of looking for messages of QoS 1, which shorten the pause.
LOOK_EVERY_S = 0.5

V5, V311 = MQTTProtocolVersion.MQTTv5, MQTTProtocolVersion.MQTTv311


def serve(loop: Callable[[float], MQTTErrorCode], events: LinkEvents, wait_s: float) -> bool:
    """Let paho read and write by a loop of its client; return whether the connection still stands."""
    try:
        return loop(wait_s) == MQTTErrorCode.MQTT_ERR_SUCCESS
    except (LookupError, TypeError, ValueError, struct.error, MQTTException):  # from paho 2.1, and not caught there
        events.note_nonsense()
        return False


class BrokerLink:
    """Connects, connects again, and says what is wrong meanwhile. It serves from `start` to `stop`, once.

    paho's own thread (``loop_start``) is not used. With paho 2.2, ``loop_stop`` joins it without a time limit: 4.5 s
    while a host does not answer, where the end of a run allows 0.6 s. ``on_connect_fail`` gives no reason, and the
    version of MQTT, the pause while an alarm waits and the list of retained topics would need a second thread.

    paho is called in the link's thread only, and nowhere with a lock held: no other thread ever waits for it.

    Attributes:
        queue: What is to be sent.
        retained: What the broker keeps, and what Home Assistant discovers.
        requests: Where other programs ask for something; None for nowhere. Set before `start`.
    """

    def __init__(self, options: MqttSettings, patience: Patience) -> None:
        self._options = options
        self._patience = patience
        self._back_off = BackOff(patience)
        self._events = LinkEvents(options, self._hear)
        self._stopping = threading.Event()
        self._thread = threading.Thread()
        self._why_not = f"not connected to {options.place} yet"
        self._version = V311 if options.protocol == "3.1.1" else V5
        self.queue = SendQueue(options.base, self._events)
        self.retained = RetainedTopics(options, self.queue)
        self.requests: RequestTopics | None = None

    def start(self, secrets: Secrets) -> None:
        """Begin to connect."""
        self._secrets = secrets
        self._client = self._new_client()
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)
        self._thread.start()

    def _hear(self, message: MQTTMessage) -> None:
        self.retained.hear(message)
        if self.requests is not None:
            self.requests.hear(message)

    def send_now(self, topic: str, payload: bytes, content_type: str, correlation: bytes | None = None) -> bool:
        """Send to a topic that is not below the base, with QoS 0, or drop and count it. Returns at once."""
        message = DirectMessage(topic=topic, content=payload, content_type=content_type, correlation=correlation)
        return self.queue.send_now(message, self._events.packet_max)

    def deafness(self) -> str:
        """Return why requests are not heard although there is a connection, or an empty string."""
        return self.requests.trouble() if self.requests is not None and self.queue.is_connected else ""

    def trouble(self) -> str:
        """Return in words what is wrong, or an empty string."""
        return self._events.refusal if self.queue.is_connected else self._why_not

    def stop(self) -> None:
        """Say goodbye, wait a moment at most for what is on its way, and end. What is left over is `undelivered`."""
        self._stopping.set()
        self.queue.wake()
        # A look-up of a name may keep the thread longer; it then ends by itself.
        self._thread.join(2 * self._patience.goodbye_s)

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._attempt()
            if self._stopping.is_set() or (self._change_version() and self._version == V311):
                continue
            self._pause(self._pause_s())

    def _pause(self, pause_s: float) -> None:
        """Rest, for less long if there is or comes something that must arrive."""
        began_s = time.monotonic()
        left_s = pause_s
        while left_s > 0 and not self._stopping.wait(min(left_s, LOOK_EVERY_S)):
            longest_s = min(pause_s, self._patience.alarm_pause_s) if self.queue.undelivered() else pause_s
            left_s = began_s + longest_s - time.monotonic()

    def _attempt(self) -> None:
        """Connect, and stay until the connection ends or we stop."""
        self._events.begin()
        try:
            self._client.reconnect()
        except OSError as error:
            self._events.note_connect_error(error)
            return
        self._stay()
        if self._stopping.is_set():
            self._say_goodbye()
        self._hang_up()
        self.retained.end()
        self.queue.note_done()
        self._start_over()

    def _stay(self) -> None:
        until_s = time.monotonic() + self._patience.answer_s
        while not self._stopping.is_set():
            left_s = until_s - time.monotonic()
            if not self._events.is_accepted and left_s < 0:
                self._events.note_no_answer()
                return
            if not self._loop(self._wait_s() if self._events.is_accepted else max(0.0, left_s)):
                return
            self._take_stock()

    def _wait_s(self) -> float:
        return KEPT_ARRIVES_S / 4 if self.retained.is_reading else 1.0

    def _loop(self, wait_s: float) -> bool:
        return serve(partial(self.queue.loop, self._client), self._events, wait_s)

    def _take_stock(self) -> None:
        """Act on what paho's callbacks and other threads left for us."""
        self.queue.note_done()
        if not self._events.is_accepted or self._stopping.is_set():
            return
        if not self.queue.is_connected:
            self._hand_over(ONLINE)
            self.retained.begin_over(self._client)
            if self.requests is not None:
                self.requests.begin_over(self._events, is_v5=self._version == V5)
            self.queue.connect()
        self.retained.attend(self._client, self._events)
        if self.requests is not None:
            self.requests.attend(self._client, self._events)
        self._hand_over()

    def _hand_over(self, *first: Message) -> None:
        self.queue.hand_over(self._client, *first, is_v5=self._version == V5)

    def _say_goodbye(self) -> None:
        """Disconnect in order if all was delivered; without that, the broker will publish our last will."""
        if self.retained.is_reading:
            self.retained.attend(self._client, self._events, is_last=True)
        until_s = time.monotonic() + self._patience.goodbye_s
        delivered = not self.queue.is_connected
        if self.queue.is_connected:
            self._hand_over()
            self._hand_over(OFFLINE)
        while not delivered and time.monotonic() < until_s and self._loop(0.05):
            delivered = self.queue.note_done()
            self._hand_over()
        if delivered:
            say_goodbye(self._client, self._version)  # and no request is kept for a run that is not there
            while time.monotonic() < until_s and self._loop(0.05):
                pass

    def _hang_up(self) -> None:
        if (connection := self._client.socket()) is not None:
            with suppress(OSError):  # it may be gone already
                connection.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined] # paho's type leaves it out
            self._loop(0.0)  # paho reads the end and closes its side
            connection.close()  # unless it stumbles over what was sent before

    def _pause_s(self) -> float:
        """Say why there is no connection, and return for how long to rest."""
        if self._events.was_stable:
            self._back_off.reset()
        if self._events.was_taken_over:
            self._back_off.jump_to_longest()
        pause_s = self._back_off.next_s()
        if self.queue.undelivered():
            pause_s = min(pause_s, self._patience.alarm_pause_s)
        self._why_not = f"{self._events.ending}; trying again in {pause_s:.3g} s"
        return pause_s

    def _change_version(self) -> bool:
        """Try the other version if the broker seems not to speak this one; return whether it was changed."""
        if self._options.protocol != "auto" or not self._events.suspects_version:
            return False
        self._version = V5 if self._version == V311 else V311
        self._start_over()
        return True

    def _start_over(self) -> None:
        """Begin with a new client: paho would send its own copies again, and those do not say that they are late."""
        self.queue.disconnect()
        self._client = self._new_client()

    def _new_client(self) -> Client:
        client = make_client(self._options, self._secrets, self._version, self._patience.answer_s)
        self._events.listen_to(client)
        # With this set, publishing only queues, and does not write from within a callback or before `select` said so.
        client.on_socket_register_write = lambda *_: None
        return client


# Messages between the threads that publish and the thread of a link, which alone speaks to paho ---


# Room in a packet for what is neither payload nor topic.
_HEADER_BYTES = 512


class SendQueue:
    """Takes messages from any thread at once, and hands them to paho in the link's.

    The thread that publishes only puts a message into the outbox and wakes the link's thread, once for all that it
    finds then. Packing a message takes paho ten times as long. The lock is never held while paho is called.

    Attributes:
        is_connected: Whether there is a broker to send to. Written by the link's thread.

    Args:
        base: The prefix of every topic that is not absolute.
        events: Of the client that messages are handed to.
    """

    def __init__(self, base: str, events: LinkEvents) -> None:
        self.is_connected = False
        self._base = base
        self._events = events
        self._lock = threading.Lock()  # of the outbox
        self._outbox = MemoryOutbox()
        self._is_woken = False
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def __del__(self) -> None:
        """Close the bell; every thread that has the queue may ring it until then."""
        os.close(self._bell)

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were dropped, and of states of QoS 1 that were replaced unsent."""
        return self._outbox.dropped

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 that were given up. It is asked for in every cycle, and so it takes no lock."""
        return self._outbox.given_up

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        with self._lock:
            undelivered = self._outbox.undelivered()
        return tuple([each for each in undelivered if not (each.topic == AVAILABILITY.path or each.is_absolute)])

    def send(self, message: Message) -> None:
        """Send a message, or let it wait (QoS 1), or drop and count it (QoS 0). Returns at once."""
        with self._lock:
            if message.qos or self.is_connected:
                self._outbox.add(message, time.monotonic())
            else:
                self._outbox.drop()
        if self.is_connected:
            self.wake()

    def send_now(self, message: DirectMessage, packet_max: int | None) -> bool:
        """Send a message, or drop and count it; return whether the connection can take it. Returns at once."""
        size = len(message.content) + len(message.topic.encode()) + _HEADER_BYTES
        with self._lock:
            can_go = self.is_connected and self._outbox.has_room_on_wire and (not packet_max or size <= packet_max)
            if can_go:
                self._outbox.add(message, time.monotonic())
            else:
                self._outbox.drop()
        self.wake()
        return can_go

    def wake(self) -> None:
        """Wake the link's thread, unless it is about to look anyway."""
        if not self._is_woken:
            self._is_woken = True
            os.eventfd_write(self._bell, 1)

    # In the link's thread.

    def loop(self, client: Client, wait_s: float) -> MQTTErrorCode:
        """Wait until there is something to read, to write or to send, and have paho read and write.

        It takes the place of paho's `loop`, which knows no bell and looks twice.
        """
        connection: Any = client.socket()  # it may be one of TLS
        if connection is None:
            return MQTTErrorCode.MQTT_ERR_NO_CONN
        is_decrypted = getattr(connection, "pending", int)() > 0  # already, which `select` does not see
        to_write = [connection] if client.want_write() else []
        try:
            found = select.select([connection, self._bell], to_write, [], 0.0 if is_decrypted else wait_s)
        except (ValueError, OSError):  # it was closed
            return MQTTErrorCode.MQTT_ERR_CONN_LOST
        if self._bell in found[0]:
            os.eventfd_read(self._bell)
            self._is_woken = False
        code = client.loop_read() if is_decrypted or connection in found[0] else MQTTErrorCode.MQTT_ERR_SUCCESS
        return code or (client.loop_write() if found[1] else code) or client.loop_misc()

    def connect(self) -> None:
        """Note that there is a connection."""
        self.is_connected = True

    def disconnect(self) -> None:
        """Note that there is no connection any more, and take back what may not have arrived."""
        with self._lock:
            self.is_connected = False
            self._outbox.start_over()

    def hand_over(self, client: Client, *first: Message, is_v5: bool) -> None:
        """Give paho these messages, and then what waits and may go now."""
        for message in first:
            self._publish(client, pending(message, time.monotonic()), is_v5=is_v5)
        while waiting := self._take():
            self._publish(client, waiting, is_v5=is_v5)

    def note_done(self) -> bool:
        """Note what was written or answered; return whether nothing is left."""
        with self._lock:
            for number, is_refused in self._events.take_done():
                self._outbox.done(number, is_refused=is_refused)
            return self._outbox.is_empty

    def _take(self) -> PendingMessage | None:
        with self._lock:
            return self._outbox.take(time.monotonic()) if self.is_connected else None

    def _publish(self, client: Client, waiting: PendingMessage, *, is_v5: bool) -> None:
        message = waiting.on_wire(time.monotonic())
        try:
            info = client.publish(
                message.topic if message.is_absolute else f"{self._base}/{message.topic}",
                message.content if isinstance(message, DirectMessage) else message.payload,
                message.qos,
                # Without the expiry of MQTT 5 a broker would show a stale value to newcomers for ever.
                retain=message.retain and (is_v5 or message.expires_s is None),
                properties=publish_properties(message) if is_v5 else None,
            )
        except ValueError as error:
            self._events.note_unsendable(message.topic, error)
            with self._lock:
                self._outbox.refuse_taken(waiting)
            return
        with self._lock:
            if message.qos == 0 and info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
                self._outbox.drop()
            else:
                self._outbox.sent(info.mid, waiting)


# The topics on which other programs ask for something, and what of it must not be heeded ----------


# A longer message is no request.
REQUEST_MAX_BYTES = 4096

# MQTT allows any number below 2**28. One that an earlier run has used would revive what was sent to that.
_IDENTIFIERS = (1, 2**28 - 1)


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
        self._topics = [f"{options.base}/{topic}" for topic in topics]
        self._is_asked = False
        self._subscription: int | None = None
        self._refused: dict[str, str] = {}
        self._trouble = ""
        self.identifier: int | None = None

    def begin_over(self, events: LinkEvents, *, is_v5: bool) -> None:
        """Begin anew over a connection, unless its broker is none to be listened to."""
        self.identifier = random.randint(*_IDENTIFIERS) if is_v5 else None  # noqa: S311 - it is no secret
        self._is_asked, self._refused, self._trouble = False, {}, ""
        if is_v5 and not events.has_identifiers:
            self._trouble = (
                f"{self._options.place} cannot mark old messages (no subscription identifiers), so commands are not "
                "heard; set protocol to '3.1.1'"
            )

    def attend(self, client: Client, events: LinkEvents) -> None:
        """Subscribe to the topics of requests, and take note of the broker's answer."""
        if not self._is_asked and not self._trouble:
            self._is_asked = True
            self._subscription = subscribe(client, self._topics, self.identifier)
        for number, codes in events.take_subscribed():
            if self._is_asked and number == self._subscription:
                found = zip(self._topics, codes, strict=False)
                self._refused = {topic: str(code) for topic, code in found if code.is_failure}

    def hear(self, message: MQTTMessage) -> None:
        """Take in a message; what comes on another topic, such as one of an earlier run, is passed over."""
        if message.topic not in self._topics:
            return
        properties = message.properties
        received = RequestMessage(
            topic=message.topic.removeprefix(f"{self._options.base}/"),
            payload=bytes(message.payload) if len(message.payload) <= REQUEST_MAX_BYTES else b"",
            at_s=time.monotonic(),
            refusal=self._refusal(message),
            response_topic=self._usable(getattr(properties, "ResponseTopic", "")),
            correlation=getattr(properties, "CorrelationData", None),
        )
        self._receive(received)

    def trouble(self) -> str:
        """Return why requests are not heard, or an empty string. May be called from any thread."""
        refused = self._refused
        if self._trouble or not refused:
            return self._trouble
        return describe_deafness(self._options, list(refused), next(iter(refused.values())))

    def _refusal(self, message: MQTTMessage) -> NoRequest | None:
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
