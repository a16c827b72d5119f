"""The contract of every messenger: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError
from stadimeter.messaging.protocol import Messenger
from stadimeter.testing.rig import Contract, Rig, threads_left

GONE, SILENT = "gone", "silent"


@dataclass(frozen=True, slots=True, kw_only=True)
class MessengerRig(Rig[Messenger]):
    """A messenger and the other side, such as a broker.

    Its faults are `GONE` (the other side goes without a word, and takes no connection) and `SILENT` (connections
    stand, but nothing gets through; when it ends, they break).

    Attributes:
        delivered: Returns topic, below the base, and payload of everything that reached the other side, in order.
            Messages of the messenger's own, such as its availability, may be among it.
    """

    delivered: Callable[[], list[tuple[str, str]]]

    def publish(self, message: Message) -> None:
        """Hand a message over, which must not take long whatever the network does."""
        self.timed("publish", message)

    def arrived(self, *payloads: str) -> bool:
        """Return whether exactly these payloads, in this order, reached the topics of `alert` and `state`."""
        return [payload for topic, payload in self.delivered() if topic.startswith("contract/")] == list(payloads)


def alert(payload: str) -> Message:
    """Return a message that must arrive."""
    return Message(topic="contract/alert", payload=payload, qos=1)


def state(payload: str) -> Message:
    """Return a message that may be lost."""
    return Message(topic="contract/state", payload=payload)


class MessengerContract(Contract):
    """The tests."""

    @pytest.fixture
    def messenger(self, rig: MessengerRig) -> Iterator[Messenger]:
        """The messenger; closed in the end, whatever happened."""
        yield rig.device
        rig.device.close()

    def test_closing_it_ends_its_threads(self, rig: MessengerRig, messenger: Messenger) -> None:
        with threads_left() as left:
            messenger.open()
            rig.publish(alert("one"))
            rig.eventually(lambda: rig.arrived("one"))
            messenger.close()
            assert not left()

    def test_publishing_before_it_was_opened_is_refused(self, rig: MessengerRig) -> None:
        with pytest.raises(DeviceClosedError):
            rig.publish(alert("too early"))

    def test_publishing_after_it_was_closed_is_refused(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        messenger.close()
        with pytest.raises(DeviceClosedError):
            rig.publish(alert("too late"))

    def test_closing_twice_or_without_opening_is_harmless(self, messenger: Messenger) -> None:
        messenger.close()
        messenger.open()
        messenger.close()
        messenger.close()

    def test_messages_arrive_in_order(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        rig.eventually(lambda: not messenger.trouble())
        for number in range(50):
            rig.publish(alert(str(number)))
        rig.eventually(lambda: rig.arrived(*(str(number) for number in range(50))))

    def test_opening_twice_sends_nothing_twice(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        messenger.open()
        rig.publish(alert("once"))
        rig.publish(alert("after it"))
        rig.eventually(lambda: rig.arrived("once", "after it"))

    def test_it_can_be_opened_again(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        messenger.close()
        messenger.open()
        rig.publish(alert("the second time"))
        rig.eventually(lambda: rig.arrived("the second time"))

    def test_closing_delivers_what_is_on_its_way(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        rig.eventually(lambda: not messenger.trouble())
        rig.publish(alert("last words"))
        messenger.close()
        rig.eventually(lambda: rig.arrived("last words"))

    def test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.begin(GONE)
        messenger.open()
        words = rig.eventually(messenger.trouble)
        assert "\n" not in words

    def test_alerts_wait_for_the_other_side_and_states_do_not(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.begin(GONE)
        messenger.open()
        for number in range(30):
            rig.publish(alert(str(number)))
            rig.publish(state("not to be seen"))
        rig.end(GONE)
        rig.eventually(lambda: not messenger.trouble())
        rig.publish(alert("the end"))
        rig.eventually(lambda: rig.arrived(*(str(number) for number in range(30)), "the end"))

    def test_it_recovers_from_a_broken_link(self, rig: MessengerRig, messenger: Messenger) -> None:
        messenger.open()
        rig.eventually(lambda: not messenger.trouble())
        rig.begin(GONE)
        rig.eventually(messenger.trouble)
        rig.publish(alert("meanwhile"))
        rig.end(GONE)
        rig.eventually(lambda: not messenger.trouble())
        rig.publish(state("as if nothing had happened"))
        rig.eventually(lambda: rig.arrived("meanwhile", "as if nothing had happened"))

    def test_what_was_sent_but_not_acknowledged_is_not_lost(self, rig: MessengerRig, messenger: Messenger) -> None:
        """That the operating system has taken a message does not mean that the other side has."""
        messenger.open()
        rig.eventually(lambda: not messenger.trouble())
        rig.begin(SILENT)
        rig.publish(alert("into the silence"))
        rig.end(SILENT)
        rig.eventually(lambda: rig.arrived("into the silence"))
        rig.eventually(lambda: messenger.undelivered() == ())

    @pytest.mark.parametrize("fault", [GONE, SILENT])
    def test_publishing_never_waits_for_the_other_side(
        self, rig: MessengerRig, messenger: Messenger, fault: str
    ) -> None:
        messenger.open()
        rig.begin(fault)
        for number in range(5):
            rig.publish(alert(str(number)))
            rig.publish(state(str(number)))
        rig.end(fault)

    def test_what_was_not_acknowledged_is_known_and_what_was_is_forgotten(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.begin(GONE)
        messenger.open()
        for number in range(30):
            rig.publish(alert(str(number)))
        assert messenger.undelivered() == tuple(alert(str(number)) for number in range(30))
        rig.end(GONE)
        rig.eventually(lambda: not messenger.trouble())
        rig.eventually(lambda: messenger.undelivered() == ())
        assert messenger.given_up == 0

    def test_what_is_left_at_the_end_is_known_and_sent_when_it_is_opened_again(
        self, rig: MessengerRig, messenger: Messenger
    ) -> None:
        rig.begin(GONE)
        messenger.open()
        rig.publish(alert("late"))
        rig.publish(state("not to be seen"))
        messenger.close()
        assert messenger.undelivered() == (alert("late"),)
        rig.end(GONE)
        messenger.open()
        rig.eventually(lambda: not messenger.trouble())
        rig.publish(alert("later"))
        rig.eventually(lambda: rig.arrived("late", "later"))

    def test_more_messages_than_fit_are_given_up_and_counted(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.begin(GONE)
        messenger.open()
        for number in range(1500):
            rig.publish(alert(str(number)))
        left = messenger.undelivered()
        assert left[-1] == alert("1499")
        assert len(left) + messenger.given_up == 1500
        assert messenger.given_up > 0

    def test_closing_without_the_other_side_returns(self, rig: MessengerRig, messenger: Messenger) -> None:
        rig.begin(GONE)
        messenger.open()
        rig.publish(alert("in vain"))
        messenger.close()
        with pytest.raises(DeviceClosedError):
            rig.publish(alert("too late"))
