"""Figures for people."""

from __future__ import annotations

import math
import re

from hypothesis import example, given
from hypothesis import strategies as st

from stadimeter.cli.formatting import (
    CENTIMETRE,
    FOOT,
    INCH,
    LENGTH_UNITS,
    METRE,
    UNKNOWN,
    LengthUnit,
    format_age,
    format_bearing,
    format_closing,
    format_distance,
    format_level,
    format_speed,
    format_time,
    format_turn,
    in_unit,
)

units = st.sampled_from(list(LENGTH_UNITS.values()))


def test_a_distance_has_the_digits_that_its_standard_deviation_supports() -> None:
    for distance_m, sigma_m, unit, text in [
        (2.4321, 0.041, METRE, "2.43 m ± 0.04"),
        (2.4321, 0.35, METRE, "2.4 m ± 0.3"),  # half to even, as Python rounds
        (2.4321, 0.096, METRE, "2.4 m ± 0.1"),  # rounding reaches the next digit
        (2.4321, 0.0041, METRE, "2.432 m ± 0.004"),
        (2.4321, 0.00001, METRE, "2.432 m ± 0.001"),  # never ± 0
        (2.4321, 0.0, METRE, "2.432 m"),
        (2.4321, None, METRE, "2.432 m"),
        (103.4, 12.0, METRE, "100 m ± 10"),
        (8.9996, 0.04, METRE, "9.00 m ± 0.04"),
        (2.4321, 0.041, CENTIMETRE, "243 cm ± 4"),
        (2.4321, 0.12, CENTIMETRE, "240 cm ± 10"),
        (2.4321, 0.041, FOOT, "8.0 ft ± 0.1"),
        (0.9144, 0.006, INCH, "36.0 in ± 0.2"),
        (0.0, 0.01, METRE, "0.00 m ± 0.01"),
        (None, 0.01, METRE, UNKNOWN),
        (math.nan, 0.01, METRE, UNKNOWN),
        (2.4, math.nan, METRE, UNKNOWN),
        (2.4, math.inf, METRE, UNKNOWN),
        (2.4, -0.1, METRE, UNKNOWN),
        (1e308, 0.1, INCH, UNKNOWN),
    ]:
        assert format_distance(distance_m, sigma_m, unit) == text


@given(st.floats(0, 1e6), st.floats(1e-9, 1e4), units)
def test_no_digit_is_shown_beyond_the_first_one_of_sigma(distance_m: float, sigma_m: float, unit: LengthUnit) -> None:
    number, plus_minus = re.fullmatch(r"([\d.]+) \w+ ± ([\d.]+)", format_distance(distance_m, sigma_m, unit)).groups()
    assert len(plus_minus.replace(".", "").strip("0")) == 1
    assert len(number.partition(".")[2]) == len(plus_minus.partition(".")[2])
    assert abs(float(number) - distance_m / unit.size_m) <= float(plus_minus) / 2 * 1.1 + 1e-6


@given(st.floats() | st.none(), st.floats() | st.none(), units)
@example(0.0, 1.5e308, METRE)
@example(-0.25, None, METRE)
@example(1.7e308, 9.6e307, METRE)
def test_whatever_the_figures_no_nan_and_no_infinity_is_shown(
    value: float | None, sigma: float | None, unit: LengthUnit
) -> None:
    texts = [
        format_distance(value, sigma, unit),
        format_speed(value, sigma, unit),
        format_closing(value, sigma, unit),
        format_bearing(value),
    ]
    assert not re.search(r"nan|inf|-0(\.0+)? (?!ft)|-0 ft 0\.0 in", " ".join(texts))


def test_a_speed_of_approach_is_told_only_when_it_is_clear() -> None:
    for closing_mps, sigma_mps, text in [
        (0.213, 0.02, "closing 0.21 m/s"),
        (-0.213, 0.02, "leaving 0.21 m/s"),
        (0.213, 0.2, "steady"),
        (0.5, 0.11, "closing 0.5 m/s"),
        (0.0, None, "steady"),
        (None, None, ""),
    ]:
        assert format_closing(closing_mps, sigma_mps) == text


def test_angles_levels_and_turns() -> None:
    assert [format_bearing(math.radians(angle)) for angle in (-3.2, 0.2, 12)] == ["3° left", "ahead", "12° right"]
    assert [format_level(level) for level in (0.0, 0.001, 0.62, 1.0)] == ["0 %", "<1 %", "62 %", "100 %"]
    assert [format_turn(turn) for turn in (0.1, -0.001)] == ["0.10 rad/s", "0.00 rad/s"]


def test_times_and_ages() -> None:
    assert [format_time(time_s) for time_s in (12.34, 599.9, 607.0, 3723.0)] == [
        "12.3 s",
        "599.9 s",
        "10:07",
        "1:02:03",
    ]
    assert [format_age(age_s) for age_s in (0.034, 2.06)] == ["34 ms", "2.1 s"]


def test_lengths_in_reasons_come_in_the_unit_asked_for() -> None:
    for words, in_feet, in_centimetres in [
        ("3.59 m ± 0.04, 3.05 m (off)", "11.8 ft ± 0.1, 10.0 ft (off)", "359 cm ± 4, 305 cm (off)"),
        ("2.002 m ± 0.004, below 0.50 m", "6.57 ft ± 0.01, below 1.6 ft", "200.2 cm ± 0.4, below 50 cm"),
        ("nearer than 3.05 m (10.0 ft)", "nearer than 10.0 ft", "nearer than 305 cm"),
        ("closing at 0.21 m/s ± 0.02, 12 ms", "closing at 0.7 ft/s ± 0.1, 12 ms", "closing at 21 cm/s ± 2, 12 ms"),
        ("room 2.05 mm, 7 min, 3 metres", "room 2.05 mm, 7 min, 3 metres", "room 2.05 mm, 7 min, 3 metres"),
    ]:
        assert in_unit(words, METRE) == words
        assert in_unit(words, FOOT) == in_feet
        assert in_unit(words, CENTIMETRE) == in_centimetres
