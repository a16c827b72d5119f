"""Messages between the threads that publish and the thread of a link, which alone speaks to paho."""

from __future__ import annotations

import os
import select
import threading
import time
from collections import deque
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode

from stadimeter.core.message import AVAILABILITY, RETAINED, Message
from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import publish_properties
from stadimeter.messaging.outbox import DirectMessage, MemoryOutbox, PendingMessage, pending

# So many messages may lie between the threads. The thread that publishes more puts them into the outbox itself, within
# its bounds: the link's thread may wait for a name server for minutes.
INCOMING_MAX = 50

# First levels of the topics of the link's own messages. A later run does not send them again.
_OURS = frozenset({AVAILABILITY.first_level, RETAINED.first_level})

# Room in a packet for what is neither payload nor topic.
_HEADER_BYTES = 512


class SendQueue:
    """Takes messages from any thread at once, and hands them to paho in the link's.

    The thread that publishes only lays a message down and wakes the link's thread, once for all that it finds then.
    Packing a message takes paho ten times as long. The lock is never held while paho is called.

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
        self._incoming: deque[tuple[Message, float]] = deque()
        self._lock = threading.Lock()  # of the outbox, and of taking from `_incoming`
        self._outbox = MemoryOutbox()
        self._is_woken = False
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def __del__(self) -> None:
        """Close the bell; every thread that has the queue may ring it until then."""
        os.close(self._bell)

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were dropped, and of states of QoS 1 that were replaced unsent."""
        with self._lock:
            self._take_in()
            return self._outbox.dropped

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 that were given up. It is asked for in every cycle, and so it takes no lock."""
        return self._outbox.given_up

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        with self._lock:
            self._take_in()
            undelivered = self._outbox.undelivered()
        return tuple([each for each in undelivered if not (each.topic.partition("/")[0] in _OURS or each.is_absolute)])

    def send(self, message: Message) -> None:
        """Send a message, or let it wait (QoS 1), or drop and count it (QoS 0). Returns at once."""
        self._incoming.append((message, time.monotonic()))
        if len(self._incoming) > INCOMING_MAX:
            with self._lock:
                self._take_in()
        if self.is_connected:
            self.wake()

    def send_now(self, message: DirectMessage, packet_max: int | None) -> bool:
        """Send a message, or drop and count it; return whether the connection can take it. Returns at once."""
        size = len(message.content) + len(message.topic.encode()) + _HEADER_BYTES
        with self._lock:
            self._take_in()
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
        """Note that there is a connection; what was of use before it only is dropped."""
        with self._lock:
            self._take_in()
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
            self._take_in()
            for number, is_refused in self._events.take_done():
                self._outbox.done(number, is_refused=is_refused)
            return self._outbox.is_empty

    def _take(self) -> PendingMessage | None:
        with self._lock:
            self._take_in()
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

    # With the lock held.

    def _take_in(self) -> None:
        while self._incoming:
            message, at_s = self._incoming.popleft()
            if message.qos or self.is_connected:
                self._outbox.add(message, at_s)
            else:
                self._outbox.drop()
