"""Durations in words."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.units import parse_duration
from stadimeter.core.words import duration, figure_in_words, length, rounded_duration, short_figure, uncertain_figure
from stadimeter.ranging.view_motion import ViewMotion
from support.each_case import each_case


@each_case(
    ("seconds", "words"),
    [(0.0, "0 s"), (0.25, "0.25 s"), (59.0, "59 s"), (60.0, "1 min"), (90.0, "90 s"), (91.0, "91 s"),
     (3600.0, "1 h"), (8 * 3600.0, "8 h"), (5400.0, "90 min"), (6000.0, "100 min")],
)  # fmt: skip
def test_a_configured_duration_is_written_in_the_largest_unit_that_leaves_it_whole(seconds, words):
    assert duration(seconds) == words


@given(st.integers(0, 10_000_000).map(lambda quarters: quarters / 4))
def test_a_written_duration_is_read_as_the_same_one(seconds):
    assert parse_duration(duration(seconds)) == pytest.approx(seconds, rel=1e-5)


@each_case(
    ("seconds", "words"),
    [(-0.3, "0.0 s"), (0.24, "0.2 s"), (119.9, "119.9 s"), (120.0, "2 min"), (754.0, "12.6 min"), (7200.0, "2 h"),
     (10_000.0, "2.78 h"), (25_920_000.0, "7200 h"),
     (math.inf, "ever")],
)  # fmt: skip
def test_a_measured_duration_is_rounded_to_three_digits(seconds, words):
    assert rounded_duration(seconds) == words


@each_case(
    ("value", "unit", "words"),
    [(2.434, "m", "2.43 m"), (0.0421, "m", "42.1 mm"), (0.004, "m/s", "4 mm/s"), (0.0023, "s", "2.3 ms"),
     (0.0, "m", "0.00 m"), (-0.0421, "m", "-42.1 mm"), (math.radians(12.34), "rad", "12.3°"),
     (math.radians(0.0421), "rad", "0.0421°"),
     (14.0, "times", "14 times"), (14 + 2 / 3, "times", "14.7 times"), (0.0012, "m/s²", "0.0012 m/s²")],
)  # fmt: skip
def test_a_figure_has_three_significant_digits_and_a_unit_of_its_size(value, unit, words):
    assert short_figure(value, unit) == words


def test_no_small_figure_is_written_as_nothing():
    assert length(0.004) == "4 mm (0.157 in)"
    assert uncertain_figure("sideways speed", 0.31, 0.0012, "m/s") == "sideways speed 0.31 m/s ± 0.0012"
    assert uncertain_figure("sideways speed", 0.031, 0.0012, "m/s") == "sideways speed 31 mm/s ± 1.2"


@each_case(("seconds", "words"), [(44 / 3, "14.7 s"), (10.25, "10.25 s"), (1234.5, "1234.5 s")])
def test_seconds_are_as_they_were_written_or_rounded(seconds, words):
    assert figure_in_words(seconds, "s") == words


def test_no_standard_deviation_is_written_as_nothing():
    motion = ViewMotion(pan_rad=0.01, tilt_rad=0.0, roll_rad=0.0, zoom=0.0, sigmas=(2e-5, 0.0, 1e-3, 2e-5), inliers=90)
    assert motion.in_words() == (
        "pan +0.57° ± 0.0011°, tilt +0.00° ± 0.00°, roll +0.00° ± 0.06°, zoom +0.00% ± 0.002% (90 features agree)"
    )
