"""How long ago something was, across restarts of the program and of the computer."""

import pytest

from stadimeter.app.persistence.resumption import STEPPED, ClockReading, clock_name, elapsed_s

HOURS_3 = 3 * 3600.0


def at(at_s, unix_s=1e9, clock="boot 1", is_synchronised=True):
    return ClockReading(clock=clock, at_s=at_s, unix_s=unix_s, is_synchronised=is_synchronised)


@pytest.mark.parametrize("step_s", [0.0, HOURS_3, -HOURS_3])
def test_in_one_boot_the_monotonic_clock_says_it_whatever_happens_to_the_wall_clock(step_s):
    assert elapsed_s(at(100.0), at(107.5, unix_s=1e9 + 7.5 + step_s)) == 7.5


def test_after_another_boot_the_wall_clock_says_it():
    assert elapsed_s(at(5000.0), at(3.0, unix_s=1e9 + 60, clock="boot 2")) == 60.0


@pytest.mark.parametrize(("then", "now"), [(False, True), (True, False), (False, False)])
def test_a_wall_clock_that_was_not_right_both_times_says_nothing(then, now):
    before = at(5000.0, is_synchronised=then)
    assert elapsed_s(before, at(3.0, unix_s=1e9 + 60, clock="boot 2", is_synchronised=now)) == 0.0


def test_time_never_runs_backwards():
    assert elapsed_s(at(5000.0), at(3.0, unix_s=1e9 - 60, clock="boot 2")) == 0.0
    assert elapsed_s(at(100.0, clock=STEPPED), at(0.0, clock=STEPPED)) == 0.0


def test_the_clock_of_a_live_run_is_named_after_the_boot(tmp_path):
    boot = tmp_path / "boot_id"
    boot.write_text("6f6e6d36-1e83\n")
    assert clock_name(is_live=True, boot_id=boot) == "6f6e6d36-1e83"
    assert clock_name(is_live=False, boot_id=boot) == STEPPED


def test_where_the_kernel_names_no_boot_no_two_runs_share_a_clock(tmp_path):
    names = {clock_name(is_live=True, boot_id=tmp_path / "none") for _ in range(3)}
    assert len(names) == 3
