"""Closing the parts of a run side by side, before one deadline."""

import os
import signal
import threading

import pytest

from stadimeter.app import ending
from stadimeter.app.ending import Deadline, close_side_by_side
from stadimeter.errors import DriverError


@pytest.fixture
def hang():
    """Return a call that does not come back before the end of the test."""
    let_go = threading.Event()
    yield lambda: let_go.wait(120)
    let_go.set()


@pytest.fixture
def deadline(monkeypatch):
    monkeypatch.setattr(ending, "END_WITHIN_S", 0.05)
    deadline = Deadline()
    deadline.set()
    return deadline


def test_until_somebody_asks_for_the_end_everything_gets_its_time():
    assert Deadline().left_s(1000.0, keep_s=5.0) == 1000.0


def test_asking_for_the_end_again_gives_no_more_time(monkeypatch, deadline):
    monkeypatch.setattr(ending, "END_WITHIN_S", 1000.0)
    deadline.set()
    assert deadline.left_s(1000.0) <= 0.05


def test_a_lane_is_closed_in_reverse_order_whatever_goes_wrong_in_it():
    closed = []

    def fail():
        closed.append("b")
        raise DriverError("gone")

    def defect():
        closed.append("c")
        raise ZeroDivisionError("a defect")

    steps = [("a", lambda: closed.append("a")), ("b", fail), ("c", defect)]
    assert close_side_by_side({"lane": steps}, Deadline()) == ["c: ZeroDivisionError: a defect", "b: gone"]
    assert closed == ["c", "b", "a"]


def test_what_does_not_come_back_is_left_behind_and_keeps_no_other_from_being_closed(monkeypatch, hang):
    monkeypatch.setattr(ending, "END_WITHIN_S", 0.05)
    closed, deadline = [], Deadline()
    lanes = {  # the end is asked for by what is closed last, or a busy machine would be late with the others
        "outputs": [
            ("bell", deadline.set),
            ("motor", lambda: closed.append("motor")),
            ("base", lambda: closed.append("base")),
        ],
        "camera": [("camera", hang)],
    }
    assert close_side_by_side(lanes, deadline) == ["camera: it did not end in time, and was left behind"]
    assert closed == ["base", "motor"]


def test_asking_for_the_end_cuts_a_wait_short_that_has_begun(monkeypatch, hang):
    monkeypatch.setattr(ending, "END_WITHIN_S", 0.05)
    deadline = Deadline()
    asking = threading.Timer(0.05, deadline.set)
    asking.start()
    assert close_side_by_side({"phone": [("phone", hang)]}, deadline, wish_s=1000.0)
    asking.join()


def test_where_there_is_no_memory_for_a_thread_a_lane_is_closed_without_one(monkeypatch):
    def refuse(_thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    closed = []
    assert close_side_by_side({"lane": [("motor", lambda: closed.append("motor"))]}, Deadline()) == []
    assert closed == ["motor"]


def test_a_process_that_is_asked_to_end_while_it_is_being_suspended_ends(monkeypatch):
    monkeypatch.setattr(ending, "SETTLE_S", 0.0)
    suspended = []
    monkeypatch.setattr(signal, "raise_signal", suspended.append)
    ended = []
    with ending.stopping_on_signals(ended.append, make_safe=lambda: os.kill(os.getpid(), signal.SIGTERM) or []):
        os.kill(os.getpid(), signal.SIGTSTP)
    assert ended == ["SIGTERM"]
    assert suspended == []


def test_a_process_is_not_suspended_while_an_output_is_not_at_its_safe_value(monkeypatch, capfd):
    suspended = []
    monkeypatch.setattr(signal, "raise_signal", suspended.append)
    with ending.stopping_on_signals(lambda _name: None, make_safe=lambda: ["motor: its driver is busy"]):
        os.kill(os.getpid(), signal.SIGTSTP)
    assert suspended == []
    assert capfd.readouterr().err == "warning: SIGTSTP: not suspended: motor: its driver is busy\n"


def test_a_signal_that_is_ignored_or_taken_by_another_stays_so():
    heard = []
    before = {number: signal.getsignal(number) for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTSTP)}
    try:
        signal.signal(signal.SIGUSR1, lambda number, _frame: heard.append(number))
        signal.signal(signal.SIGUSR2, signal.SIG_IGN)
        signal.signal(signal.SIGTSTP, signal.SIG_IGN)
        with ending.stopping_on_signals(heard.append):
            for number in before:
                os.kill(os.getpid(), number)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert heard == [signal.SIGUSR1]
