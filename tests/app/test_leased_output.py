"""Outputs with a lease, and the guard that watches over them."""

import threading
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.guard import REST_S, RESTING, Guard, LeasedOutput, make_all_safe, retire_all
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.errors import DeviceOpenError, LinkLostError
from stadimeter.testing.rig import ManualClock, eventually
from support.recording_doubles import RecordingActuator, RecordingBase

SAFE = LevelCommand(output="motor", level=0.1)


@pytest.fixture
def clock():
    return ManualClock(start_s=100.0)


@pytest.fixture
def driver(clock):
    return RecordingActuator(clock, "motor")


@pytest.fixture
def output(driver, clock):
    output = LeasedOutput(driver, SAFE, lease_s=0.3, clock=clock)
    output.open()
    return output


def full(captured_at_s):
    return LevelCommand(output="motor", level=1.0, captured_at_s=captured_at_s)


def test_it_opens_at_its_safe_value(output, driver):
    assert driver.level == 0.1


def test_a_fresh_command_is_applied_and_returned(output, driver):
    assert output.apply(full(99.9)) == full(99.9)
    assert driver.level == 1.0


def test_a_command_on_an_old_frame_is_not_applied(output, driver):
    assert output.apply(full(99.6)) == SAFE
    assert driver.level == 0.1


@pytest.mark.parametrize("seconds", [0.31, 1.0, 3600.0])
def test_a_command_that_nobody_renews_ends_with_its_lease(output, driver, clock, seconds):
    Guard([output], clock).start()
    output.apply(full(100.0))
    clock.advance_s(0.29)
    assert driver.level == 1.0
    clock.advance_s(seconds)
    assert driver.level == 0.1


def test_what_counts_is_the_age_of_the_frame_and_not_of_the_command(output, driver, clock):
    Guard([output], clock).start()
    output.apply(full(99.75))
    clock.advance_s(0.1)
    assert driver.level == 0.1


def test_renewing_with_the_same_frame_does_not_help(output, driver, clock):
    for _ in range(10):
        output.apply(full(100.0))
        clock.advance_s(0.1)
    assert driver.level == 0.1


def test_the_safe_value_never_grows_old(output, driver, clock):
    Guard([output], clock).start()
    output.apply(SAFE)
    clock.advance_s(3600)
    assert driver.commands == [SAFE, SAFE]


def test_a_command_is_sent_again_twenty_times_a_second_while_its_frame_is_fresh(driver, clock):
    """A detector of two frames a second must not let a board stand that waits no longer than 100 ms."""
    output = LeasedOutput(driver, SAFE, lease_s=1.0, clock=clock)
    output.open()
    Guard([output], clock).start()
    output.apply(full(100.0))
    clock.advance_s(2.0)
    sent_s = [call.at_s for call in driver.calls if call.command == full(100.0)]
    assert 19 <= len(sent_s) <= 21
    assert max(later - sooner for sooner, later in pairwise(sent_s)) <= 0.0801
    assert sent_s[-1] <= 101.0
    assert driver.level == 0.1


def test_a_driver_that_fails_is_stopped_and_takes_no_commands(output, driver):
    driver.fail_with = LinkLostError("unplugged")
    assert output.apply(full(100.0)) is None
    assert output.fault == "unplugged"
    assert output.acts_since_s() is None
    assert driver.stop_times_s == [100.0]
    driver.fail_with = None
    assert output.apply(full(100.0)) is None
    assert driver.level == 0.0


@pytest.fixture
def guarded(output, clock):
    guard = Guard([output], clock)
    guard.start()
    return guard


def break_it(driver, output, *, on=("apply",)):
    driver.fail_with, driver.fail_on = LinkLostError("unplugged"), on
    output.apply(full(1e9))


def opened_at_s(driver):
    return [call.at_s for call in driver.calls if call.action == "open"][1:]


def test_a_driver_that_answers_again_is_opened_anew_and_rests_before_it_acts(guarded, output, driver, clock):
    break_it(driver, output)
    driver.fail_with = None
    clock.advance_s(0.6)
    assert opened_at_s(driver) == pytest.approx([100.5], abs=0.03)
    assert output.observed_fault() == RESTING
    clock.advance_s(2.8)
    assert output.apply(full(clock.now_s())) is None
    assert driver.level == SAFE.level, "it rests at its safe value"
    clock.advance_s(0.2)
    assert output.observed_fault() == ""
    assert driver.level == SAFE.level
    assert output.apply(full(clock.now_s())) is not None


def test_a_fault_that_the_control_loop_has_not_seen_does_not_end(guarded, output, driver, clock):
    break_it(driver, output)
    driver.fail_with = None
    clock.advance_s(60)
    assert output.apply(full(clock.now_s())) is None, "a hanging loop may have decided this before the fault"
    assert output.observed_fault() == RESTING
    clock.advance_s(0.1)
    assert output.observed_fault() == ""


def test_the_waits_before_a_driver_is_opened_again_grow(guarded, output, driver, clock):
    break_it(driver, output, on=("apply", "open"))
    clock.advance_s(33)
    waits = [later - earlier for earlier, later in pairwise([100.0, *opened_at_s(driver)])]
    assert waits == pytest.approx([0.5, 1, 2, 4, 8, 8, 8], abs=0.05)


def recover(output, driver, clock):
    driver.fail_with = None
    while output.observed_fault():
        clock.advance_s(0.1)


def test_the_waits_go_on_growing_for_a_driver_that_fails_again_soon(guarded, output, driver, clock):
    for wait_s in (0.5, 1, 2):
        failed_at_s = clock.now_s()
        break_it(driver, output)
        recover(output, driver, clock)
        assert opened_at_s(driver)[-1] - failed_at_s == pytest.approx(wait_s, abs=0.03)
        clock.advance_s(5)
    clock.advance_s(60)
    failed_at_s = clock.now_s()
    break_it(driver, output)
    recover(output, driver, clock)
    assert opened_at_s(driver)[-1] - failed_at_s == pytest.approx(0.5, abs=0.03)


def test_a_driver_that_fails_while_it_rests_is_out_of_order_again(guarded, output, driver, clock):
    break_it(driver, output)
    driver.fail_with = None
    clock.advance_s(1)
    driver.fail_with, driver.fail_on = LinkLostError("unplugged again"), ("tick",)
    clock.advance_s(0.1)
    assert output.observed_fault() == "unplugged again"
    assert driver.level == 0.0


def test_a_driver_that_shall_stay_off_is_not_opened_again(driver, clock):
    output = LeasedOutput(driver, SAFE, lease_s=0.3, clock=clock, stays_off=True)
    output.open()
    Guard([output], clock).start()
    break_it(driver, output)
    driver.fail_with = None
    clock.advance_s(3600)
    assert opened_at_s(driver) == []
    assert output.apply(full(clock.now_s())) is None
    assert output.fault == "unplugged"


class SlowToOpen(RecordingActuator):
    """An actuator that takes two seconds to open, but for the first time."""

    def open(self):
        super().open()
        if len(self.calls) > 1:
            self._clock.sleep_until_s(self._clock.now_s() + 2.0)


@pytest.fixture
def slow(clock):
    driver = SlowToOpen(clock, "motor")
    output = LeasedOutput(driver, SAFE, lease_s=0.3, clock=clock)
    output.open()
    Guard([output], clock).start()
    break_it(driver, output)
    driver.fail_with = None
    clock.advance_s(1.0)
    assert driver.is_open, "it is being opened"
    return output, driver


def test_opening_again_holds_nothing_up(slow, clock):
    output, _driver = slow
    assert clock.now_s() == 101.0
    assert output.apply(full(101.0)) is None
    assert output.observed_fault() == "unplugged"
    clock.advance_s(2.0)
    assert output.observed_fault() == RESTING


def test_an_output_that_is_retired_while_its_driver_is_opened_again_never_moves(slow, clock):
    output, driver = slow
    commands = len(driver.commands)
    output.retire()
    output.close()
    clock.advance_s(10)
    assert not driver.is_open
    assert len(driver.commands) == commands


def test_a_run_that_ends_does_not_wait_for_a_driver_that_is_being_opened_again():
    clock, opening = MonotonicClock(), threading.Event()

    class NeverOpens(RecordingActuator):
        def open(self):
            super().open()
            if len(self.calls) > 1:
                opening.set()
                try:
                    self._clock.sleep_until_s(self._clock.now_s() + 3600)
                except BaseException:
                    self.close()
                    closed.set()
                    raise

    closed = threading.Event()
    driver = NeverOpens(clock, "motor")
    output = LeasedOutput(driver, SAFE, lease_s=0.3, clock=clock)
    output.open()
    guard = Guard([output], clock)
    guard.start()
    break_it(driver, output)
    assert opening.wait(120)
    assert retire_all([output]) == []
    guard.end_watching()
    output.close()
    assert closed.wait(120)


class Flaky(RecordingActuator):
    """An actuator that keeps when it failed, and what it did when."""

    def __init__(self, clock):
        super().__init__(clock, "motor")
        self.failed_at_s, self.moved = [], []

    def _fail_if_asked(self, action):
        try:
            super()._fail_if_asked(action)
        except LinkLostError:
            self.failed_at_s.append(self._clock.now_s())
            raise

    def apply(self, command):
        applied = super().apply(command)
        if command != SAFE:
            self.moved.append((self._clock.now_s(), len(self.failed_at_s)))
        return applied


steps = st.sampled_from(
    [("break", (action,)) for action in ("open", "apply", "tick", "stop", "close")]
    + [("mend", None)] * 4
    + [("pass", seconds) for seconds in (0.01, 0.1, 0.5, 1.0, 3.0)]
    + [("cycle", None)] * 5
)


@given(st.lists(steps, min_size=10, max_size=60))
def test_whatever_fails_when_nothing_moves_before_a_whole_rest_without_a_fault(steps):
    clock = ManualClock(start_s=100.0)
    driver = Flaky(clock)
    output = LeasedOutput(driver, SAFE, lease_s=0.3, clock=clock)
    output.open()
    Guard([output], clock).start()
    for what, value in steps:
        if what == "break":
            driver.fail_with, driver.fail_on = LinkLostError("broken"), value
        elif what == "mend":
            driver.fail_with = None
        elif what == "pass":
            clock.advance_s(value)
        else:
            command = SAFE if output.observed_fault() else full(clock.now_s())
            output.apply(command)
    for moved_at_s, failures in driver.moved:
        if failures:
            assert moved_at_s - driver.failed_at_s[failures - 1] >= REST_S
    driver.fail_with = None
    while output.observed_fault():
        clock.advance_s(0.5)
    assert output.apply(full(clock.now_s())) is not None, "and it always comes back"


DEFECTS = pytest.mark.parametrize("defect", [IndexError, SystemExit, KeyboardInterrupt, MemoryError])


@DEFECTS
def test_a_defect_that_comes_up_while_a_driver_is_opened_again_ends_the_run(guarded, output, driver, clock, defect):
    break_it(driver, output)

    def defective():
        raise defect("a defect")

    driver.open = defective
    clock.advance_s(0.6)
    assert isinstance(guarded.failure, defect)


def test_a_driver_that_cannot_even_stop_is_reported_with_both_troubles(output, driver):
    driver.fail_with, driver.fail_on = LinkLostError("unplugged"), ("apply", "stop")
    output.apply(full(100.0))
    assert output.fault == "unplugged; stopping it failed too: unplugged"


def test_a_driver_that_could_not_be_stopped_counts_as_acting_until_it_is_opened_again(guarded, output, driver, clock):
    """The watchdog process hears of it in every cycle: if the program hangs, somebody must stop what goes on moving."""
    break_it(driver, output, on=("apply", "stop", "open"))
    assert output.acts_since_s() == clock.now_s()
    clock.advance_s(0.3)
    assert output.acts_since_s() == clock.now_s()
    driver.fail_with = None
    clock.advance_s(10.0)
    assert output.acts_since_s() is None


def test_a_failure_between_commands_is_noticed_as_well(output, driver, clock):
    Guard([output], clock).start()
    driver.fail_with, driver.fail_on = LinkLostError("no answer for 0.5 s"), ("tick",)
    clock.advance_s(0.1)
    assert output.fault == "no answer for 0.5 s"


def test_no_output_moves_while_another_one_is_being_stopped(clock):
    """All are forbidden to move before the first is stopped: that one may take its time."""
    drivers = [RecordingActuator(clock, name) for name in ("a", "b")]
    outputs = [LeasedOutput(d, LevelCommand(output=n, level=0), 0.3, clock) for d, n in zip(drivers, "ab", strict=True)]
    for each in outputs:
        each.open()

    applied = []

    def slow_stop():
        applied.append(outputs[1].apply(LevelCommand(output="b", level=1.0, captured_at_s=clock.now_s())))

    drivers[0].stop = slow_stop
    assert retire_all(outputs) == []
    assert applied == [None]


def test_a_retired_output_stays_off_whatever_comes(output, driver):
    output.apply(full(100.0))
    output.retire()
    assert driver.level == 0.0
    assert output.apply(full(100.0)) is None
    assert driver.level == 0.0


def test_a_command_that_a_signal_handler_interrupts_does_not_move_it_again(output, driver):
    apply = driver.apply

    def interrupted(command):
        output.retire()
        return apply(command)

    driver.apply = interrupted
    assert output.apply(full(100.0)) is None
    assert driver.level == 0.0


def test_a_command_that_a_signal_handler_interrupts_to_suspend_the_process_ends_at_the_safe_value(output, driver):
    apply = driver.apply

    def interrupted(command):
        driver.apply = apply
        assert make_all_safe([output]) == []
        return apply(command)

    driver.apply = interrupted
    assert output.apply(full(99.9)) == SAFE
    assert driver.level == 0.1
    assert output.apply(full(99.9)) == full(99.9), "the next cycle may command it again"


@DEFECTS
def test_every_output_is_stopped_even_if_one_fails(clock, defect):
    drivers = [RecordingActuator(clock, name) for name in ("a", "b", "c")]
    outputs = [
        LeasedOutput(d, LevelCommand(output=n, level=0), 0.3, clock) for d, n in zip(drivers, "abc", strict=True)
    ]
    for each in outputs:
        each.open()
    drivers[0].fail_with, drivers[0].fail_on = LinkLostError("gone"), ("stop",)

    def defective():
        raise defect("a defect")

    drivers[1].stop = defective
    assert retire_all(outputs) == ["a: gone", f"b: {defect.__name__}: a defect"]
    assert drivers[2].stop_times_s == [100.0]


@DEFECTS
def test_a_defect_in_a_driver_stops_all_outputs_and_is_kept_for_the_loop(output, driver, clock, defect):
    base = RecordingBase(clock, "base")
    still = TwistCommand(output="base", linear_mps=0, angular_radps=0)
    other = LeasedOutput(base, still, 0.3, clock)
    other.open()

    def defective(now_s):
        raise defect("a defect")

    driver.tick = defective
    guard = Guard([output, other], clock)
    guard.start()
    clock.advance_s(0.05)
    assert isinstance(guard.failure, defect)
    assert base.stop_times_s


def test_a_driver_that_asks_for_the_end_leaves_no_output_without_a_guard_while_another_hangs_the_loop():
    clock = MonotonicClock()
    hanging, base = Hanging(clock, "motor", "apply"), RecordingBase(clock, "base")
    still = TwistCommand(output="base", linear_mps=0, angular_radps=0)
    outputs = [LeasedOutput(hanging, SAFE, 60.0, clock), LeasedOutput(base, still, 60.0, clock)]
    for each in outputs:
        each.open()
    guard = Guard(outputs, clock)
    guard.start()
    outputs[1].apply(TwistCommand(output="base", linear_mps=0.3, angular_radps=0, captured_at_s=clock.now_s()))
    loop = threading.Thread(target=outputs[0].apply, args=(full(clock.now_s()),))
    loop.start()
    assert hanging.entered.wait(120)
    base.fail_with, base.fail_on = SystemExit(), ("tick",)
    assert eventually(lambda: base.current is None)
    assert isinstance(guard.failure, SystemExit)
    hanging.let_go.set()
    loop.join()
    guard.end_watching()


def test_a_driver_that_cannot_be_opened_says_so(clock):
    driver = RecordingActuator(clock, "motor")
    driver.fail_with, driver.fail_on = DeviceOpenError("pin 18 is in use"), ("open",)
    with pytest.raises(DeviceOpenError, match="pin 18 is in use"):
        LeasedOutput(driver, SAFE, 0.3, clock).open()


def test_the_guard_ends_a_command_while_the_control_thread_hangs():
    clock = MonotonicClock()
    safe_again = threading.Event()

    class Motor(RecordingActuator):
        def apply(self, command):
            applied = super().apply(command)
            if command.captured_at_s is None and len(self.commands) > 2:
                safe_again.set()
            return applied

    output = LeasedOutput(Motor(clock), SAFE, lease_s=0.05, clock=clock)
    output.open()
    output.apply(SAFE)
    guard = Guard([output], clock)
    guard.start()
    output.apply(full(clock.now_s()))
    assert safe_again.wait(120), "the control thread waits here, and the guard acts"
    guard.end_watching()
    output.close()


class Hanging(RecordingActuator):
    """An actuator whose driver hangs in one of its methods until it is let go."""

    def __init__(self, clock, name, where):
        super().__init__(clock, name)
        self.where, self.entered, self.let_go = where, threading.Event(), threading.Event()

    def _hang(self, where):
        if where == self.where and self.commands:
            self.entered.set()
            assert self.let_go.wait(120)

    def tick(self, now_s):
        self._hang("tick")
        super().tick(now_s)

    def apply(self, command):
        applied = super().apply(command)
        if command.captured_at_s is not None:
            self._hang("apply")
        return applied


@pytest.mark.parametrize("where", ["apply", "tick"])
def test_a_driver_that_hangs_keeps_no_other_output_from_stopping(where):
    clock = MonotonicClock()
    hanging, other = Hanging(clock, "a", where), RecordingActuator(clock, "b")
    outputs = [
        LeasedOutput(driver, LevelCommand(output=name, level=0), lease_s=0.05, clock=clock)
        for driver, name in ((hanging, "a"), (other, "b"))
    ]
    for output in outputs:
        output.open()
    guard = Guard(outputs, clock)
    outputs[1].apply(LevelCommand(output="b", level=1.0, captured_at_s=clock.now_s()))
    command = LevelCommand(output="a", level=1.0, captured_at_s=clock.now_s() + 60)
    control = threading.Thread(target=outputs[0].apply, args=(command,))
    control.start()
    guard.start()
    try:
        assert hanging.entered.wait(120)
        while other.level:
            threading.Event().wait(0.001)
        troubles = retire_all(outputs)
        assert troubles == ["a: its driver is busy and does not come back; it is stopped as soon as it does"]
        assert other.stop_times_s
    finally:
        hanging.let_go.set()
        control.join()
        guard.end_watching()
    assert hanging.level == 0.0, "it was stopped when it came back"
