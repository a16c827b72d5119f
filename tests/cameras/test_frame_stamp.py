from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.cameras.capture_time import GOOD_STAMPS_NEEDED, DriverStamp, KernelTime

PERIOD_S = 1 / 30
LATENCY_S = 0.02


def trusted(arrived_at_s: float = 100.0) -> DriverStamp:
    """Return a judge that has seen good stamps up to that arrival."""
    stamp = DriverStamp()
    for number in range(GOOD_STAMPS_NEEDED, -1, -1):
        arrival_s = arrived_at_s - number * PERIOD_S
        stamp.captured_at_s(arrival_s - LATENCY_S, arrival_s)
    assert stamp.is_trusted
    return stamp


def test_good_stamps_are_used_once_a_few_of_them_agree_and_frames_before_that_have_no_time() -> None:
    stamp = DriverStamp()
    arrivals_s = [100.0 + number * PERIOD_S for number in range(6)]
    captured_s = [stamp.captured_at_s(arrival_s - LATENCY_S, arrival_s) for arrival_s in arrivals_s]
    assert captured_s[:2] == [None, None]
    assert captured_s[2:] == [arrival_s - LATENCY_S for arrival_s in arrivals_s[2:]]


def test_a_driver_without_stamps_gets_arrival_times() -> None:
    stamp = DriverStamp()
    assert [stamp.captured_at_s(0.0, second) for second in (0.5, 0.6, 0.7, 0.8, 0.9)] == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert not stamp.is_trusted


def test_a_driver_with_one_stamp_for_all_gets_arrival_times() -> None:
    stamp = DriverStamp()
    assert [stamp.captured_at_s(9.9, second) for second in (10.0, 10.1, 10.2, 10.3)] == [None, 10.1, 10.2, 10.3]


@pytest.mark.parametrize("epoch_s", [1.7e9, 50.0, 98.9], ids=["wall clock", "long ago", "just too old"])
def test_stamps_of_another_epoch_are_never_trusted(epoch_s: float) -> None:
    stamp = DriverStamp()
    for number in range(10):
        assert stamp.captured_at_s(epoch_s + number, 100.0 + number) == 100.0 + number
    assert not stamp.is_trusted


@pytest.mark.parametrize("stamp_s", [100.5, 99.5, math.nan], ids=["in the future", "goes back", "no number"])
def test_a_stamp_that_cannot_be_gives_the_arrival(stamp_s: float) -> None:
    stamp = trusted(100.0)
    assert stamp.captured_at_s(stamp_s, 100.1) == 100.1
    assert not stamp.is_trusted


def test_trust_comes_back_after_a_wild_stamp() -> None:
    stamp = trusted(100.0)
    stamp.captured_at_s(1e9, 100.1)
    captured_s = [stamp.captured_at_s(100.1 + n * PERIOD_S, 100.1 + n * PERIOD_S + LATENCY_S) for n in range(1, 6)]
    assert captured_s[-1] == 100.1 + 5 * PERIOD_S


def test_a_frame_that_waited_in_the_queue_is_as_old_as_it_is() -> None:
    stamp = trusted(100.0)
    assert stamp.captured_at_s(100.03, 105.0) == 100.03


def test_a_picture_that_stands_still_does_not_get_younger() -> None:
    stamp = trusted(100.0)
    still_s = stamp.captured_at_s(100.02, 100.04)
    assert [stamp.captured_at_s(100.02, 100.04 + later) for later in (0.1, 0.5, 3.0)] == [still_s] * 3


def test_an_opened_device_is_judged_anew_and_time_does_not_go_back() -> None:
    stamp = trusted(100.0)
    last_s = stamp.captured_at_s(100.01, 100.02)
    stamp.restart()
    assert not stamp.is_trusted
    assert [stamp.captured_at_s(99.99 + n / 1e3, 99.995 + n / 1e3) for n in range(3)] == [None, None, last_s]


@given(
    st.lists(
        st.tuples(st.floats(0, 0.5), st.one_of(st.floats(-2, 2), st.just(math.nan), st.floats(-1e9, 1e9))), max_size=60
    )
)
def test_capture_times_never_go_back_nor_past_the_arrival(steps: list[tuple[float, float]]) -> None:
    stamp, arrived_at_s, captured_s = DriverStamp(), 1000.0, [-math.inf]
    for gap_s, age_s in steps:
        arrived_at_s += gap_s
        at_s = stamp.captured_at_s(arrived_at_s - age_s, arrived_at_s)
        if at_s is None:
            assert not stamp.is_trusted
            continue
        captured_s.append(at_s)
        assert captured_s[-1] <= arrived_at_s
    assert all(earlier <= later for earlier, later in pairwise(captured_s))


def test_a_stamp_of_the_kernel_is_brought_to_the_run_s_clock() -> None:
    kernel = KernelTime(lambda: 50.0)
    assert kernel.on_run_clock(49.97, 1050.0) == pytest.approx(1049.97)
    assert kernel.on_run_clock(0.0, 1050.0) == 0.0
    assert kernel.on_run_clock(-1.0, 1050.0) == 0.0


def test_a_frame_from_before_a_suspend_is_as_old_as_the_suspend_was_long() -> None:
    now = iter([50.0, 50.1, 50.2])
    kernel = KernelTime(lambda: next(now))
    kernel.on_run_clock(49.97, 50.0)
    assert kernel.on_run_clock(50.05, 3650.1) == pytest.approx(50.05)
    assert kernel.on_run_clock(50.17, 3650.2) == pytest.approx(3650.17)


def test_a_stated_latency_counts_where_stamps_are_not_trusted() -> None:
    stamp = DriverStamp(latency_s=0.05)
    assert stamp.captured_at_s(0.0, 10.0) == pytest.approx(9.95)
    for number in range(4):
        found_s = stamp.captured_at_s(10.08 + number / 10, 10.1 + number / 10)
    assert found_s == pytest.approx(10.38)
