"""Durations in words."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.units import parse_duration
from stadimeter.core.words import duration, rounded_duration
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
