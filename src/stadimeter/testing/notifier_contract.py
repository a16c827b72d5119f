"""The contract of every notifier: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from stadimeter.core.decision import Severity
from stadimeter.core.notification import Notification
from stadimeter.errors import DeviceClosedError
from stadimeter.messaging.protocol import Notifier
from stadimeter.testing.rig import Contract, Rig, threads_left

GONE, SILENT = "gone", "silent"


@dataclass(frozen=True, slots=True, kw_only=True)
class NotifierRig(Rig[Notifier]):
    """A notifier, which tries again within a fraction of a second, and the service behind it.

    Its faults are `GONE` (the service refuses everything) and `SILENT` (it takes requests and does not answer them
    until the fault ends).

    Attributes:
        delivered: Returns title and body of everything that the service has taken, in order.
    """

    delivered: Callable[[], list[tuple[str, str]]]

    def notify(self, body: str) -> None:
        """Hand a notification over, which must not take long whatever the service does."""
        self.timed("notify", notification(body))

    def arrived(self, *bodies: str) -> bool:
        """Return whether exactly these texts reached the service, in this order."""
        return [body for _, body in self.delivered()] == list(bodies)


def notification(body: str) -> Notification:
    """Return a notification."""
    return Notification(title="the door", body=body, severity=Severity.ALARM)


class NotifierContract(Contract):
    """The tests."""

    @pytest.fixture
    def notifier(self, rig: NotifierRig) -> Iterator[Notifier]:
        """The notifier; closed in the end, whatever happened."""
        yield rig.device
        rig.device.close()

    def test_closing_it_ends_its_threads(self, rig: NotifierRig, notifier: Notifier) -> None:
        with threads_left() as left:
            notifier.open()
            rig.notify("one")
            rig.eventually(lambda: rig.arrived("one"))
            notifier.close()
            assert not left()

    def test_notifying_before_it_was_opened_is_refused(self, rig: NotifierRig) -> None:
        with pytest.raises(DeviceClosedError):
            rig.notify("too early")

    def test_notifying_after_it_was_closed_is_refused(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.close()
        with pytest.raises(DeviceClosedError):
            rig.notify("too late")

    def test_closing_twice_or_without_opening_is_harmless(self, notifier: Notifier) -> None:
        notifier.close()
        notifier.open()
        notifier.close()
        notifier.close()

    def test_title_and_text_arrive_as_they_are(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        body = '0.42 m ± 0.01 is below 0.50 m\nfor {certain} <b>&amp; "quoted" *and* 100 %\\n'
        rig.notify(body)
        rig.eventually(lambda: rig.delivered() == [("the door", body)])
        assert not notifier.trouble()

    def test_notifications_arrive_in_order(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        for number in range(20):
            rig.notify(str(number))
        rig.eventually(lambda: rig.arrived(*(str(number) for number in range(20))))

    def test_opening_twice_sends_nothing_twice(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.open()
        rig.notify("once")
        rig.notify("after it")
        rig.eventually(lambda: rig.arrived("once", "after it"))

    def test_it_can_be_opened_again(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.close()
        notifier.open()
        rig.notify("the second time")
        rig.eventually(lambda: rig.arrived("the second time"))

    def test_closing_delivers_what_is_on_its_way(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        rig.notify("last words")
        notifier.close()
        assert rig.arrived("last words")

    def test_a_service_that_is_away_is_no_error_but_said_in_one_line(
        self, rig: NotifierRig, notifier: Notifier
    ) -> None:
        rig.begin(GONE)
        notifier.open()
        rig.notify("in vain")
        words = rig.eventually(notifier.trouble)
        assert "\n" not in words
        assert "://" not in words, "the address of a service is a secret more often than not"

    @pytest.mark.parametrize("fault", [GONE, SILENT])
    def test_notifying_never_waits_for_the_service(self, rig: NotifierRig, notifier: Notifier, fault: str) -> None:
        notifier.open()
        rig.begin(fault)
        for number in range(5):
            rig.notify(str(number))
        rig.end(fault)
        rig.eventually(lambda: rig.arrived(*(str(number) for number in range(5))))

    def test_notifications_wait_for_the_service(self, rig: NotifierRig, notifier: Notifier) -> None:
        rig.begin(GONE)
        notifier.open()
        for number in range(5):
            rig.notify(str(number))
        rig.eventually(notifier.trouble)
        rig.end(GONE)
        rig.eventually(lambda: rig.arrived(*(str(number) for number in range(5))))
        rig.eventually(lambda: not notifier.trouble())

    def test_what_is_left_at_the_end_is_known_and_sent_when_it_is_opened_again(
        self, rig: NotifierRig, notifier: Notifier
    ) -> None:
        rig.begin(GONE)
        notifier.open()
        rig.notify("late")
        rig.notify("late too")
        assert notifier.undelivered() == (notification("late"), notification("late too"))
        notifier.close()
        assert notifier.undelivered() == (notification("late"), notification("late too"))
        rig.end(GONE)
        notifier.open()
        rig.notify("later")
        rig.eventually(lambda: rig.arrived("late", "late too", "later"))
        rig.eventually(lambda: notifier.undelivered() == ())
        assert notifier.given_up == 0

    def test_more_notifications_than_fit_push_out_the_oldest(self, rig: NotifierRig, notifier: Notifier) -> None:
        rig.begin(GONE)
        notifier.open()
        for number in range(150):
            rig.notify(str(number))
        rig.eventually(notifier.trouble)
        rig.end(GONE)
        rig.notify("the end")
        rig.eventually(lambda: ("the door", "the end") in rig.delivered())
        bodies = [body for _, body in rig.delivered()]
        newest = [str(number) for number in range(60, 150)]
        assert bodies[-91:] == [*newest, "the end"]
        assert len(bodies) + notifier.given_up == 151
