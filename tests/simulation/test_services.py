from __future__ import annotations

from stadimeter.config.plugins import MESSENGERS
from stadimeter.core.message import Message


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


def test_what_nobody_wants_any_more_is_not_delivered(run) -> None:
    messenger = opened(run)
    run.world.faults.broker_gone = True
    messenger.publish(message("brief", expires_s=3))
    messenger.publish(message("lasting"))
    run.clock.advance_s(4.0)
    run.world.faults.broker_gone = False
    assert payloads(messenger) == ["lasting"]
    assert messenger.given_up == 1
