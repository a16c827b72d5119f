"""The two clocks."""

import subprocess
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.clock import MonotonicClock, SteppedClock
from stadimeter.testing.rig import ManualClock
from support.programs import require


def test_a_stepped_clock_never_goes_back():
    clock = SteppedClock(start_s=5.0)
    clock.sleep_until_s(1.0)
    assert clock.now_s() == 5.0


def test_what_is_due_on_the_way_is_called_at_its_own_time_and_in_order():
    clock, calls = ManualClock(), []
    clock.call_every(0.25, lambda now_s: calls.append(("a", now_s)))
    clock.call_every(0.5, lambda now_s: calls.append(("b", now_s)))
    clock.advance_s(1.0)
    assert calls == [("a", 0.25), ("a", 0.5), ("b", 0.5), ("a", 0.75), ("a", 1.0), ("b", 1.0)]


def test_a_cancelled_callback_is_not_called_again():
    clock, calls = ManualClock(), []
    cancel = clock.call_every(0.1, calls.append)
    clock.advance_s(0.15)
    cancel()
    cancel()
    clock.advance_s(1.0)
    assert len(calls) == 1


@pytest.mark.long
@given(st.lists(st.floats(0, 2), max_size=20))
def test_how_the_time_is_cut_into_steps_makes_no_difference(steps):
    whole, cut, calls, cut_calls = ManualClock(), ManualClock(), [], []
    whole.call_every(0.125, calls.append)
    cut.call_every(0.125, cut_calls.append)
    for step in steps:
        cut.advance_s(step)
    whole.sleep_until_s(cut.now_s())
    assert calls == cut_calls


def test_the_real_clock_calls_from_its_own_thread_until_cancelled():
    clock, called = MonotonicClock(), threading.Event()
    threads = []

    def callback(now_s):
        threads.append((threading.current_thread(), now_s))
        called.set()

    began_s = clock.now_s()
    cancel = clock.call_every(0.001, callback)
    assert called.wait(120)
    cancel()
    assert threads[0][0] is not threading.current_thread()
    assert threads[0][1] >= began_s
    assert not threads[0][0].is_alive()


def test_a_paced_clock_that_was_held_up_goes_on_from_there_instead_of_catching_up(monkeypatch):
    real_s, slept = [0.0], []
    monkeypatch.setattr("stadimeter.app.clock.time.monotonic", lambda: real_s[0])

    def sleep(seconds):
        slept.append(seconds)
        real_s[0] += seconds

    monkeypatch.setattr("stadimeter.app.clock.time.sleep", sleep)
    clock = SteppedClock(speed=1.0)
    clock.sleep_until_s(1.0)
    real_s[0] += 8.0
    for step in range(1, 11):
        clock.sleep_until_s(1.0 + step / 10)
    assert sum(slept) == pytest.approx(1.9), "all but the step in which it was noticed took its time"


def test_the_live_clock_goes_on_while_the_computer_sleeps():
    """Runs in a time namespace in which the computer has slept for a day, as far as its clocks can tell."""
    require("unshare")
    asleep_s = 86_400
    namespace = ["unshare", "--user", "--map-root-user", "--time", "--boottime", str(asleep_s), "--fork"]
    if subprocess.run([*namespace, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this computer makes no time namespaces")
    code = "import time, stadimeter.app.clock as c; print(c.MonotonicClock().now_s() - time.monotonic())"
    ran = subprocess.run([*namespace, sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert float(ran.stdout) == pytest.approx(asleep_s, abs=5.0)


def test_a_task_beside_a_stepped_clock_sleeps_in_the_order_of_time_and_holds_nothing_up():
    clock, calls = ManualClock(), []
    clock.call_every(0.25, lambda now_s: calls.append(("guard", now_s)))

    def task():
        for _ in range(2):
            calls.append(("task", clock.now_s()))
            clock.sleep_until_s(clock.now_s() + 0.375)
        calls.append(("done", clock.now_s()))

    clock.run_beside(task)
    assert calls == []
    clock.advance_s(0.5)
    assert (clock.now_s(), calls) == (0.5, [("task", 0.0), ("guard", 0.25), ("task", 0.375), ("guard", 0.5)])
    clock.advance_s(0.5)
    assert calls[4:] == [("guard", 0.75), ("done", 0.75), ("guard", 1.0)]


@pytest.mark.parametrize("make_clock", [MonotonicClock, ManualClock])
def test_a_task_that_is_no_longer_wanted_ends_at_its_next_sleep_and_cleans_up(make_clock):
    clock, began, cleaned_up = make_clock(), threading.Event(), threading.Event()

    def task():
        try:
            began.set()
            clock.sleep_until_s(clock.now_s() + 3600)
        finally:
            cleaned_up.set()

    end = clock.run_beside(task)
    clock.sleep_until_s(clock.now_s() + 0.001)
    assert began.wait(120)
    assert not cleaned_up.is_set()
    end()
    if isinstance(clock, ManualClock):
        clock.advance_s(3600)
    assert cleaned_up.wait(120)
