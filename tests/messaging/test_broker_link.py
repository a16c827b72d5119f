"""What brokers may answer that ours never does: a listener that plays a script, byte by byte."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial

import pytest

from stadimeter.core.message import Message
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.messaging.protocol import Patience
from stadimeter.testing.rig import eventually
from support.broker import HOST

CONNECT_VERSION_AT = 8
ACCEPTED_311 = b"\x20\x02\x00\x00"
ACCEPTED_5 = b"\x20\x03\x00\x00\x00"
NO_SUCH_VERSION = b"\x20\x02\x00\x01"
BANNED_5 = b"\x20\x03\x00\x8a\x00"
# With a reason string: paho 2.1 passes over the reason of a DISCONNECT that holds nothing else.
TAKEN_OVER_5 = b"\xe0\x07\x8e\x05\x1f\x00\x02no"
SHUTTING_DOWN_5 = b"\xe0\x07\x8b\x05\x1f\x00\x02no"

MakeMessenger = Callable[..., PahoMessenger]


class ScriptedBroker:
    """Answers the first bytes of each connection with the next line of its script; the last line is for all others.

    A line is what it answers, and whether it then hangs up.
    """

    def __init__(self, script: list[tuple[bytes, bool]]) -> None:
        self.greetings: list[bytes] = []
        self._script = script
        self._listener = socket.create_server((HOST, 0))
        self.port = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        for one in (*self._open, self._listener):
            one.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.settimeout(10.0)
            self._open.append(connection)
            with suppress(OSError):  # the client may hang up first
                self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        self.greetings.append(connection.recv(4096))
        answer, hangs_up = self._script[min(len(self.greetings), len(self._script)) - 1]
        connection.sendall(answer)
        if hangs_up:
            connection.shutdown(socket.SHUT_RDWR)

    @property
    def versions(self) -> list[int]:
        return [greeting[CONNECT_VERSION_AT] for greeting in self.greetings]


@pytest.fixture
def make_messenger(make_messenger: MakeMessenger) -> MakeMessenger:
    """Return the function that makes messengers, which do not wait long for what the script never acknowledges."""
    return partial(make_messenger, goodbye_s=0.2)


@pytest.fixture
def play() -> Iterator[Callable[..., ScriptedBroker]]:
    with ExitStack() as closing:

        def start(*script: tuple[bytes, bool]) -> ScriptedBroker:
            broker = ScriptedBroker(list(script))
            closing.callback(broker.close)
            return broker

        yield start


@pytest.mark.parametrize("answer", [(NO_SUCH_VERSION, True), (b"", True), (b"", False)])
def test_a_broker_that_refuses_mqtt_5_or_hangs_up_or_never_answers_it_is_spoken_to_in_311(answer, play, make_messenger):
    broker = play(answer, (ACCEPTED_311, False))
    messenger = make_messenger(broker.port, answer_s=0.3 if answer == (b"", False) else 10.0)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    assert broker.versions[:2] == [5, 4]


def test_a_version_that_is_set_is_never_changed(play, make_messenger):
    broker = play((NO_SUCH_VERSION, True))
    messenger = make_messenger(broker.port, protocol="5")
    messenger.open()
    eventually(lambda: "does not speak MQTT 5; set protocol to 'auto'" in messenger.trouble())
    eventually(lambda: len(broker.greetings) >= 3)
    assert set(broker.versions) == {5}


def test_a_version_that_worked_is_kept_when_the_broker_hangs_up_later(play, make_messenger):
    broker = play((ACCEPTED_5, True), (b"", True), (b"", True), (ACCEPTED_5, False))
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: len(broker.greetings) == 4 and not messenger.trouble())
    assert broker.versions == [5, 5, 5, 5]


def test_both_versions_are_tried_in_turn_while_neither_is_answered(play, make_messenger):
    broker = play((b"", True))
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: "hung up without an answer" in messenger.trouble())
    eventually(lambda: len(broker.greetings) >= 4)
    assert broker.versions[:4] == [5, 4, 5, 4]


@pytest.mark.parametrize(
    ("greeting", "hangs_up"),
    [
        (b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\n\r\n" + b"x" * 200, True),
        (bytes(200), False),
        (bytes(range(1, 200)), False),
        (b"\xff" * 200, True),
    ],
)
def test_a_server_that_is_no_broker_is_said_in_words(greeting, *, hangs_up, play, make_messenger):
    broker = play((greeting, hangs_up))
    messenger = make_messenger(broker.port, answer_s=0.2)
    messenger.open()
    words = eventually(lambda: "trying again" in messenger.trouble() and messenger.trouble())
    assert words.startswith(f"127.0.0.1:{broker.port} ")
    assert "answer" in words


def test_any_other_refusal_is_said_in_the_brokers_words(play, make_messenger):
    messenger = make_messenger(play((BANNED_5, True)).port)
    messenger.open()
    eventually(lambda: "refused the client 'stadimeter-it' (Banned)" in messenger.trouble())


def test_a_broker_that_says_why_it_goes_is_quoted(play, make_messenger):
    broker = play((ACCEPTED_5 + SHUTTING_DOWN_5, True), (b"", False))
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: "ended the connection (Server shutting down)" in messenger.trouble())


def test_after_a_take_over_the_longest_pause_is_kept(play, make_messenger):
    messenger = make_messenger(play((ACCEPTED_5 + TAKEN_OVER_5, True)).port)
    messenger.open()
    words = eventually(lambda: "another program uses the client id 'stadimeter-it'" in messenger.trouble())
    assert words
    eventually(lambda: messenger.trouble().endswith("give each its own node; trying again in 0.2 s"))


@pytest.mark.long
def test_no_pause_is_longer_than_an_alarm_may_wait(play):
    broker = play((BANNED_5, True))
    patience = Patience(first_pause_s=60.0, alarm_pause_s=0.1)
    messenger = PahoMessenger(MqttOptions(port=broker.port, node="it"), patience)
    messenger.open()
    eventually(lambda: messenger.trouble().endswith("trying again in 60 s"))
    assert len(broker.greetings) == 1
    messenger.publish(Message(topic="event/alarm", payload="raised", qos=1))
    eventually(lambda: messenger.trouble().endswith("trying again in 0.1 s"))
    eventually(lambda: len(broker.greetings) > 3)
    messenger.close()
    assert len(messenger.undelivered()) == 1


def test_a_broker_is_told_how_little_we_read(play, make_messenger):
    broker = play((ACCEPTED_5, False))
    make_messenger(broker.port, protocol="5").open()
    (greeting,) = eventually(lambda: broker.greetings)
    assert b"\x27" + (256 * 1024).to_bytes(4, "big") in greeting  # property 39, maximum packet size


def test_closing_in_the_middle_of_a_pause_does_not_wait_for_its_end(play, make_messenger):
    messenger = make_messenger(play((BANNED_5, True)).port)
    messenger.open()
    eventually(lambda: "trying again" in messenger.trouble())
    messenger.close()
    assert messenger.trouble().endswith("is not open")


def test_closing_while_the_broker_has_not_answered_yet_returns(play, make_messenger):
    broker = play((b"", False))
    messenger = make_messenger(broker.port, answer_s=60.0)
    messenger.open()
    eventually(lambda: broker.greetings)
    messenger.close()
    assert messenger.trouble().endswith("is not open")
