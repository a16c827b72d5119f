from __future__ import annotations

from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.message import Message
from stadimeter.messaging.outbox import MemoryOutbox


def alert(payload: object, expires_s: int | None = None) -> Message:
    return Message(topic="event/alarm", payload=str(payload), qos=1, expires_s=expires_s)


def state(payload: object) -> Message:
    return Message(topic="target/ball/state", payload=str(payload))


def taken(outbox: MemoryOutbox, now_s: float = 0.0) -> Iterator[Message]:
    while message := outbox.take(now_s):
        yield message
        outbox.sent(int(message.payload), message, now_s)


def payloads(outbox: MemoryOutbox, now_s: float = 0.0) -> list[str]:
    return [message.payload for message in taken(outbox, now_s)]


def test_no_more_than_the_window_is_on_the_wire() -> None:
    outbox = MemoryOutbox(window=2)
    for number in range(4):
        outbox.add(alert(number), 0.0)
    assert payloads(outbox) == ["0", "1"]
    outbox.done(0)
    assert payloads(outbox) == ["2"]


def test_a_full_outbox_gives_up_its_oldest_message_and_counts_it() -> None:
    outbox = MemoryOutbox(capacity=2)
    for number in range(3):
        outbox.add(alert(number), 0.0)
    assert (payloads(outbox), outbox.given_up) == (["1", "2"], 1)


def test_a_full_outbox_drops_a_state_that_a_newer_one_replaced_before_it_gives_up_an_alarm() -> None:
    outbox = MemoryOutbox(capacity=3)
    first, second = (Message(topic="rule/near/state", payload=each, qos=1, retain=True) for each in ("100", "101"))
    for message in (alert(0), first, second, alert(1)):
        outbox.add(message, 0.0)
    assert outbox.undelivered() == (alert(0), second, alert(1))
    assert (outbox.given_up, outbox.dropped) == (0, 1)
    outbox.add(alert(2), 0.0)
    assert outbox.undelivered() == (second, alert(1), alert(2))
    assert (outbox.given_up, outbox.dropped) == (1, 1)


def test_a_message_that_waited_too_long_is_dropped_and_a_younger_one_keeps_what_is_left_of_its_life() -> None:
    outbox = MemoryOutbox()
    outbox.add(alert(0, expires_s=2), 100.0)
    outbox.add(alert(1, expires_s=10), 100.0)
    (message,) = taken(outbox, 103.5)
    assert (message.payload, message.expires_s, outbox.given_up) == ("1", 7, 1)


def test_a_message_that_expires_right_now_is_not_sent_with_an_expiry_of_zero() -> None:
    outbox = MemoryOutbox()
    outbox.add(alert(0, expires_s=2), 100.0)
    assert payloads(outbox, 102.0) == []


def test_messages_of_qos_0_that_were_not_written_are_lost_with_the_connection() -> None:
    outbox = MemoryOutbox(unwritten_max=2)
    for number in range(2):
        assert outbox.has_room_on_wire
        outbox.sent(number, state(number), 0.0)
    assert not outbox.has_room_on_wire
    outbox.done(0)
    outbox.connection_lost()
    assert (outbox.dropped, outbox.has_room_on_wire, outbox.is_empty) == (1, True, True)


def test_starting_over_sends_everything_again_in_the_same_order() -> None:
    outbox = MemoryOutbox(window=3)
    for number in range(5):
        outbox.add(alert(number), 0.0)
    assert payloads(outbox) == ["0", "1", "2"]
    outbox.done(1)
    outbox.start_over()
    assert payloads(outbox) == ["0", "2", "3"]


def test_what_is_on_the_wire_and_what_waits_is_undelivered_until_it_is_answered() -> None:
    outbox = MemoryOutbox(window=2)
    for number in range(3):
        outbox.add(alert(number), 0.0)
    assert payloads(outbox) == ["0", "1"]
    assert outbox.undelivered() == (alert(0), alert(1), alert(2))
    outbox.done(0)
    outbox.done(1, is_refused=True)
    assert (outbox.undelivered(), outbox.given_up) == ((alert(2),), 1)


@given(
    steps=st.lists(st.sampled_from(["add", "send", "acknowledge", "break"]), max_size=60),
    capacity=st.integers(1, 5),
    window=st.integers(1, 5),
)
def test_every_message_is_acknowledged_or_counted_as_dropped_or_still_there(
    steps: list[str], capacity: int, window: int
) -> None:
    outbox = MemoryOutbox(capacity=capacity, window=window)
    added = acknowledged = 0
    on_wire: list[int] = []
    for step in steps:
        if step == "add":
            outbox.add(alert(added), 0.0)
            added += 1
        elif step == "send":
            on_wire += [int(payload) for payload in payloads(outbox)]
        elif step == "acknowledge" and on_wire:
            outbox.done(on_wire.pop(0))
            acknowledged += 1
        elif step == "break":
            outbox.start_over()
            on_wire.clear()
        assert len(on_wire) <= window
    assert added == acknowledged + outbox.given_up + len(outbox.undelivered())
