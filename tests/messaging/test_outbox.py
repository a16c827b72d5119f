from __future__ import annotations

from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.decision import Severity
from stadimeter.core.message import KEPT_S, Message
from stadimeter.messaging.outbox import MemoryOutbox, pending


def alert(payload: object, expires_s: int | None = None, severity: Severity = Severity.INFO) -> Message:
    return Message(topic="event/alarm", payload=str(payload), qos=1, expires_s=expires_s, severity=severity)


def state(payload: object) -> Message:
    return Message(topic="target/ball/state", payload=str(payload))


def taken(outbox: MemoryOutbox, now_s: float = 0.0) -> Iterator[Message]:
    while waiting := outbox.take(now_s):
        yield waiting.on_wire(now_s)
        outbox.sent(int(waiting.message.payload), waiting)


def payloads(outbox: MemoryOutbox, now_s: float = 0.0) -> list[str]:
    return [message.payload for message in taken(outbox, now_s)]


def test_a_full_outbox_drops_a_state_that_a_newer_one_replaced_before_it_gives_up_an_alarm():
    outbox = MemoryOutbox(capacity=3)
    first, second = (Message(topic="rule/near/state", payload=each, qos=1, retain=True) for each in ("100", "101"))
    for message in (alert(0), first, second, alert(1)):
        outbox.add(message, 0.0)
    assert outbox.undelivered() == (alert(0), second, alert(1))
    assert (outbox.given_up, outbox.dropped) == (0, 1)
    outbox.add(alert(2), 0.0)
    assert outbox.undelivered() == (second, alert(1), alert(2))
    assert (outbox.given_up, outbox.dropped) == (1, 1)


def test_a_full_outbox_gives_up_what_matters_least_and_never_what_is_about_safety():
    outbox = MemoryOutbox(capacity=4)
    said = [alert(each, severity=each) for each in (Severity.SAFETY, Severity.ALARM, Severity.INFO, Severity.WARNING)]
    for message in said:
        outbox.add(message, 0.0)
    for number, left in enumerate([(0, 1, 3), (0, 1), (0,), (0,)]):
        safety = alert(number, severity=Severity.SAFETY)
        said.append(safety)
        outbox.add(safety, 0.0)
        assert outbox.undelivered() == (*[said[each] for each in left], *said[4:])
        assert outbox.given_up == min(number + 1, 3)


def test_an_event_that_goes_out_late_says_that_it_is_history_also_when_it_is_sent_again():
    outbox = MemoryOutbox(window=2)
    for number in range(3):
        outbox.add(Message(topic="event/alarm", payload=f'{{"id":"{number}"}}', qos=1), 100.0)
    outbox.add(Message(topic="door/alert", payload='{"mine":1}', qos=1), 100.0)

    def payloads_at(now_s: float) -> list[str]:
        waiting = iter(lambda: outbox.take(now_s), None)
        taken = [(each, outbox.sent(number, each)) for number, each in enumerate(waiting)]
        return [each.on_wire(now_s).payload for each, _ in taken]

    assert payloads_at(105.0) == ['{"id":"0"}', '{"id":"1"}']
    outbox.done(0)
    outbox.start_over()  # the second may have arrived, or not
    assert payloads_at(105.1) == ['{"id":"1","replayed":true}', '{"id":"2","replayed":true}']
    assert [each.payload for each in outbox.undelivered()] == ['{"id":"1"}', '{"id":"2"}', '{"mine":1}'], (
        "kept as it was"
    )
    outbox.done(0)
    assert payloads_at(200.0) == ['{"mine":1}']


def test_after_a_week_only_what_is_about_safety_and_what_the_broker_is_to_keep_is_still_sent():
    outbox = MemoryOutbox()
    for message in (alert(0), alert(1, severity=Severity.SAFETY), replace(alert(2), retain=True)):
        outbox.add(message, 0.0)
    outbox.add(alert(3), 1.0)
    assert payloads(outbox, KEPT_S + 0.5) == ["1", "2", "3"]
    assert outbox.given_up == 1


def test_a_message_that_waited_too_long_is_dropped_and_a_younger_one_keeps_what_is_left_of_its_life():
    outbox = MemoryOutbox()
    outbox.add(alert(0, expires_s=2), 100.0)
    outbox.add(alert(1, expires_s=10), 100.0)
    (message,) = taken(outbox, 103.5)
    assert (message.payload, message.expires_s, outbox.given_up) == ("1", 7, 1)


def test_a_message_that_expires_right_now_is_not_sent_with_an_expiry_of_zero():
    outbox = MemoryOutbox()
    outbox.add(alert(0, expires_s=2), 100.0)
    assert payloads(outbox, 102.0) == []


def test_messages_of_qos_0_that_were_not_written_are_lost_with_the_connection():
    outbox = MemoryOutbox(unwritten_max=2)
    for number in range(2):
        assert outbox.has_room_on_wire
        outbox.sent(number, pending(state(number), 0.0))
    assert not outbox.has_room_on_wire
    outbox.done(0)
    outbox.start_over()
    assert (outbox.dropped, outbox.has_room_on_wire, outbox.is_empty) == (1, True, True)


def test_messages_go_in_their_order_but_those_of_qos_0_do_not_wait_for_acknowledgements():
    outbox = MemoryOutbox(window=1)
    for message in (state(0), alert(1), state(2), alert(3), state(4)):
        outbox.add(message, 0.0)
    assert payloads(outbox) == ["0", "1", "2", "4"]
    outbox.done(1)
    assert payloads(outbox) == ["3"]


def test_a_message_of_qos_0_is_dropped_and_counted_when_as_many_wait_to_be_written():
    outbox = MemoryOutbox(unwritten_max=2)
    for number in range(3):
        outbox.add(state(number), 0.0)
    assert (payloads(outbox), outbox.dropped) == (["0", "1"], 1)
    outbox.add(state(3), 0.0)
    outbox.done(0)
    outbox.add(replace(state(4), expires_s=2), 0.0)
    assert (payloads(outbox, now_s=3.0), outbox.dropped) == ([], 3)  # too late


def test_a_message_that_was_taken_is_undelivered_before_it_is_on_the_wire():
    outbox = MemoryOutbox()
    for number in (1, 2):
        outbox.add(alert(number), 0.0)
    taken = outbox.take(0.0)
    assert taken is not None
    assert outbox.undelivered() == (alert(1), alert(2))
    outbox.refuse_taken(taken)
    assert (outbox.undelivered(), outbox.given_up) == ((alert(2),), 1)


def test_what_is_on_the_wire_and_what_waits_is_undelivered_until_it_is_answered():
    outbox = MemoryOutbox(window=2)
    for number in range(3):
        outbox.add(alert(number), 0.0)
    assert payloads(outbox) == ["0", "1"]
    assert outbox.undelivered() == (alert(0), alert(1), alert(2))
    outbox.done(0)
    outbox.done(1, is_refused=True)
    assert (outbox.undelivered(), outbox.given_up) == ((alert(2),), 1)


@given(
    steps=st.lists(st.sampled_from([*Severity, "state", "send", "acknowledge", "break"]), max_size=80),
    capacity=st.integers(1, 5),
    window=st.integers(1, 5),
)
def test_every_message_is_acknowledged_or_counted_or_still_there_in_its_order(steps, capacity, window):
    outbox = MemoryOutbox(capacity=capacity, window=window)
    added = 0
    safety, acknowledged, on_wire = set(), set(), list[int]()
    for step in steps:
        if step == "send":
            on_wire += [int(payload) for payload in payloads(outbox)]
        elif step == "acknowledge" and on_wire:
            outbox.done(on_wire[0])
            acknowledged.add(on_wire.pop(0))
        elif step == "break":
            outbox.start_over()
            on_wire.clear()
        elif step == "state":
            outbox.add(Message(topic="rule/near/state", payload=str(added), qos=1, retain=True), 0.0)
            added += 1
        elif step in set(Severity):
            outbox.add(alert(added, severity=Severity(step)), 0.0)
            safety |= {added} if step == "safety" else set()
            added += 1
        left = [int(each.payload) for each in outbox.undelivered()]
        assert len(on_wire) <= window
        assert left == sorted(left)
        assert safety <= acknowledged | {*left}
        assert added == len(acknowledged) + outbox.given_up + outbox.dropped + len(left)
