"""One connection to a broker, kept up by a thread."""

from __future__ import annotations

import math
import random
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import MQTTException  # type: ignore[attr-defined] # paho 2.1 and 2.2 both have it there

from stadimeter.core.home_assistant import Announcement
from stadimeter.core.message import Message
from stadimeter.messaging.back_off import BackOff, Patience
from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import (
    OFFLINE,
    ONLINE,
    MqttSettings,
    OversizedPacketError,
    Secrets,
    make_client,
    say_goodbye,
)
from stadimeter.messaging.outbox import DirectMessage, RetainedList
from stadimeter.messaging.request_topics import RequestTopics
from stadimeter.messaging.send_queue import SendQueue

# What a broker keeps of a run, and what Home Assistant discovers of it, over every connection -------

# Time after the confirmed subscription within which every page of the list of retained topics arrives.
LIST_ENDS_S = 0.5

# Home Assistant asks devices to answer its start after a time at random, so that not all do at once.
BIRTH_SPREAD_S = 5.0


class RetainedTopics:
    """Reads the list of retained topics, has cleared what is gone, and announces this node to Home Assistant.

    `retain_only`, `announce` and what is taken may be called in any thread, all else in the link's.

    Attributes:
        is_reading: Whether pages of the list may still come.
    """

    def __init__(self, options: MqttSettings, queue: SendQueue) -> None:
        self._options = options
        self._queue = queue
        self._lock = threading.Lock()
        self._list = RetainedList(options.retained_topic, options.retained_page_bytes, options.node)
        self._topic = f"{options.base}/{options.retained_topic}/+"
        self._is_to_begin = False
        self.is_reading = False
        self._subscription: int | None = None
        self._birth_due_s = math.inf
        self._was_connected = False
        self._are_states_due = self._is_forgotten = False

    def retain_only(self, topics: frozenset[str]) -> None:
        """Take on which topics messages are published for the broker to keep; see `RetainedList`."""
        with self._lock:
            self._send(self._list.retain_only(topics))
            if not self.is_reading and not self._list.is_read:
                self._is_to_begin = True  # a broker may answer before a run knows what it publishes
        self._queue.wake()

    def announce(self, announcement: Announcement | None) -> None:
        """Have Home Assistant discover this from now on, and no more what was announced before."""
        with self._lock:
            self._send(self._list.announce(announcement))
            if self._queue.is_connected and not self.is_reading and not self._list.is_read:
                self._send(self._list.announced())

    def take_states_due(self) -> bool:
        """Return, once each time, whether Home Assistant or the broker began anew, and may know no states."""
        if not self._are_states_due:
            return False
        self._are_states_due = False
        return True

    def take_forgotten(self) -> bool:
        """Return, once each time, whether the list that this run had written is not there any more."""
        is_forgotten, self._is_forgotten = self._is_forgotten, False
        return is_forgotten

    def begin_over(self, client: Client, events: LinkEvents) -> None:
        """Begin anew over a connection, unless an oversized packet came that way before."""
        self._are_states_due, self._was_connected = self._was_connected, True
        self._is_to_begin = True
        if self._options.discovery_place is not None and not events.oversized_packets:
            events.handlers[self._options.birth_topic] = self._on_birth
            client.subscribe(self._options.birth_topic, qos=0)

    def end(self) -> None:
        """Forget what was read over a connection that is no more."""
        with self._lock:
            self.is_reading = False
            self._list.begin()

    def attend(self, client: Client, events: LinkEvents) -> None:
        """Do what is due."""
        with self._lock:
            is_to_begin, self._is_to_begin = self._is_to_begin, False
            if is_to_begin:
                self.is_reading = self._list.is_wanted and not events.oversized_packets
                if not self.is_reading:
                    self._send(self._list.announced())
            if time.monotonic() >= self._birth_due_s:
                self._birth_due_s, self._are_states_due = math.inf, True
                self._send(self._list.announced())
        if is_to_begin and self.is_reading:
            _, self._subscription = client.subscribe(self._topic, qos=0)
        elif self.is_reading:
            self.read(client, events)

    def read(self, client: Client, events: LinkEvents, *, is_last: bool = False) -> None:
        """Take in pages; when all have come, clear what is no longer published, and write the list anew."""
        subscribed_at_s = events.subscribed_at_s.get(self._subscription)
        is_over = subscribed_at_s is not None and (is_last or time.monotonic() - subscribed_at_s >= LIST_ENDS_S)
        with self._lock:
            for number, payload in events.take_pages():
                self._list.hear(number, payload)
            if not is_over:
                return
            self.is_reading = False
            self._is_forgotten = self._is_forgotten or self._list.is_forgotten
            self._send(self._list.finish())
        client.unsubscribe(self._topic)

    def _on_birth(self, message: MQTTMessage) -> None:
        if message.payload == b"online" and not message.retain:
            self._birth_due_s = time.monotonic() + random.uniform(0.0, BIRTH_SPREAD_S)  # noqa: S311 - no secret

    def _send(self, messages: tuple[Message, ...]) -> None:
        for message in messages:
            self._queue.send(message)


# ----------------------------------------------------------------------------------------------------

# Interval, during a pause, of looking for messages of QoS 1, which shorten the pause.
LOOK_EVERY_S = 0.5

V5, V311 = MQTTProtocolVersion.MQTTv5, MQTTProtocolVersion.MQTTv311


def serve(loop: Callable[[float], MQTTErrorCode], events: LinkEvents, wait_s: float) -> bool:
    """Let paho read and write by a loop of its client; return whether the connection still stands."""
    try:
        return loop(wait_s) == MQTTErrorCode.MQTT_ERR_SUCCESS
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

    paho is called in the link's thread only, and nowhere with a lock held: no other thread ever waits for it.

    Args:
        requests: Where other programs ask for something; None for nowhere.

    Attributes:
        queue: What is to be sent.
        retained: What the broker keeps, and what Home Assistant discovers.
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
        self._why_not = f"not connected to {options.place} yet"
        self._version = V311 if options.protocol == "3.1.1" else V5
        self._client = self._new_client()
        self.queue = SendQueue(options.base, self._events)
        self.retained = RetainedTopics(options, self.queue)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def send_now(self, topic: str, payload: bytes, content_type: str, correlation: bytes | None = None) -> bool:
        """Send to a topic that is not below the base, with QoS 0, or drop and count it. Returns at once."""
        message = DirectMessage(topic=topic, content=payload, content_type=content_type, correlation=correlation)
        return self.queue.send_now(message, self._events.packet_max)

    def deafness(self) -> str:
        """Return why requests are not heard although there is a connection, or an empty string."""
        return self._requests.trouble() if self._requests is not None and self.queue.is_connected else ""

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
        return LIST_ENDS_S / 4 if self.retained.is_reading else 1.0

    def _loop(self, wait_s: float) -> bool:
        return serve(partial(self.queue.loop, self._client), self._events, wait_s)

    def _take_stock(self) -> None:
        """Act on what paho's callbacks and other threads left for us."""
        self.queue.note_done()
        if not self._events.is_accepted or self._stopping.is_set():
            return
        if not self.queue.is_connected:
            self._hand_over(ONLINE)
            self.retained.begin_over(self._client, self._events)
            if self._requests is not None:
                self._requests.begin_over(self._events, is_v5=self._version == V5)
            self.queue.connect()
        self.retained.attend(self._client, self._events)
        if self._requests is not None:
            self._requests.attend(self._client, self._events)
        self._hand_over()

    def _hand_over(self, *first: Message) -> None:
        self.queue.hand_over(self._client, *first, is_v5=self._version == V5)

    def _say_goodbye(self) -> None:
        """Disconnect in order if all was delivered; without that, the broker will publish our last will."""
        if self.retained.is_reading:
            self.retained.read(self._client, self._events, is_last=True)
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
        return self._back_off.spread_s(pause_s)

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
