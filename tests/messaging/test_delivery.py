"""Notifications on their way: in order, tried again, and never lost without a word."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from stadimeter.core.message import Notification
from stadimeter.messaging.apprise_notifier import Delivery
from stadimeter.messaging.protocol import Patience
from stadimeter.testing.rig import eventually

PATIENCE = Patience(first_pause_s=0.01, longest_pause_s=0.02, goodbye_s=10.0)


def note(body: str) -> Notification:
    return Notification(title="t", body=body)


class Service:
    """Takes notifications, or refuses those that it was told to refuse."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.taken: list[str] = []
        self.refuses: Callable[[str], bool] = lambda _body: False
        self.is_free = threading.Event()
        self.is_free.set()

    def deliver(self, notification: Notification) -> str:
        self.asked.append(notification.body)
        self.is_free.wait()
        if self.refuses(notification.body):
            return "it said no"
        self.taken.append(notification.body)
        return ""


@pytest.fixture
def service() -> Service:
    return Service()


def started(service: Service, retry_s: float = 600.0, patience: Patience = PATIENCE) -> Delivery:
    delivery = Delivery(service.deliver, retry_s, patience)
    delivery.start()
    return delivery


def test_what_failed_is_tried_again_before_what_comes_behind_it(service):
    service.refuses = lambda _body: len(service.asked) < 4
    delivery = started(service)
    delivery.add(note("first"))
    delivery.add(note("second"))
    eventually(lambda: service.taken == ["first", "second"])
    assert service.asked == ["first"] * 4 + ["second"]
    delivery.stop()
    assert delivery.given_up == 0


def test_what_is_refused_for_too_long_is_given_up_and_makes_way(service):
    service.refuses = lambda body: body == "poison"
    delivery = started(service, retry_s=0.0)
    delivery.add(note("poison"))
    delivery.add(note("fine"))
    eventually(lambda: service.taken == ["fine"])
    delivery.stop()
    assert delivery.given_up == 1


def test_trouble_says_why_what_waits_and_what_was_given_up_until_the_next_success(service):
    service.refuses = lambda _body: True
    delivery = started(service, patience=Patience(first_pause_s=30.0, longest_pause_s=30.0, goodbye_s=10.0))
    delivery.add(note("one"))
    eventually(delivery.trouble)
    delivery.add(note("two"))
    assert delivery.trouble() == "it said no; trying again in 10 s; waiting: 2"
    service.refuses = lambda body: body == "one"
    delivery.stop()
    assert service.taken == ["two"]
    assert delivery.trouble() == ""
    assert delivery.undelivered() == (note("one"),)


def test_no_pause_is_longer_than_a_notification_may_wait(service):
    service.refuses = lambda _body: True
    delivery = started(service, patience=Patience(first_pause_s=60.0, alarm_pause_s=0.01, goodbye_s=10.0))
    delivery.add(note("urgent"))
    eventually(lambda: len(service.asked) > 3)
    delivery.stop()
