"""The contracts of every messenger and of every notifier: subclass one with a fixture ``make_rig``.

`stadimeter.testing.rig` shows how.
"""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, TypeVar

import pytest

from stadimeter.core.decision import Severity
from stadimeter.core.message import Message, Notification
from stadimeter.errors import DeviceClosedError
from stadimeter.messaging.protocol import Messenger, Notifier
from stadimeter.testing.rig import Contract, Rig

GONE, SILENT = "gone", "silent"

SenderT = TypeVar("SenderT", Messenger, Notifier)

# More than any queue holds.
TOO_MANY = 10_500


class DeliveryRig(Rig[SenderT], frozen=True, kw_only=True):
    """A messenger or a notifier, which tries again within a fraction of a second, and the other side.

    Its faults are `GONE` and `SILENT`: the other side takes nothing, or takes it and does not answer.

    Attributes:
        delivered: Returns topic and payload, or title and body, of everything that reached the other side, in order.
        method: That which sends.
        head: What the topics or titles of the contract begin with.
    """

    delivered: Callable[[], list[tuple[str, str]]]
    method: ClassVar[str]
    head: ClassVar[str]

    @abstractmethod
    def item(self, text: str, severity: Severity = Severity.INFO) -> Message | Notification:
        """Return the item that must arrive, with a text in it."""

    def send(self, text: str, severity: Severity = Severity.INFO) -> None:
        """Hand that over, which must not take long whatever the other side does."""
        self.timed(self.method, self.item(text, severity))

    def arrived(self, *texts: str) -> bool:
        """Check whether exactly these texts reached the other side, in this order."""
        return [text for head, text in self.delivered() if head.startswith(self.head)] == list(texts)


class MessengerRig(DeliveryRig[Messenger], frozen=True, kw_only=True):
    """A messenger and the other side, such as a broker.

    Its faults are `GONE` (the other side goes without a word, and takes no connection) and `SILENT` (connections
    stand, but nothing gets through; when it ends, they break). Topics in `delivered` are below the base; messages of
    the messenger's own, such as its availability, may be among them.
    """

    method, head = "publish", "contract/"

    def item(self, text: str, severity: Severity = Severity.INFO) -> Message:
        """Return a message that must arrive."""
        return Message(topic="contract/alert", payload=text, qos=1, severity=severity)

    def send_state(self, text: str) -> None:
        """Publish a message that may be lost."""
        self.timed("publish", Message(topic="contract/state", payload=text))


class NotifierRig(DeliveryRig[Notifier], frozen=True, kw_only=True):
    """A notifier and the service behind it.

    Its faults are `GONE` (the service refuses everything) and `SILENT` (it takes requests and does not answer them
    until the fault ends).
    """

    method, head = "notify", "the door"

    def item(self, text: str, severity: Severity = Severity.INFO) -> Notification:
        """Return a notification."""
        return Notification(title="the door", body=text, severity=severity)


class DeliveryContract(Contract):
    """The tests that messengers and notifiers share."""

    @pytest.fixture
    def sender(self, rig: DeliveryRig[Any]) -> Iterator[Any]:
        """The messenger or notifier; closed in the end, whatever happened."""
        yield rig.device
        rig.device.close()

    def test_closing_it_ends_its_threads(self, rig: DeliveryRig[Any], sender: Any) -> None:
        before = set(threading.enumerate())
        sender.open()
        rig.send("one")
        rig.eventually(lambda: rig.arrived("one"))
        sender.close()
        for thread in set(threading.enumerate()) - before:
            thread.join(1.0)
            assert not thread.is_alive(), f"closing left the thread {thread.name}"

    def test_sending_while_it_is_closed_is_refused_and_closing_twice_is_harmless(
        self, rig: DeliveryRig[Any], sender: Any
    ) -> None:
        sender.close()
        with pytest.raises(DeviceClosedError):
            rig.send("too early")
        sender.open()
        sender.close()
        sender.close()
        with pytest.raises(DeviceClosedError):
            rig.send("too late")

    def test_what_is_sent_arrives_once_and_in_order(self, rig: DeliveryRig[Any], sender: Any) -> None:
        """Also if it is opened twice; and what is on its way when it is closed."""
        sender.open()
        sender.open()
        rig.eventually(lambda: not sender.trouble())
        for number in range(30):
            rig.send(str(number))
        sender.close()
        rig.eventually(lambda: rig.arrived(*map(str, range(30))))

    def test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line(
        self, rig: DeliveryRig[Any], sender: Any
    ) -> None:
        rig.begin(GONE)
        sender.open()
        rig.send("in vain")
        words = rig.eventually(sender.trouble)
        assert "\n" not in words
        assert "://" not in words, "the address of a service is a secret more often than not"
        sender.close()
        with pytest.raises(DeviceClosedError):
            rig.send("too late")

    @pytest.mark.parametrize("fault", [GONE, SILENT])
    def test_sending_never_waits_for_the_other_side(self, rig: DeliveryRig[Any], sender: Any, fault: str) -> None:
        sender.open()
        rig.begin(fault)
        for number in range(5):
            rig.send(str(number))
        rig.end(fault)
        rig.eventually(lambda: not sender.trouble() and sender.undelivered() == ())

    def test_what_must_arrive_waits_for_the_other_side(self, rig: DeliveryRig[Any], sender: Any) -> None:
        rig.begin(GONE)
        sender.open()
        for number in range(30):
            rig.send(str(number))
        rig.eventually(sender.trouble)
        assert sender.undelivered() == tuple(rig.item(str(number)) for number in range(30))
        rig.end(GONE)
        rig.eventually(lambda: rig.arrived(*map(str, range(30))))
        rig.eventually(lambda: not sender.trouble())
        rig.eventually(lambda: sender.undelivered() == ())
        assert sender.given_up == 0

    def test_what_is_left_at_the_end_is_known(self, rig: DeliveryRig[Any], sender: Any) -> None:
        rig.begin(GONE)
        sender.open()
        rig.send("late")
        rig.send("late too")
        sender.close()
        assert sender.undelivered() == (rig.item("late"), rig.item("late too"))

    def test_more_than_fits_is_given_up_and_counted(self, rig: DeliveryRig[Any], sender: Any) -> None:
        """The oldest that is not on its way, of what matters least, gives way; never what is about safety."""
        rig.begin(GONE)
        sender.open()
        rig.send("on its way")
        for severity in (Severity.SAFETY, Severity.ALARM, Severity.WARNING):
            rig.send(f"about {severity}", severity)
        for number in range(TOO_MANY):
            rig.send(str(number))
        left = sender.undelivered()
        assert left[-60:] == tuple(rig.item(str(number)) for number in range(TOO_MANY - 60, TOO_MANY))
        assert [each for each in left if each.severity is not Severity.INFO] == [
            rig.item(f"about {each}", each) for each in (Severity.SAFETY, Severity.ALARM, Severity.WARNING)
        ]
        assert len(left) + sender.given_up == TOO_MANY + 4
        assert sender.given_up > 0


class MessengerContract(DeliveryContract):
    """The tests of a messenger."""

    def test_states_do_not_wait_for_the_other_side(self, rig: MessengerRig, sender: Messenger) -> None:
        rig.begin(GONE)
        sender.open()
        for number in range(30):
            rig.send(str(number))
            rig.send_state("not to be seen")
        rig.end(GONE)
        rig.eventually(lambda: not sender.trouble())
        rig.send("the end")
        rig.eventually(lambda: rig.arrived(*map(str, range(30)), "the end"))

    def test_it_recovers_from_a_broken_link(self, rig: MessengerRig, sender: Messenger) -> None:
        sender.open()
        rig.eventually(lambda: not sender.trouble())
        rig.begin(GONE)
        rig.eventually(sender.trouble)
        rig.send("meanwhile")
        rig.end(GONE)
        rig.eventually(lambda: not sender.trouble())
        rig.send_state("as if nothing had happened")
        rig.eventually(lambda: rig.arrived("meanwhile", "as if nothing had happened"))

    def test_what_was_sent_but_not_acknowledged_is_not_lost(self, rig: MessengerRig, sender: Messenger) -> None:
        """That the operating system has taken a message does not mean that the other side has."""
        sender.open()
        rig.eventually(lambda: not sender.trouble())
        rig.begin(SILENT)
        rig.send("into the silence")
        rig.end(SILENT)
        rig.eventually(lambda: rig.arrived("into the silence"))
        rig.eventually(lambda: sender.undelivered() == ())


class NotifierContract(DeliveryContract):
    """The tests of a notifier."""

    def test_title_and_text_arrive_as_they_are(self, rig: NotifierRig, sender: Notifier) -> None:
        sender.open()
        body = '0.42 m ± 0.01 is below 0.50 m\nfor {certain} <b>&amp; "quoted" *and* 100 %\\n'
        rig.send(body)
        rig.eventually(lambda: rig.delivered() == [("the door", body)])
        assert not sender.trouble()
