"""What every notifier must do. Subclass `NotifierContract` with a fixture ``rig``, and pytest runs it all.

::

    class TestMyNotifier(NotifierContract):
        @pytest.fixture
        def rig(self) -> Iterator[NotifierRig]:
            yield my_rig
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from stadimeter.core.decision import Severity
from stadimeter.core.notification import Notification
from stadimeter.errors import DeviceClosedError
from stadimeter.messaging.notifier_protocol import Notifier
from stadimeter.testing.eventually import eventually


@dataclass(frozen=True, slots=True, kw_only=True)
class NotifierRig:
    """A notifier that was not opened yet, and what is needed to watch it and to plague it.

    Attributes:
        notifier: The notifier. It tries again within a fraction of a second.
        delivered: Returns title and body of everything that the service has taken, in order.
        break_link: Lets the service refuse everything.
        mend_link: Lets it take everything again.
    """

    notifier: Notifier
    delivered: Callable[[], list[tuple[str, str]]]
    break_link: Callable[[], None]
    mend_link: Callable[[], None]

    def arrived(self, *bodies: str) -> bool:
        """Tell whether exactly these texts reached the service, in this order.

        Args:
            bodies: The texts.

        Returns:
            Whether they did.
        """
        return [body for _, body in self.delivered()] == list(bodies)


def telling(body: str) -> Notification:
    """Return a notification."""
    return Notification(title="the door", body=body, severity=Severity.ALARM)


class NotifierContract:
    """The tests."""

    @pytest.fixture
    def notifier(self, rig: NotifierRig) -> Iterator[Notifier]:
        """The notifier; closed in the end, whatever happened."""
        yield rig.notifier
        rig.notifier.close()

    def test_notifying_before_it_was_opened_is_refused(self, notifier: Notifier) -> None:
        with pytest.raises(DeviceClosedError):
            notifier.notify(telling("too early"))

    def test_notifying_after_it_was_closed_is_refused(self, notifier: Notifier) -> None:
        notifier.open()
        notifier.close()
        with pytest.raises(DeviceClosedError):
            notifier.notify(telling("too late"))

    def test_closing_twice_or_without_opening_is_harmless(self, notifier: Notifier) -> None:
        notifier.close()
        notifier.open()
        notifier.close()
        notifier.close()

    def test_title_and_text_arrive_as_they_are(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        body = '0.42 m ± 0.01 is below 0.50 m\nfor {certain} <b>&amp; "quoted" *and* 100 %\\n'
        notifier.notify(telling(body))
        eventually(lambda: rig.delivered() == [("the door", body)])
        assert not notifier.trouble()

    def test_notifications_arrive_in_order(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        for number in range(20):
            notifier.notify(telling(str(number)))
        eventually(lambda: rig.arrived(*(str(number) for number in range(20))))

    def test_opening_twice_sends_nothing_twice(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.open()
        notifier.notify(telling("once"))
        notifier.notify(telling("after it"))
        eventually(lambda: rig.arrived("once", "after it"))

    def test_it_can_be_opened_again(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.close()
        notifier.open()
        notifier.notify(telling("the second time"))
        eventually(lambda: rig.arrived("the second time"))

    def test_closing_delivers_what_is_on_its_way(self, rig: NotifierRig, notifier: Notifier) -> None:
        notifier.open()
        notifier.notify(telling("last words"))
        notifier.close()
        assert rig.arrived("last words")

    def test_a_service_that_is_away_is_no_error_but_said_in_one_line(
        self, rig: NotifierRig, notifier: Notifier
    ) -> None:
        rig.break_link()
        notifier.open()
        notifier.notify(telling("in vain"))
        words = eventually(notifier.trouble)
        assert "\n" not in words

    def test_notifications_wait_for_the_service(self, rig: NotifierRig, notifier: Notifier) -> None:
        rig.break_link()
        notifier.open()
        for number in range(5):
            notifier.notify(telling(str(number)))
        eventually(notifier.trouble)
        rig.mend_link()
        eventually(lambda: rig.arrived(*(str(number) for number in range(5))))
        eventually(lambda: not notifier.trouble())

    def test_what_is_left_at_the_end_is_known_and_sent_when_it_is_opened_again(
        self, rig: NotifierRig, notifier: Notifier
    ) -> None:
        rig.break_link()
        notifier.open()
        notifier.notify(telling("late"))
        notifier.notify(telling("late too"))
        assert notifier.undelivered() == (telling("late"), telling("late too"))
        notifier.close()
        assert notifier.undelivered() == (telling("late"), telling("late too"))
        rig.mend_link()
        notifier.open()
        notifier.notify(telling("later"))
        eventually(lambda: rig.arrived("late", "late too", "later"))
        eventually(lambda: notifier.undelivered() == ())
        assert notifier.given_up == 0

    def test_more_notifications_than_anybody_wants_push_out_the_oldest(
        self, rig: NotifierRig, notifier: Notifier
    ) -> None:
        rig.break_link()
        notifier.open()
        for number in range(150):
            notifier.notify(telling(str(number)))
        eventually(notifier.trouble)
        rig.mend_link()
        notifier.notify(telling("the end"))
        eventually(lambda: ("the door", "the end") in rig.delivered())
        bodies = [body for _, body in rig.delivered()]
        newest = [str(number) for number in range(60, 150)]
        assert bodies[-91:] == [*newest, "the end"]
        assert len(bodies) + notifier.given_up == 151
