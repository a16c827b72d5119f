"""Edges of leases, stops and the guard: what a call must pass on, and what it must leave alone."""

import threading

import pytest

from stadimeter.app.guard import (
    BUSY_WAIT_S,
    FIRST_WAIT_S,
    PERIOD_S,
    REST_S,
    Guard,
    LeasedOutput,
    make_all_safe,
    retire_all,
)
from stadimeter.core.command import LevelCommand
from stadimeter.errors import LinkLostError
from stadimeter.testing.rig import ManualClock
from support.recording_doubles import RecordingActuator

SAFE = LevelCommand(output="motor", level=0.1)


class Ticking(RecordingActuator):
    """Remembers the times that it was ticked with."""

    def __init__(self, clock, name="motor"):
        super().__init__(clock, name)
        self.ticked_s = []

    def tick(self, now_s):
        super().tick(now_s)
        self.ticked_s.append((now_s, self._clock.now_s()))


@pytest.fixture
def clock():
    return ManualClock(start_s=128.0)


@pytest.fixture
def driver(clock):
    return Ticking(clock)


@pytest.fixture
def output(driver, clock):
    output = LeasedOutput(driver, SAFE, lease_s=0.25, clock=clock)
    output.open()
    return output


@pytest.fixture
def busy(output):
    """Let another thread be in the output's driver, as one that hangs is."""
    entered, leave = threading.Event(), threading.Event()

    def hang():
        with output._lock:
            entered.set()
            assert leave.wait(120)

    thread = threading.Thread(target=hang)
    thread.start()
    assert entered.wait(120)
    yield output
    leave.set()
    thread.join()


def full(captured_at_s):
    return LevelCommand(output="motor", level=1.0, captured_at_s=captured_at_s)


def fail(driver, output, *, on=("apply",), error=None):
    driver.fail_with, driver.fail_on = error or LinkLostError("unplugged"), on
    output.apply(full(1e9))


def test_a_frame_of_exactly_the_lease_still_counts(output, driver, clock):
    output.apply(full(127.75))
    assert driver.level == 1.0
    output.check(128.0)
    assert driver.level == 1.0
    output.check(128.015625)
    assert driver.level == 0.1


@pytest.mark.parametrize("state", ["in order", "stays off", "retired", "rests"])
def test_the_driver_is_ticked_with_the_clock_of_the_run(clock, state):
    driver = Ticking(clock)
    output = LeasedOutput(driver, SAFE, lease_s=0.25, clock=clock, stays_off=state == "stays off")
    output.open()
    Guard([output], clock).start()
    if state in {"stays off", "rests"}:
        fail(driver, output)
        driver.fail_with = None
    if state == "retired":
        output.retire()
    clock.advance_s(FIRST_WAIT_S + 0.5)
    last = driver.ticked_s[-3:]
    assert [given_s for given_s, _ in last] == [now_s for _, now_s in last]
    assert last[0][0] >= clock.now_s() - 4 * PERIOD_S


def test_a_check_leaves_an_output_alone_whose_driver_is_busy(busy):
    busy.check(128.0)


def test_making_it_safe_leaves_an_output_alone_whose_driver_is_busy(busy, driver):
    busy.make_safe()
    assert driver.commands == [SAFE]


def test_stopping_waits_for_a_busy_driver_only_after_every_other_output_was_stopped(busy, clock):
    other = RecordingActuator(clock, "buzzer")
    free = LeasedOutput(other, LevelCommand(output="buzzer", level=0.0), 0.25, clock)
    free.open()
    order = []
    retire, stop = busy.retire, other.stop

    def retire_noted(wait_s):
        order.append(("motor", wait_s))
        retire(wait_s)

    def stop_noted():
        order.append(("buzzer", 0.0))
        stop()

    busy.retire, other.stop = retire_noted, stop_noted
    assert retire_all([busy, free]) == [
        "motor: its driver is busy and does not come back; it is stopped as soon as it does"
    ]
    assert order[:2] == [("motor", 0.0), ("buzzer", 0.0)]
    assert [name for name, _ in order[2:]] == ["motor"]
    assert 0.0 < order[2][1] <= BUSY_WAIT_S


def test_making_it_safe_applies_the_safe_value_and_the_next_check_keeps_it(output, driver):
    output.apply(full(128.0))
    output.make_safe()
    assert driver.commands[-1] == SAFE
    output.check(129.0)
    assert driver.commands.count(SAFE) == 2


@pytest.mark.parametrize("why", ["fault", "retired"])
def test_making_it_safe_sends_nothing_to_a_driver_that_is_out_of_order_or_retired(output, driver, why):
    if why == "fault":
        fail(driver, output)
    else:
        output.retire()
    sent = len(driver.commands)
    output.make_safe()
    assert len(driver.commands) == sent


def test_a_driver_that_fails_while_it_is_made_safe_is_out_of_order(output, driver):
    driver.fail_with = LinkLostError("unplugged")
    output.make_safe()
    assert output.fault == "unplugged"


def test_a_driver_that_opens_but_refuses_its_safe_value_is_not_in_order(output, driver, clock):
    Guard([output], clock).start()
    fail(driver, output)
    clock.advance_s(FIRST_WAIT_S + REST_S + 0.3)
    output.observed_fault()
    clock.advance_s(0.2)
    assert output.fault == "unplugged"


def test_a_closed_output_has_stopped_and_released_its_driver(output, driver):
    output.apply(full(128.0))
    output.close()
    assert not driver.is_open
    assert driver.stop_times_s == [128.0]


def test_a_guard_that_was_stopped_watches_no_more_and_may_be_stopped_again(output, driver, clock):
    guard = Guard([output], clock)
    guard.end_watching()
    guard.start()
    guard.end_watching()
    guard.end_watching()
    output.apply(full(128.0))
    clock.advance_s(10.0)
    assert driver.level == 1.0
    assert guard.failure is None


def test_an_output_that_is_not_open_yet_has_nothing_to_be_put_at_and_is_in_order(driver, clock):
    output = LeasedOutput(driver, SAFE, lease_s=0.25, clock=clock)
    assert make_all_safe([output]) == []
    output.open()
    assert output.apply(full(128.0)) == full(128.0)


def test_an_output_that_could_be_opened_only_later_is_put_at_its_safe_value_too(driver, clock):
    output = LeasedOutput(driver, SAFE, lease_s=9.0, clock=clock)
    output.open_later(LinkLostError("absent"))
    Guard([output], clock).start()
    while output.observed_fault():
        clock.advance_s(0.5)
    output.apply(full(clock.now_s()))
    assert driver.level == 1.0
    assert make_all_safe([output]) == []
    assert driver.level == 0.1


def test_a_busy_output_is_waited_for_and_then_said_not_to_be_at_its_safe_value(busy):
    assert make_all_safe([busy]) == ["motor: its driver is busy and does not come back"]
