"""Streams that are held up, on a clock that is stepped: what is believed of a picture, beside when it was captured."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.cameras.capture_time import (
    BLIND_SETTLE_S,
    GOOD_STAMPS_NEEDED,
    LONG_SETTLE_S,
    USUAL_INTERVALS,
    DriverStamp,
    KernelTime,
    StreamTime,
)
from support.each_case import each_case

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
        self.caught_up_s = self.stall[1] + (0.0 if drops else stall_s * drain_s / (period_s - drain_s))

    def __iter__(self) -> Iterator[tuple[float, float]]:
        """Yield capture and arrival of each picture."""
        rng = np.random.default_rng(4)
        last_s = 0.0
        for number in range(round((self.caught_up_s + 20) / self.period_s)):
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
    for drain_s in (0.0005, 0.3 * period_s, 0.9 * period_s)
    for drops in (False, True)
]


# What is known beside arrivals: the sender's stamps, whether the next picture has begun to come, or nothing.
KNOWN = ["stamps", "next", "nothing"]


@pytest.mark.long
@each_case("jitter", [0.2, 0.8])
@each_case("known", KNOWN)
@each_case(("period_s", "stall_s", "drain_s", "drops"), STREAMS)
def test_no_picture_of_a_stall_looks_fresh_and_fresh_ones_are_believed_soon(
    period_s: float, stall_s: float, drain_s: float, drops: bool, known: str, jitter: float
) -> None:
    stream = Stream(period_s, stall_s, drain_s, drops=drops, jitter=jitter)
    stream_time = StreamTime(WAY_S)
    believed: list[float] = []
    for (captured_s, arrived_s), (_, next_s) in itertools.pairwise(stream):
        stamp_s = 1e9 + captured_s if known == "stamps" else 0.0
        has_begun = next_s <= arrived_s + min(drain_s, 0.3 * period_s) + 1e-9 if known == "next" else None
        found_s = stream_time.captured_at_s(arrived_s, stamp_s, has_begun=has_begun)
        if found_s is not None:
            assert found_s <= captured_s + 2.5 * period_s, f"a picture of {captured_s:.2f} s is taken for fresh"
            if arrived_s - found_s < 0.2:
                believed.append(arrived_s)
    settle_s = max(BLIND_SETTLE_S, USUAL_INTERVALS * period_s) if known == "nothing" else LONG_SETTLE_S
    again_s = next(at_s for at_s in believed if at_s > stream.stall[1])
    assert again_s - stream.caught_up_s <= settle_s + (9 if known == "next" else 5) * period_s
    assert len([at_s for at_s in believed if at_s > again_s]) > 10 / period_s


@pytest.mark.parametrize("known", ["next", "nothing"])
def test_a_queue_that_stands_still_twice_and_drains_slowly_looks_fresh_at_no_time(known: str) -> None:
    for pause_s, drain in itertools.product((0.3, 0.7, 1.2), (1.1, 1.2, 1.5)):
        stream_time, arrived_s = StreamTime(WAY_S), 0.0
        for number in range(1800):
            captured_s = number / 30
            arrived_s = max(captured_s + WAY_S, arrived_s + 1 / 30 / drain)
            if number in (150, 165):  # the second time, half a second of what had waited has come
                arrived_s += 3.0 if number == 150 else pause_s
            found_s = stream_time.captured_at_s(arrived_s, has_begun=False if known == "next" else None)
            assert found_s is None or found_s < captured_s + 0.2
        assert found_s == pytest.approx(captured_s)


class Link:
    """A link of a limited rate behind a sender that keeps what it cannot send yet; see `Stream` for the rest.

    Args:
        share: The rate as a part of what the pictures need, from the 150th picture on; three times that before.
        until_s: When the link is as fast as before again.
    """

    def __init__(self, share: float, period_s: float, until_s: float = math.inf) -> None:
        self.share, self.period_s, self.until_s = share, period_s, until_s

    def __iter__(self) -> Iterator[tuple[float, float, bool]]:
        """Yield capture and arrival of each picture, and whether the next one has begun to arrive by then."""
        rng = np.random.default_rng(6)
        free_s = 0.0
        for number in range(150 + round(30 / self.period_s)):
            captured_s = number * self.period_s
            share = self.share if number >= 150 and max(free_s, captured_s) < self.until_s else 3.0
            free_s = max(free_s, captured_s) + self.period_s / share * rng.uniform(0.8, 1.2)
            # Once in eight times a packet ends between two pictures.
            yield captured_s, free_s + WAY_S, captured_s + self.period_s <= free_s - 1e-4 and rng.random() > 0.125


# Five pictures a second are too few to tell a tenth from jitter by arrivals alone.
LINKS = [
    (share, period_s, known)
    for share in (0.5, 0.7, 0.9)
    for period_s in (1 / 60, 1 / 30, 1 / 15, 0.2)
    for known in KNOWN
    if (share, period_s, known) != (0.9, 0.2, "nothing")
]


@pytest.mark.long
@each_case(("share", "period_s", "known"), LINKS)
def test_no_picture_of_a_link_that_is_too_slow_looks_fresh(share: float, period_s: float, known: str) -> None:
    stream_time = StreamTime(WAY_S)
    fresh = 0
    for captured_s, arrived_s, has_begun in Link(share, period_s):
        stamp_s = 1e9 + captured_s if known == "stamps" else 0.0
        begun = has_begun if known == "next" else None
        found_s = stream_time.captured_at_s(arrived_s, stamp_s, has_begun=begun)
        if found_s is not None and arrived_s - found_s < 0.2:
            assert arrived_s - captured_s < WAY_S + 0.35 + 3.5 * period_s
            fresh += 1
    assert fresh > 130, "before the link slows down, pictures are believed"


@pytest.mark.parametrize("known", KNOWN)
def test_pictures_are_believed_again_when_a_link_has_caught_up(known: str) -> None:
    stream_time, found = StreamTime(WAY_S), []
    for captured_s, arrived_s, has_begun in Link(0.7, 1 / 30, until_s=10.0):
        stamp_s = 1e9 + captured_s if known == "stamps" else 0.0
        found_s = stream_time.captured_at_s(arrived_s, stamp_s, has_begun=has_begun if known == "next" else None)
        found.append((captured_s, found_s))
    assert all(found_s == pytest.approx(captured_s, abs=0.1) for captured_s, found_s in found if captured_s > 15)


def test_a_link_that_is_too_slow_from_the_start_is_not_believed_without_stamps() -> None:
    stream_time = StreamTime()
    found = [stream_time.captured_at_s(number / 20, has_begun=True) for number in range(600)]
    assert found == [None] * 600
    assert "slower than the stream" in stream_time.why_late


def test_what_a_sender_kept_while_its_stream_was_opened_again_is_passed_over() -> None:
    stream_time = StreamTime()
    for number in range(150):
        stream_time.captured_at_s(number / 30, has_begun=False)
    stream_time.restart()
    for number in range(200):
        captured_s = 5 + number / 30  # the stream stood still from 5 s to 8 s, and was opened again
        arrived_s = max(8 + number / 100, captured_s)
        found_s = stream_time.captured_at_s(arrived_s, has_begun=False)
        assert found_s is None or found_s < captured_s + 0.1
    assert found_s == arrived_s


@pytest.mark.long
@each_case("step_s", [-3600.0, -5.0, -0.2, -0.01, 0.2, 2.0, 5.0, 3600.0])
@each_case("lag_s", [0.0, 0.5, 3.0])
def test_a_step_of_the_sender_s_clock_makes_no_old_picture_fresh(step_s: float, lag_s: float) -> None:
    stream_time = StreamTime()
    for number in range(1500):
        captured_s = number / 30
        arrived_s = captured_s + lag_s * min(1.0, max(0.0, (captured_s - 10) / 10))
        stamp_s = 1e9 + captured_s + (step_s if captured_s > 30 else 0.0)
        found_s = stream_time.captured_at_s(arrived_s, stamp_s)
        if found_s is not None:
            assert found_s < arrived_s - 0.25 or arrived_s - captured_s < 0.3, f"{captured_s:.2f} s looks fresh"
    assert found_s is not None


def test_a_stamp_that_stands_still_does_not_advance_the_capture_time() -> None:
    stream_time = StreamTime()
    found = [stream_time.captured_at_s(n / 30, 1e9 + min(n / 30, 5.0)) for n in range(300)]
    assert found[150] == pytest.approx(5.0)
    assert set(found[150:]) == {found[150]}


def test_a_sender_whose_stamps_end_is_not_believed_without_them() -> None:
    stream_time = StreamTime()
    for number in range(100):
        stream_time.captured_at_s(number / 30, 1e9 + number / 30)
    stream_time.restart()
    assert [stream_time.captured_at_s(5 + number / 30) for number in range(100)] == [None] * 100
    assert "time stamps are missing" in stream_time.why_late


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


@pytest.mark.long
def test_a_lag_that_grows_slowly_is_seen_and_two_clocks_that_run_apart_are_not_taken_for_one() -> None:
    lagging, drifting = StreamTime(), StreamTime()
    for number in range(9000):
        at_s = number / 30
        lagged_s = lagging.captured_at_s(at_s + 0.01 * at_s, 1e9 + at_s)
        drifted_s = drifting.captured_at_s(at_s, 1e9 + at_s * (1 - 1e-4))
    assert lagged_s == pytest.approx(299.97, abs=0.1)
    assert drifted_s == pytest.approx(at_s, abs=0.001)


@each_case(
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


def test_a_camera_that_becomes_slower_or_faster_is_believed_where_its_link_has_pauses() -> None:
    stream_time = StreamTime()
    at_s, believed = 0.0, []
    for period_s in (1 / 30, 0.15, 1 / 60, 0.4, 1 / 15):
        for _ in range(round(6 / period_s)):
            at_s += period_s
            believed.append(stream_time.captured_at_s(at_s, has_begun=False) is not None)
    assert sum(believed) / len(believed) > 0.95
    assert all(believed[-40:])


def test_a_slower_pace_is_believed_after_a_minute_where_nothing_else_is_known() -> None:
    stream_time = StreamTime()
    for number in range(300):
        stream_time.captured_at_s(number / 30)
    found = [stream_time.captured_at_s(10 + number / 15) for number in range(1000)]
    assert found[10:880] == [None] * 870
    assert None not in found[940:]


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
    assert stream_time.captured_at_s(5.0, 0.0, 91) is None, "after three seconds the newest of many may be old"
    assert stream_time.captured_at_s(5.0 + 1 / 30) is not None, "all that could wait has come"


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


# Stalls of every kind, on a stream of 30 pictures a second: a robot that believes pictures of up to 0.2 s, the frame
# age of `config/follow-ball.toml`, drives on old ones for 0.1 s at most, which moves it by 3 cm.
RATE_HZ, MAX_AGE_S, DROVE_S = 30.0, 0.2, 0.1
LEARNT_S = 20.0
KEPT = (0, 5, 30, 10**6)
"""How many pictures of a stall a sender keeps."""


def stalled(drain: float, seed: int, *, jitter: float = 0.2) -> Iterator[tuple[float, float]]:
    """Yield capture and arrival of pictures, of which some wait in a stall and leave at a multiple of the pace."""
    rng = random.Random(seed)  # noqa: S311 - the same stall for each seed
    stall_s, kept, period_s = rng.uniform(0.3, 5.0), rng.choice(KEPT), 1 / RATE_HZ
    every = [number * period_s for number in range(round((LEARNT_S + 2 * stall_s + 30) * RATE_HZ))]
    came = [(at_s, at_s + WAY_S + jitter * period_s * rng.random()) for at_s in every]
    over_s = LEARNT_S + stall_s
    waiting = [pair for pair in came if LEARNT_S <= pair[1] < over_s]
    gone = {at_s for at_s, _ in (waiting[:-kept] if kept else waiting)}
    last_s = 0.0
    for captured_s, arrived_s in came:
        if captured_s in gone:
            continue
        earliest_s = last_s + 1e-4
        if arrived_s >= LEARNT_S:
            earliest_s = max(over_s, last_s + period_s / drain * rng.uniform(1 - jitter, 1 + jitter))
        last_s = max(arrived_s, earliest_s)
        yield captured_s, last_s


def drove_on_old_s(arrivals: Iterator[tuple[float, float]], has_begun: bool | None) -> float:
    """Return for how long pictures were taken for fresh that were older than they seemed by `MAX_AGE_S`."""
    stream_time, drove_s, last_s = StreamTime(WAY_S), 0.0, 0.0
    for captured_s, arrived_s in arrivals:
        found_s = stream_time.captured_at_s(arrived_s, has_begun=has_begun)
        if found_s is not None and found_s - captured_s > MAX_AGE_S:
            drove_s += min(arrived_s - last_s, MAX_AGE_S)
        last_s = arrived_s
    return drove_s


@pytest.mark.long
@pytest.mark.parametrize("has_begun", [False, None])
@given(drain=st.floats(1.1, 20.0), seed=st.integers(0, 2**32), jitter=st.floats(0.0, 0.2))
def test_no_stall_that_drains_a_tenth_too_fast_is_driven_on(
    has_begun: bool | None, drain: float, seed: int, jitter: float
) -> None:
    assert drove_on_old_s(stalled(drain, seed, jitter=jitter), has_begun) <= DROVE_S


def test_a_stall_that_drains_hardly_faster_than_the_pace_is_driven_on() -> None:
    assert max(drove_on_old_s(stalled(1.02, seed), False) for seed in range(8)) > DROVE_S
