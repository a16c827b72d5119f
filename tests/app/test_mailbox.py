from __future__ import annotations

import threading

import numpy as np

from stadimeter.app.capture import Mailbox
from stadimeter.core.frame import Frame


def frame(sequence: int) -> Frame:
    return Frame(np.zeros((2, 2, 3), np.uint8), float(sequence), sequence)


def test_the_newest_frame_wins():
    mailbox = Mailbox()
    for sequence in range(3):
        mailbox.put(frame(sequence))
    taken = mailbox.take(0.0)
    assert taken is not None
    assert taken.sequence == 2


def test_a_frame_is_delivered_once():
    mailbox = Mailbox()
    mailbox.put(frame(0))
    assert mailbox.take(0.0) is not None
    assert mailbox.take(0.0) is None
    mailbox.put(frame(1))
    assert mailbox.take(0.0) is not None


def test_whoever_waits_gets_the_next_frame():
    mailbox = Mailbox()
    taken: list[Frame | None] = []
    waiter = threading.Thread(target=lambda: taken.append(mailbox.take(10.0)))
    waiter.start()
    mailbox.put(frame(5))
    waiter.join(120)
    assert [item.sequence for item in taken if item] == [5]


def test_closing_lets_whoever_waits_go_and_ends_deliveries():
    mailbox = Mailbox()
    taken: list[Frame | None] = []
    waiter = threading.Thread(target=lambda: taken.append(mailbox.take(30.0)))
    waiter.start()
    mailbox.close()
    waiter.join(120)
    assert taken == [None]
    mailbox.put(frame(0))
    assert mailbox.take(0.0) is None
