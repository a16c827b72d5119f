"""What a broker keeps of a run, and what Home Assistant discovers of it, over every connection."""

from __future__ import annotations

import math
import random
import threading
import time

from paho.mqtt.client import Client, MQTTMessage

from stadimeter.core.home_assistant import Announcement
from stadimeter.core.message import Message
from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import MqttSettings
from stadimeter.messaging.outbox import RetainedList
from stadimeter.messaging.send_queue import SendQueue

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
