from __future__ import annotations

import pytest

from stadimeter.config.plugins import MESSENGERS
from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError


def message(text: str, qos: int = 1, expires_s: int | None = None) -> Message:
    return Message(topic="event", payload=text, qos=qos, expires_s=expires_s)


def opened(run, **options):
    messenger = run.build(MESSENGERS, **options)
    messenger.open()
    return messenger


def payloads(messenger) -> list[str]:
    return [sent.item.payload for sent in messenger.sent]


def test_messages_are_kept_with_their_time(run) -> None:
    messenger = opened(run)
    messenger.publish(message("a", qos=0))
    run.clock.advance_s(2.0)
    messenger.publish(message("b"))
    assert [(sent.at_s, sent.item.payload) for sent in messenger.sent] == [(100.0, "a"), (102.0, "b")]
    assert messenger.trouble() == ""


def test_only_the_newest_messages_are_kept(run) -> None:
    messenger = opened(run, history=3)
    for number in range(10):
        messenger.publish(message(str(number)))
    assert payloads(messenger) == ["7", "8", "9"]
    assert messenger.dropped == 0


def test_without_a_broker_qos_1_waits_and_qos_0_is_dropped_and_counted(run) -> None:
    messenger = opened(run)
    run.world.faults.broker_gone = True
    messenger.publish(message("state", qos=0))
    messenger.publish(message("alarm"))
    assert payloads(messenger) == []
    assert messenger.dropped == 1
    assert messenger.trouble() == "the simulated broker is gone; waiting: 1, given up so far: 0"


def test_what_waited_is_delivered_in_order_when_the_broker_is_back(run) -> None:
    messenger = opened(run)
    run.world.faults.broker_gone = True
    for text in ("a", "b"):
        messenger.publish(message(text))
    run.clock.advance_s(5.0)
    run.world.faults.broker_gone = False
    messenger.publish(message("c", qos=0))
    assert [(sent.at_s, sent.item.payload) for sent in messenger.sent] == [(105.0, "a"), (105.0, "b"), (105.0, "c")]
    assert messenger.trouble() == ""


def test_a_full_queue_drops_the_oldest_and_counts_it(run) -> None:
    messenger = opened(run, queue=2)
    run.world.faults.broker_gone = True
    for text in ("a", "b", "c"):
        messenger.publish(message(text))
    run.world.faults.broker_gone = False
    messenger.publish(message("d"))
    assert payloads(messenger) == ["b", "c", "d"]
    assert messenger.given_up == 1


def test_what_nobody_wants_any_more_is_not_delivered(run) -> None:
    messenger = opened(run)
    run.world.faults.broker_gone = True
    messenger.publish(message("brief", expires_s=3))
    messenger.publish(message("lasting"))
    run.clock.advance_s(4.0)
    run.world.faults.broker_gone = False
    assert payloads(messenger) == ["lasting"]
    assert messenger.given_up == 1


def test_using_it_when_closed_is_an_error(run) -> None:
    messenger = run.build(MESSENGERS)
    with pytest.raises(DeviceClosedError):
        messenger.publish(message("a"))
    messenger.open()
    messenger.close()
    messenger.close()
    with pytest.raises(DeviceClosedError):
        messenger.publish(message("a"))
    assert messenger.trouble() == "the simulated messenger 'it' is not open"


def test_closing_delivers_what_waits_if_the_broker_is_back(run) -> None:
    messenger = opened(run)
    run.world.faults.broker_gone = True
    messenger.publish(message("a"))
    run.world.faults.broker_gone = False
    messenger.close()
    assert payloads(messenger) == ["a"]
