"""One connection to a broker, kept up by a thread."""

from __future__ import annotations

import math
import random
import socket
import struct
import threading
import time
from contextlib import suppress

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import MQTTException  # type: ignore[attr-defined] # paho 2.1 and 2.2 both have it there

from stadimeter.core.home_assistant import Announcement
from stadimeter.core.message import Message
from stadimeter.messaging.back_off import BackOff, Patience
from stadimeter.messaging.link_events import Handler, LinkEvents
from stadimeter.messaging.mqtt_client import (
    OFFLINE,
    ONLINE,
    MqttSettings,
    OversizedPacketError,
    Secrets,
    make_client,
    publish_properties,
    response_properties,
    say_goodbye,
)
from stadimeter.messaging.outbox import MemoryOutbox, PendingMessage, RetainedList, pending
from stadimeter.messaging.request_topics import RequestTopics

# Interval, during a pause, of looking for messages of QoS 1, which shorten the pause.
LOOK_EVERY_S = 0.5

V5, V311 = MQTTProtocolVersion.MQTTv5, MQTTProtocolVersion.MQTTv311

# Time after the confirmed subscription within which every page of the list of retained topics arrives.
LIST_ENDS_S = 0.5

# Home Assistant asks devices to answer its start after a time at random, so that not all do at once.
BIRTH_SPREAD_S = 5.0

# First words of the topics of the link's own messages. A later run does not send them again.
_OURS = ("availability", "retained/")


def serve(client: Client, events: LinkEvents, wait_s: float) -> bool:
    """Let paho read and write; return whether the connection still stands."""
    try:
        return client.loop(wait_s) == MQTTErrorCode.MQTT_ERR_SUCCESS
    except OversizedPacketError:
        events.note_oversized_packet()
        return False
    except (LookupError, TypeError, ValueError, struct.error, MQTTException):  # from paho 2.1, and not caught there
        events.note_nonsense()
        return False


class BrokerLink:
    """Connects, connects again, and says what is wrong meanwhile. It serves from `start` to `stop`, once.

    paho's own thread (``loop_start``) is not used. With paho 2.2, ``loop_stop`` joins it without a time limit: 4.5 s
    while a host does not answer, where the end of a run allows 0.6 s. ``on_connect_fail`` gives no reason, and the
    version of MQTT, the pause while an alarm waits and the list of retained topics would need a second thread.

    Args:
        requests: Where other programs ask for something; None for nowhere.
    """

    def __init__(
        self, options: MqttSettings, secrets: Secrets, patience: Patience, requests: RequestTopics | None = None
    ) -> None:
        self._options = options
        self._requests = requests
        self._secrets = secrets
        self._patience = patience
        self._back_off = BackOff(patience)
        self._events = LinkEvents(options, requests.hear) if requests is not None else LinkEvents(options)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)

        # Shared, behind the lock. It is held while paho is called, so nothing that paho calls may take it: paho calls
        # with a lock of its own held, which publishing needs as well. That is why `LinkEvents` knows no lock.
        self._lock = threading.Lock()
        self._outbox = MemoryOutbox()
        self._is_connected = False
        self._why_not = f"not connected to {options.place} yet"
        self._version = V311 if options.protocol == "3.1.1" else V5
        self._client = self._new_client()
        self._retained = RetainedList(options.retained_topic, options.retained_page_bytes, options.node)
        self._is_reading = False
        self._list_subscription: int | None = None
        self._subscriptions: dict[str, int] = {}
        self._birth_due_s = math.inf
        self._was_connected = False
        self._are_states_due = False
        if options.discovery_place is not None:
            self.subscribe(options.birth_topic, self._on_birth)

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were dropped."""
        with self._lock:
            return self._outbox.dropped

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 that were given up."""
        with self._lock:
            return self._outbox.given_up

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        with self._lock:
            undelivered = self._outbox.undelivered()
        return tuple([each for each in undelivered if not (each.topic.startswith(_OURS) or each.is_absolute)])

    def subscribe(self, topic: str, handler: Handler, qos: int = 0) -> None:
        """Hear a topic, without wildcards, over every connection that begins from now on."""
        self._events.handlers[topic] = handler
        self._subscriptions[topic] = qos

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def send(self, message: Message) -> None:
        """Send a message, or let it wait (QoS 1), or drop and count it (QoS 0). Returns at once."""
        with self._lock:
            if message.qos:
                self._outbox.add(message, time.monotonic())
                self._send_waiting()
            elif self._is_connected and self._outbox.has_room_on_wire:
                self._publish(message)
            else:
                self._outbox.drop()

    def send_now(self, topic: str, payload: bytes, content_type: str, correlation: bytes | None = None) -> bool:
        """Send to a topic that is not below the base, with QoS 0, or drop and count it. Returns at once."""
        with self._lock:
            room_bytes = self._events.packet_max
            if not self._is_connected or (room_bytes and len(payload) + len(topic.encode()) + 512 > room_bytes):
                self._outbox.drop()
                return False
            if not self._outbox.has_room_on_wire:
                self._outbox.drop()
                return False
            properties = response_properties(content_type, correlation) if self._version == V5 else None
            info = self._client.publish(topic, payload, 0, properties=properties)
            if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
                self._outbox.drop()
                return False
            self._outbox.sent(info.mid, pending(Message(topic=topic, payload=""), time.monotonic()))
            return True

    def deafness(self) -> str:
        """Return why requests are not heard although there is a connection, or an empty string."""
        with self._lock:
            return self._requests.trouble() if self._requests is not None and self._is_connected else ""

    def retain_only(self, topics: frozenset[str]) -> None:
        """Take on which topics messages are published for the broker to keep; see `RetainedList`."""
        with self._lock:
            self._send_ours(self._retained.retain_only(topics))
            if self._is_connected and not self._is_reading and not self._retained.is_read:
                self._begin_to_read()  # a broker may answer before a run knows what it publishes

    def announce(self, announcement: Announcement | None) -> None:
        """Have Home Assistant discover this from now on, and no more what was announced before."""
        with self._lock:
            self._send_ours(self._retained.announce(announcement))
            if self._is_connected and not self._is_reading and not self._retained.is_read:
                self._send_ours(self._retained.announced())

    def take_states_due(self) -> bool:
        """Return, once each time, whether Home Assistant or the broker began anew, and may know no states."""
        with self._lock:
            is_due, self._are_states_due = self._are_states_due, False
        return is_due

    def trouble(self) -> str:
        """Return in words what is wrong, or an empty string."""
        with self._lock:
            return self._events.refusal if self._is_connected else self._why_not

    def stop(self) -> None:
        """Say goodbye, wait a moment at most for what is on its way, and end. What is left over is `undelivered`."""
        with self._lock:
            self._stopping.set()
            if self._is_connected:
                self._publish(OFFLINE)  # wakes the thread, too
            else:
                self._client.disconnect()
        self._thread.join(
            2 * self._patience.goodbye_s
        )  # a look-up of a name may keep it longer; it then ends by itself

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
            longest_s = min(pause_s, self._patience.alarm_pause_s) if self.undelivered() else pause_s
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
        with self._lock:
            self._is_connected = self._is_reading = False
            self._retained.begin()
            self._note_done()
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
        return LIST_ENDS_S / 4 if self._is_reading else 1.0

    def _loop(self, wait_s: float) -> bool:
        return serve(self._client, self._events, wait_s)

    def _take_stock(self) -> None:
        """Act on what paho's callbacks left for us."""
        with self._lock:
            self._note_done()
            if not self._events.is_accepted or self._stopping.is_set():
                return
            if not self._is_connected:
                self._is_connected, self._are_states_due = True, self._was_connected
                self._was_connected = True
                self._publish(ONLINE)
                self._subscribe()
                self._begin_to_read()
                if self._requests is not None:
                    self._requests.begin_over(self._events, is_v5=self._version == V5)
            elif self._is_reading:
                self._read()
            if self._requests is not None:
                self._requests.attend(self._client, self._events)
            if time.monotonic() >= self._birth_due_s:
                self._birth_due_s, self._are_states_due = math.inf, True
                self._send_ours(self._retained.announced())
            self._send_waiting()

    def _on_birth(self, message: MQTTMessage) -> None:
        if message.payload == b"online" and not message.retain:
            self._birth_due_s = time.monotonic() + random.uniform(0.0, BIRTH_SPREAD_S)  # noqa: S311 - no secret

    def _say_goodbye(self) -> None:
        """Disconnect in order if all was delivered; without that, the broker will publish our last will."""
        if self._is_reading:
            with self._lock:
                self._read(is_last=True)
        until_s = time.monotonic() + self._patience.goodbye_s
        delivered = not self._is_connected
        while not delivered and time.monotonic() < until_s and self._loop(0.05):
            with self._lock:
                self._note_done()
                self._send_waiting()
                delivered = self._outbox.is_empty
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

    # With the lock held.

    def _subscribe(self) -> None:
        """Subscribe to what has handlers, unless an oversized packet came that way before."""
        if self._subscriptions and not self._events.oversized_packets:
            self._client.subscribe(list(self._subscriptions.items()))

    def _begin_to_read(self) -> None:
        """Subscribe to the list of retained topics, unless an oversized packet came that way before."""
        if self._retained.is_wanted and not self._events.oversized_packets:
            topic = f"{self._options.base}/{self._options.retained_topic}/+"
            _, self._list_subscription = self._client.subscribe(topic, qos=0)
            self._is_reading = True
        else:
            self._send_ours(self._retained.announced())

    def _read(self, *, is_last: bool = False) -> None:
        """Take in pages; when all have come, clear what is no longer published, and write the list anew."""
        for number, payload in self._events.take_pages():
            self._retained.hear(number, payload)
        subscribed_at_s = self._events.subscribed_at_s.get(self._list_subscription)
        if subscribed_at_s is None or (not is_last and time.monotonic() - subscribed_at_s < LIST_ENDS_S):
            return
        self._is_reading = False
        self._client.unsubscribe(f"{self._options.base}/{self._options.retained_topic}/+")
        self._send_ours(self._retained.finish())

    def _send_ours(self, messages: tuple[Message, ...]) -> None:
        for message in messages:
            self._outbox.add(message, time.monotonic())
        self._send_waiting()

    def _send_waiting(self) -> None:
        while self._is_connected and (waiting := self._outbox.take(time.monotonic())):
            self._hand_over(waiting)

    def _publish(self, message: Message) -> None:
        self._hand_over(pending(message, time.monotonic()))

    def _hand_over(self, waiting: PendingMessage) -> None:
        message = waiting.on_wire(time.monotonic())
        is_v5 = self._version == V5
        info = self._client.publish(
            message.topic if message.is_absolute else f"{self._options.base}/{message.topic}",
            message.payload,
            message.qos,
            # Without the expiry of MQTT 5 a broker would show a stale value to newcomers for ever.
            retain=message.retain and (is_v5 or message.expires_s is None),
            properties=publish_properties(message) if is_v5 else None,
        )
        if message.qos == 0 and info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._outbox.drop()
        else:
            self._outbox.sent(info.mid, waiting)

    def _note_done(self) -> None:
        for number, is_refused in self._events.take_done():
            self._outbox.done(number, is_refused=is_refused)

    def _pause_s(self) -> float:
        """Say why there is no connection, and return for how long to rest."""
        if self._events.was_stable:
            self._back_off.reset()
        if self._events.was_taken_over:
            self._back_off.jump_to_longest()
        pause_s = self._back_off.next_s()
        if self.undelivered():
            pause_s = min(pause_s, self._patience.alarm_pause_s)
        with self._lock:
            self._why_not = f"{self._events.ending}; trying again in {pause_s:.3g} s"
        return self._back_off.spread_s(pause_s)

    def _change_version(self) -> bool:
        """Try the other version if the broker seems not to speak this one; return whether it was changed."""
        if self._options.protocol != "auto" or not self._events.suspects_version:
            return False
        with self._lock:
            self._version = V5 if self._version == V311 else V311
            self._start_over()
        return True

    def _start_over(self) -> None:
        """Begin with a new client: paho would send its own copies again, and those do not say that they are late."""
        self._client = self._new_client()
        self._outbox.start_over()

    def _new_client(self) -> Client:
        client = make_client(self._options, self._secrets, self._version, self._patience.answer_s)
        self._events.listen_to(client)
        # With this set, publishing only queues and wakes our thread, and does not write from the caller's.
        client.on_socket_register_write = lambda *_: None
        return client
