"""What paho tells of the connection to a broker."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from typing import Any

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
from paho.mqtt.reasoncodes import ReasonCode

from stadimeter.messaging import mqtt_words as words
from stadimeter.messaging.mqtt_options import MqttOptions

STABLE_S = 10.0
"""A connection that ends sooner is not taken for a sign that all is well."""
SUSPICIOUS = 3
"""After so many connections in a row that ended soon, two programs with one name are suspected."""


class LinkEvents:
    """Collects what paho's callbacks tell, without a lock.

    All callbacks come in the link's thread, within paho's loop, and so does every call here, save that `take_done`
    and `refusal` may be used by any thread.

    Attributes:
        ending: Why the newest attempt to connect failed, or the connection ended, in words.
        suspects_version: Whether the broker seems not to speak the version of MQTT that was tried.
        was_taken_over: Whether another program with our client id took our place.
        refusal: Why the broker would not take a message over this connection, in words.
    """

    def __init__(self, options: MqttOptions) -> None:
        self._options = options
        self._done: deque[tuple[int, bool]] = deque()
        self._short_lives = 0
        self._was_ever_accepted = False
        self.refusal = ""
        self.begin()

    def begin(self) -> None:
        """Forget the last attempt to connect; another begins."""
        self.ending = ""
        self.suspects_version = False
        self.was_taken_over = False
        self._accepted_at_s: float | None = None
        self._stood_s = 0.0

    @property
    def is_accepted(self) -> bool:
        """Whether the broker accepted us in this attempt."""
        return self._accepted_at_s is not None

    @property
    def was_stable(self) -> bool:
        """Whether the connection that ended had stood for a good while."""
        return self._stood_s > STABLE_S

    def listen_to(self, client: Client) -> None:
        """Have a client tell us."""
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish

    def could_not_connect(self, error: OSError) -> None:
        """Note that there is no connection at all."""
        self.ending = words.unreachable(self._options, error)

    def no_answer_came(self) -> None:
        """Note that the broker took the connection and then said nothing."""
        self.ending = words.silent(self._options, had_answered=False)
        self.suspects_version = not self._was_ever_accepted

    def bomb_came(self) -> None:
        """Note that the other side announced more than a broker has to say to us."""
        if not self.is_accepted:
            self.nonsense_came()
        else:
            self.ending = words.too_much(self._options)

    def nonsense_came(self) -> None:
        """Note that the other side sent what is not MQTT."""
        self.ending = words.no_broker(self._options)
        self.suspects_version = not self._was_ever_accepted

    def take_done(self) -> Iterator[tuple[int, bool]]:
        """Yield, once each, the messages that were written (QoS 0) or answered (QoS 1): number, and if refused."""
        while self._done:
            yield self._done.popleft()

    def _on_connect(self, _client: Client, _data: Any, _flags: ConnectFlags, reason: ReasonCode, _more: Any) -> None:
        if reason.is_failure:
            self.ending = words.refused(self._options, reason)
            self.suspects_version = reason.value == words.UNSUPPORTED_VERSION
            return
        self._accepted_at_s = time.monotonic()
        self._was_ever_accepted = True
        self.refusal = ""

    def _on_disconnect(
        self, _client: Client, _data: Any, flags: DisconnectFlags, reason: ReasonCode, _more: Any
    ) -> None:
        if self._accepted_at_s is not None:
            self._stood_s = time.monotonic() - self._accepted_at_s
            self._short_lives = 0 if self.was_stable else self._short_lives + 1
        if self.ending:
            return
        guess = words.shared_name(self._options) if self._short_lives >= SUSPICIOUS else ""
        if flags.is_disconnect_packet_from_server:
            self.was_taken_over = reason.value == words.TAKEN_OVER
            self.ending = words.sent_away(self._options, reason) + ("" if self.was_taken_over else guess)
            return
        self.suspects_version = not self._was_ever_accepted
        self.ending = words.broke_off(self._options, reason, had_answered=self.is_accepted) + guess

    def _on_publish(self, _client: Client, _data: Any, number: int, reason: ReasonCode, _more: Any) -> None:
        if reason.is_failure:
            self.refusal = words.would_not_take(self._options, reason)
        self._done.append((number, reason.is_failure))
