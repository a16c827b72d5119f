from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.actuators.pin_actuator import BeepPattern

TICK_S = 0.02


def make() -> BeepPattern:
    return BeepPattern(slowest_s=1.0, fastest_s=0.1, beep_s=0.05)


def beeps(sounding: list[bool]) -> int:
    return sum(now and not before for before, now in zip([False, *sounding], sounding, strict=False))


def listen(pattern: BeepPattern, levels: list[float], tick_s: float = TICK_S) -> list[bool]:
    return [pattern.sounds(level, index * tick_s) for index, level in enumerate(levels)]


def test_level_zero_is_silent() -> None:
    assert not any(listen(make(), [0.0] * 500))


def test_level_one_sounds_without_a_break() -> None:
    assert all(listen(make(), [1.0] * 500))


@pytest.mark.parametrize(("level", "expected"), [(1e-9, 10), (0.5, 32), (1 - 1e-9, 100)])
def test_the_rate_goes_from_the_slowest_to_the_fastest_in_equal_ratios(level: float, expected: int) -> None:
    sounding = listen(make(), [level] * 500)  # for 10 s; 32 is 10 s over 1 s times the square root of a tenth
    assert beeps(sounding) == pytest.approx(expected, abs=1)


def test_beeps_come_at_their_times_to_the_tick() -> None:
    pattern = make()
    at_ms = [ms for ms in range(3000) if pattern.sounds(1e-12, ms / 1000)]
    assert at_ms == [*range(50), *range(1000, 1050), *range(2000, 2050)]


def test_late_ticks_do_not_slow_the_beeping_down() -> None:
    pattern = make()
    sounding = [pattern.sounds(1e-12, index * 0.023) for index in range(4348)]  # 100 s
    assert beeps(sounding) == pytest.approx(100, abs=1)


def test_a_beep_that_fell_into_a_long_gap_between_ticks_is_made_up_for() -> None:
    pattern = make()
    assert pattern.sounds(0.5, 0.0)
    assert pattern.sounds(0.5, 0.9)
    assert pattern.sounds(0.5, 0.94)
    assert not pattern.sounds(0.5, 0.96)


def test_a_level_that_changes_all_the_time_neither_cuts_a_beep_short_nor_starves_the_next() -> None:
    levels = [0.3 + 0.4 * (index % 2) for index in range(500)]
    sounding = listen(make(), levels)
    assert 10 / 0.5012 - 1 <= beeps(sounding) <= 10 / 0.1995 + 1  # the periods at 0.3 and 0.7
    runs = "".join("#" if sound else "." for sound in sounding).strip(".").replace(".", " ").split()
    assert {len(run) for run in runs[:-1]} <= {2, 3}  # a beep of 50 ms is on for two or three ticks


def test_the_first_level_above_zero_beeps_at_once() -> None:
    pattern = make()
    listen(pattern, [0.1] * 20)
    assert not pattern.sounds(0.0, 0.5)
    assert pattern.sounds(0.1, 0.52)


def test_a_rising_level_brings_the_next_beep_forward() -> None:
    pattern = make()
    assert pattern.sounds(1e-9, 0.0)
    assert not pattern.sounds(1e-9, 0.3)
    assert pattern.sounds(0.9, 0.32)


def test_leaving_the_full_level_goes_over_into_beeps() -> None:
    sounding = listen(make(), [1.0] * 50 + [0.9] * 100)
    assert all(sounding[:50])
    assert not all(sounding[50:56])
    assert beeps(sounding[50:]) == pytest.approx(2.0 / 0.126, abs=2)


@pytest.mark.long
@given(levels=st.lists(st.floats(0.01, 1.0), min_size=60, max_size=200))
def test_whatever_the_level_does_above_zero_it_sounds_at_least_once_in_the_slowest_period(levels: list[float]) -> None:
    sounding = listen(make(), levels)
    window = round(1.0 / TICK_S) + 1
    assert all(any(sounding[start : start + window]) for start in range(len(sounding) - window + 1))


@given(levels=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=100))
def test_asking_twice_for_one_time_gives_the_same_answer(levels: list[float]) -> None:
    once, twice = make(), make()
    for index, level in enumerate(levels):
        first = twice.sounds(level, index * TICK_S)
        assert twice.sounds(level, index * TICK_S) == first == once.sounds(level, index * TICK_S)
