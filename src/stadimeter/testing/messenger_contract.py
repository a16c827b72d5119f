"""What every messenger must do. Subclass `MessengerContract` with a fixture ``rig``, and pytest runs it all.

::

    class TestMyMessenger(MessengerContract):
        @pytest.fixture
        def rig(self) -> Iterator[MessengerRig]:
            yield my_rig
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError
from stadimeter.messaging.protocol import Messenger
from stadimeter.testing.eventually import eventually


@dataclass(frozen=True, slots=True, kw_only=True)
class MessengerRig:
    """A messenger that was not opened yet, and what is needed to watch it and to plague it.

    Attributes:
        messenger: The messenger.
        delivered: Returns topic, below the base, and payload of everything that reached the other side, in order. What
            the messenger itself adds, such as its availability, may be among it.
        break_link: Takes the other side away, without a word.
        mend_link: Brings it back.
    """

    messenger: Messenger
    delivered: Callable[[], list[tuple[str, str]]]
    break_link: Callable[[], None]
    mend_link: Callable[[], None]

    def arrived(self, *payloads: str) -> bool:
        """Tell whether exactly these payloads, in this order, reached the topics of `alert` and `state`.

        Args:
            payloads: The payloads.

        Returns:
            Whether they did.
        """
        return [payload for topic, payload in self.delivered() if topic.startswith("contract/")] == list(payloads)


def alert(payload: str) -> Message:
    """Return a message that must arrive."""
    return Message(topic="contract/alert", payload=payload, qos=1)


def state(payload: str) -> Message:
    """Return a message that may be lost."""
    return Message(topic="contract/state", payload=payload)


class MessengerContract:
    """The tests."""

    @pytest.fixture
    def messenger(self, rig: MessengerRig) -> Iterator[Messenger]:
        """The messenger; closed in the end, whatever happened."""
        yield rig.messenger
        rig.messenger.close()

    def test_publishing_before_it_was_opened_is_refused(self, messenger: Messenger) -> None:
        with pytest.raises(DeviceClosedError):
            messenger.publish(alert("too early"))

    def test_publishing_after_it_was_closed_is_refused(self, messenger: Messenger) -> None:
        messenger.open()
        messenger.close()
        with pytest.raises(DeviceClosedError):
            messenger.publish(alert("too late"))

    def test_closing_twice_or_without_opening_is_harmless(self, messenger: Messenger) -> None:
        messenger.close()
        messenger.open()
        messenger.close()
        messenger.close()

    def test_messages_arrive_in_order(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        eventually(lambda: not messenger.trouble())
        for number in range(50):
            messenger.publish(alert(str(number)))
        eventually(lambda: rig.arrived(*(str(number) for number in range(50))))

    def test_opening_twice_sends_nothing_twice(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        messenger.open()
        messenger.publish(alert("once"))
        messenger.publish(alert("after it"))
        eventually(lambda: rig.arrived("once", "after it"))

    def test_it_can_be_opened_again(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        messenger.close()
        messenger.open()
        messenger.publish(alert("the second time"))
        eventually(lambda: rig.arrived("the second time"))

    def test_closing_delivers_what_is_on_its_way(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        eventually(lambda: not messenger.trouble())
        messenger.publish(alert("last words"))
        messenger.close()
        eventually(lambda: rig.arrived("last words"))

    def test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.break_link()
        messenger.open()
        words = eventually(messenger.trouble)
        assert "\n" not in words

    def test_alerts_wait_for_the_other_side_and_states_do_not(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.break_link()
        messenger.open()
        for number in range(30):
            messenger.publish(alert(str(number)))
            messenger.publish(state("nobody saw this"))
        rig.mend_link()
        eventually(lambda: not messenger.trouble())
        messenger.publish(alert("the end"))
        eventually(lambda: rig.arrived(*(str(number) for number in range(30)), "the end"))

    def test_it_recovers_from_a_broken_link(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        eventually(lambda: not messenger.trouble())
        rig.break_link()
        eventually(messenger.trouble)
        messenger.publish(alert("meanwhile"))
        rig.mend_link()
        eventually(lambda: not messenger.trouble())
        messenger.publish(state("as if nothing had happened"))
        eventually(lambda: rig.arrived("meanwhile", "as if nothing had happened"))

    def test_what_nobody_acknowledged_is_known_and_what_was_is_forgotten(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.break_link()
        messenger.open()
        for number in range(30):
            messenger.publish(alert(str(number)))
        assert messenger.undelivered() == tuple(alert(str(number)) for number in range(30))
        rig.mend_link()
        eventually(lambda: not messenger.trouble())
        eventually(lambda: messenger.undelivered() == ())
        assert messenger.given_up == 0

    def test_what_is_left_at_the_end_is_known_and_sent_when_it_is_opened_again(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.break_link()
        messenger.open()
        messenger.publish(alert("late"))
        messenger.publish(state("nobody saw this"))
        messenger.close()
        assert messenger.undelivered() == (alert("late"),)
        rig.mend_link()
        messenger.open()
        eventually(lambda: not messenger.trouble())
        messenger.publish(alert("later"))
        eventually(lambda: rig.arrived("late", "later"))

    def test_more_messages_than_fit_are_given_up_and_counted(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.break_link()
        messenger.open()
        for number in range(1500):
            messenger.publish(alert(str(number)))
        left = messenger.undelivered()
        assert left[-1] == alert("1499")
        assert len(left) + messenger.given_up == 1500
        assert messenger.given_up > 0

    def test_closing_without_the_other_side_returns(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.break_link()
        messenger.open()
        messenger.publish(alert("in vain"))
        messenger.close()
        with pytest.raises(DeviceClosedError):
            messenger.publish(alert("too late"))
