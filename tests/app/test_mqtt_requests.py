"""Requests that are messages, on their way to the loop and back, beside a messenger that only remembers."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from typing import Any

import pytest

from stadimeter.app.control.messages import FrameArgs, Reply
from stadimeter.app.control.mqtt_requests import AGE_MAX_S, PICTURE_MAX_BYTES, WAITING_MAX, MqttRequests
from stadimeter.cli.operate import _commands_lines
from stadimeter.messaging.protocol import CommandLevel, RequestMessage
from stadimeter.testing.rig import eventually


class RememberingMessenger:
    """Takes what it should send."""

    def __init__(self, commands: CommandLevel = "all") -> None:
        self.commands: CommandLevel = commands
        self.topics: Collection[str] = ()
        self.offered: Collection[str] = ()
        self.sent: list[tuple[str, Any]] = []
        self.pictures: list[bytes] = []
        self.is_connected = True

    def listen(
        self, topics: Collection[str], offered: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        self.topics, self.offered = topics, offered

    def respond(self, request: RequestMessage, topic: str, payload: bytes) -> None:
        self.sent.append((topic, json.loads(payload)))

    def show(self, topic: str, payload: bytes, content_type: str) -> bool:
        self.pictures += [payload] if self.is_connected else []
        return self.is_connected

    def deafness(self) -> str:
        return "" if self.is_connected else "the broker refused the subscription"


class Desk:
    """A messenger, and the requests that come over it."""

    def __init__(self) -> None:
        self.messenger = RememberingMessenger()
        self.told: list[str] = []
        self.now_s = 0.0
        self.picture = Reply({"width_px": 640}, attached=b"jpeg")
        self.requests = MqttRequests(self.messenger, self.take_picture, self.told.append, lambda: self.now_s)
        self.requests.open()

    def take_picture(self, _args: FrameArgs) -> Reply:
        return self.picture

    def send(self, action: str, payload: str = "{}", **more: Any) -> None:
        message = RequestMessage(topic=f"request/{action}", payload=payload.encode(), at_s=self.now_s, **more)
        self.requests.receive(message)

    def answers(self, count: int) -> list[Any]:
        eventually(lambda: len(self.messenger.sent) >= count)
        return [answer for _, answer in self.messenger.sent]

    def take(self, count: int = 1) -> Any:
        eventually(lambda: len(self.requests._asked) >= count)
        return self.requests.take()


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_what_needs_more_trust_is_listened_to_for_an_answer_and_offered_to_no_one():
    messenger = RememberingMessenger("alarms")
    requests = MqttRequests(messenger, lambda _: Reply(), lambda _: None)
    requests.open()
    assert set(messenger.topics) - set(messenger.offered) == {
        "request/arm", "request/clip", "request/confirm-mounting", "request/release-outputs", "request/record",
        "request/reload", "request/snapshot",
    }  # fmt: skip


def test_a_switch_sends_both_of_its_states_to_one_topic(desk):
    for topic, value in (("in-service", False), ("in-service", True), ("observed", True), ("observed", False)):
        desk.send(topic, json.dumps({"rule": "near", "value": value, "by": "zoe"}))
    taken = desk.take(4)
    assert [each.request.op for each in taken] == ["take-out", "put-back", "observe", "act"]
    assert {(each.request.args.rule, each.request.args.by) for each in taken} == {("near", "mqtt (zoe)")}


@pytest.mark.parametrize(
    "payload", ["", "[]", "{}", '{"value": 1}', '{"value": "true"}', "[" * 3000, '{"value": null}']
)
def test_a_switch_without_a_state_does_nothing(desk, payload):
    desk.send("observed", payload)
    (answer,) = desk.answers(1)
    assert answer["status"] == "error"
    assert '"value": true' in answer["error"]
    assert desk.requests.take() == []


def test_what_the_loop_takes_too_late_is_not_done(desk):
    desk.send("reset", '{"transaction": "old"}')
    eventually(lambda: desk.requests._asked)
    desk.now_s = AGE_MAX_S + 0.1
    desk.send("reset", '{"transaction": "new"}')
    (asked,) = desk.take(2)
    assert asked.request.transaction == "new"
    (answer,) = desk.answers(1)
    assert (answer["transaction"], answer["status"]) == ("old", "error")
    eventually(lambda: desk.requests.figures()["refused"] == {"stale": 1})


def test_no_more_than_a_few_of_an_action_wait_and_the_others_have_room(desk):
    for _ in range(WAITING_MAX + 5):
        desk.send("reset")
    desk.send("stop-outputs")
    taken = desk.take(WAITING_MAX + 1)
    assert [each.request.op for each in taken] == ["reset"] * WAITING_MAX + ["stop-outputs"]
    assert desk.requests.figures()["refused"] == {"too_many": 5}
    for each in taken:
        each.answer(Reply({"words": "done"}))
    eventually(lambda: desk.requests.figures()["done"] == WAITING_MAX + 1)
    desk.send("reset")
    assert len(desk.take()) == 1


def test_an_answer_that_cannot_be_put_into_words_is_an_error_and_costs_no_other_its_answer(desk):
    nan, long = Reply({"figure": float("nan")}), Reply({"words": "x" * 70_000})
    for reply in (nan, lambda: 1 / 0, long, Reply({"words": "done"})):
        desk.send("status")
        (asked,) = desk.take()
        asked.answer(reply)
    answers = desk.answers(4)
    assert [answer["status"] for answer in answers] == ["error", "error", "error", "ok"]
    assert "ZeroDivisionError" in answers[1]["error"]
    assert "too large for a message" in answers[2]["error"]


def test_a_picture_is_sent_if_there_is_one_and_the_connection_takes_it(desk):
    desk.send("snapshot")
    assert desk.answers(1)[0]["data"] == {"topic": "snapshot", "bytes": 4, "width_px": 640}
    desk.picture = Reply(error="there is no picture yet")
    desk.send("snapshot")
    assert desk.answers(2)[1]["error"] == "there is no picture yet"
    desk.picture = Reply({}, attached=bytes(PICTURE_MAX_BYTES + 1))
    desk.send("snapshot")
    assert "lower its quality" in desk.answers(3)[2]["error"]
    desk.picture, desk.messenger.is_connected = Reply({}, attached=b"jpeg"), False
    desk.send("snapshot")
    assert "does not take a picture" in desk.answers(4)[3]["error"]
    assert desk.messenger.pictures == [b"jpeg"]


def test_the_status_says_what_was_refused_and_why_commands_cannot_come(desk):
    assert [*_commands_lines(None)] == [*_commands_lines(desk.requests.figures())] == []
    desk.send("reset", refusal="retained")
    desk.send("reset", "PRESS")
    desk.answers(2)
    desk.messenger.is_connected = False
    assert [*_commands_lines(desk.requests.figures())] == [
        "commands over MQTT: the broker refused the subscription",
        "commands over MQTT: 0 done, refused: 1 retained, 1 invalid",
    ]
    desk.take(0)
    assert len(desk.told) == 1
    assert desk.told[0].startswith("warning: request/reset: a command that is kept by the broker")
