"""A view that blocks holds up nothing."""

import threading

import pytest

from stadimeter.cli.viewing import WAITING_MAX, ViewThread


def test_what_is_submitted_is_shown_in_order():
    shown = []
    thread = ViewThread(shown.append)
    thread.start()
    for number in range(100):
        thread.submit(number)
    thread.stop()
    assert shown == list(range(100))
    assert thread.dropped == 0


def test_a_view_that_blocks_does_not_block_the_loop_and_what_is_not_shown_is_counted():
    let_go, entered, shown = threading.Event(), threading.Event(), []

    def update(record):
        entered.set()
        assert let_go.wait(120)
        shown.append(record)

    thread = ViewThread(update)
    thread.start()
    thread.submit(0)
    assert entered.wait(120)
    for number in range(1, WAITING_MAX + 51):
        thread.submit(number)
    assert thread.dropped == 50
    let_go.set()
    thread.stop()
    assert shown == list(range(WAITING_MAX + 1))


def test_what_ends_the_view_reaches_the_loop():
    ended = threading.Event()

    def update(record):
        ended.set()
        raise BrokenPipeError

    thread = ViewThread(update)
    thread.start()
    thread.submit(0)
    assert ended.wait(120)
    thread.stop()
    with pytest.raises(BrokenPipeError):
        thread.submit(1)
