"""Streams that are held up, on a clock that is stepped: what is believed of a picture, beside when it was captured."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from stadimeter.cameras.capture_time import SETTLE_S, StreamTime

WAY_S = 0.02
"""How long a picture is on its way when nothing holds it up."""


class Stream:
    """A camera whose pictures go through a queue that stands still at times.

    Args:
        period_s: Between two pictures.
        stall_s: For how long the queue stands still, from 5 s on.
        drain_s: The shortest time between two pictures that leave the queue.
        drops: Whether the pictures of the stall are thrown away and not queued.
        jitter: How irregular the way is, as a part of the period.
    """

    def __init__(self, period_s: float, stall_s: float, drain_s: float, *, drops: bool = False, jitter: float = 0.2):
        self.period_s, self.drain_s, self.drops, self.jitter = period_s, drain_s, drops, jitter
        self.stall = (5.0, 5.0 + stall_s)

    def __iter__(self) -> Iterator[tuple[float, float]]:
        """Yield capture and arrival of each picture."""
        rng = np.random.default_rng(4)
        last_s = 0.0
        for number in range(round((self.stall[1] + 15) / self.period_s)):
            captured_s = number * self.period_s
            left_s = captured_s + WAY_S + rng.uniform(0, self.jitter) * self.period_s
            if self.stall[0] <= left_s < self.stall[1]:
                if self.drops:
                    continue
                left_s = self.stall[1]
            last_s = max(left_s, last_s + self.drain_s)
            yield captured_s, last_s


STREAMS = [
    (period_s, stall_s, drain_s, drops)
    for period_s in (1 / 60, 1 / 30, 1 / 15, 0.2)
    for stall_s in (0.9, 2.0, 10.0)
    for drain_s in (0.0005, 0.005, 0.3 * period_s)
    for drops in (False, True)
]


@pytest.mark.parametrize("jitter", [0.2, 0.8])
@pytest.mark.parametrize("has_stamps", [False, True])
@pytest.mark.parametrize(("period_s", "stall_s", "drain_s", "drops"), STREAMS)
def test_no_picture_of_a_stall_looks_fresh_and_fresh_ones_are_believed_soon(
    period_s: float, stall_s: float, drain_s: float, drops: bool, has_stamps: bool, jitter: float
) -> None:
    stream = Stream(period_s, stall_s, drain_s, drops=drops, jitter=jitter)
    stream_time = StreamTime(WAY_S)
    believed: list[float] = []
    for captured_s, arrived_s in stream:
        stamp_s = 1e9 + captured_s if has_stamps else 0.0
        found_s = stream_time.captured_at_s(arrived_s, stamp_s)
        if found_s is not None:
            assert found_s <= captured_s + 2.5 * period_s, f"a picture of {captured_s:.2f} s is taken for fresh"
            if arrived_s - found_s < 0.2:
                believed.append(arrived_s)
    drained_s = stall_s * drain_s / (period_s - drain_s)
    again_s = next(at_s for at_s in believed if at_s > stream.stall[1])
    assert again_s - stream.stall[1] <= drained_s + SETTLE_S + 5 * period_s
    assert len([at_s for at_s in believed if at_s > again_s]) > 10 / period_s


@pytest.mark.parametrize("drain_s", [0.001, 0.01, 0.02])
def test_what_waited_while_a_stream_was_opened_is_passed_over(drain_s: float) -> None:
    stream_time = StreamTime()
    for number in range(600):
        captured_s = 5 + number / 30
        arrived_s = max(10 + number * drain_s, captured_s + WAY_S)
        found_s = stream_time.captured_at_s(arrived_s, 1e9 + captured_s)
        assert found_s is None or found_s <= captured_s + WAY_S + 0.05
    assert found_s == pytest.approx(arrived_s, abs=0.001)


def test_the_first_pictures_of_a_stream_without_time_stamps_are_passed_over() -> None:
    stream_time = StreamTime()
    stream_time.restart(2.0)
    found = [stream_time.captured_at_s(10 + number / 30) for number in range(90)]
    assert found[:59] == [None] * 59
    assert None not in found[61:]


def test_a_stated_latency_counts_into_the_age() -> None:
    stream_time = StreamTime(0.15)
    found = [stream_time.captured_at_s(10 + number / 30) for number in range(30)]
    assert found[-1] == pytest.approx(10 + 29 / 30 - 0.15)


def test_a_lag_that_grows_slowly_is_seen_and_two_clocks_that_run_apart_are_not_taken_for_one() -> None:
    lagging, drifting = StreamTime(), StreamTime()
    for number in range(9000):
        at_s = number / 30
        lagged_s = lagging.captured_at_s(at_s + 0.01 * at_s, 1e9 + at_s)
        drifted_s = drifting.captured_at_s(at_s, 1e9 + at_s * (1 - 1e-4))
    assert lagged_s == pytest.approx(299.97, abs=0.1)
    assert drifted_s == pytest.approx(at_s, abs=0.001)


@pytest.mark.parametrize(
    "stamp_of",
    [
        lambda _: 0.0,
        lambda _: math.nan,
        lambda _: math.inf,
        lambda at_s: 1e9 - at_s,
        lambda _: 1e9,
        lambda at_s: float(int(1e9 + at_s)),
        lambda at_s: 1e9 + (at_s * 7.7) % 1.0,
    ],
    ids=["none", "NaN", "infinite", "backwards", "constant", "whole seconds", "random"],
)
def test_stamps_that_are_nonsense_are_not_believed(stamp_of) -> None:
    stream_time = StreamTime()
    for number in range(300):
        at_s = number / 30
        found_s = stream_time.captured_at_s(at_s, stamp_of(at_s))
        assert found_s is None or found_s == at_s or stamp_of(at_s) > 0
    assert found_s == pytest.approx(at_s, abs=0.4)


def test_a_clock_of_the_sender_that_is_set_is_judged_anew() -> None:
    stream_time = StreamTime()
    for number in range(600):
        at_s = number / 30
        set_by_s = 0.0 if at_s < 5 else -3600.0 if at_s < 10 else 86400.0
        found_s = stream_time.captured_at_s(at_s, 1e9 + at_s + set_by_s)
    assert found_s == pytest.approx(at_s)


def test_a_camera_that_becomes_slower_or_faster_is_believed() -> None:
    stream_time = StreamTime()
    at_s, believed = 0.0, []
    for period_s in (1 / 30, 0.15, 1 / 60, 0.4, 1 / 15):
        for _ in range(round(6 / period_s)):
            at_s += period_s
            believed.append(stream_time.captured_at_s(at_s) is not None)
    assert sum(believed) / len(believed) > 0.95
    assert all(believed[-40:])


def test_a_camera_that_is_ten_times_as_fast_after_a_gap_is_believed_after_a_moment() -> None:
    stream_time = StreamTime()
    for number in range(60):
        stream_time.captured_at_s(number / 10)
    found = [stream_time.captured_at_s(15 + number / 100) for number in range(1500)]
    assert found[300] is not None
    assert all(found[300:])


def test_pictures_that_a_radio_link_delivers_in_threes_are_believed() -> None:
    stream_time = StreamTime()
    found = [stream_time.captured_at_s(0.1 * (number // 3) + 1e-3 * (number % 3)) for number in range(300)]
    assert all(found[12:])


def test_pictures_that_were_drained_in_one_go_count_each() -> None:
    stream_time = StreamTime()
    for number in range(60):
        stream_time.captured_at_s(number / 30)
    assert stream_time.captured_at_s(12.0, 0.0, 301) is None, "after ten seconds the newest of many may be old"
    assert stream_time.captured_at_s(12.0 + 1 / 30) is not None, "all that could wait has come"


def test_capture_times_never_go_back() -> None:
    stream_time, last_s = StreamTime(), -math.inf
    rng = np.random.default_rng(2)
    at_s = 0.0
    for _ in range(3000):
        at_s += rng.exponential(0.03)
        found_s = stream_time.captured_at_s(at_s, 1e9 + at_s + rng.normal(0, 0.05))
        if found_s is not None:
            assert last_s <= found_s <= at_s
            last_s = found_s
