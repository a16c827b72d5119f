"""Ranges of colours, as people write them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stadimeter.detectors.hsv import HsvRange, parse_hsv_range
from stadimeter.detectors.sampling import in_light, light_table
from support.each_case import each_case

pytestmark = pytest.mark.vision


def _pixel(blue: int, green: int, red: int) -> np.ndarray:
    return np.full((1, 1, 3), (blue, green, red), np.uint8)


def test_the_tutorials_green() -> None:
    green = parse_hsv_range("29,86,6:64,255,255")
    assert green == HsvRange((29, 86, 6), (64, 255, 255))
    assert green.mask(_pixel(40, 200, 80))[0, 0] == 255
    assert green.mask(_pixel(200, 80, 40))[0, 0] == 0


def test_a_lower_hue_above_the_upper_one_wraps_through_red() -> None:
    red = parse_hsv_range("170,100,60:10,255,255")
    for bgr in ((0, 0, 200), (40, 0, 200), (0, 30, 200)):  # hue 0, 174 and 4
        assert red.mask(_pixel(*bgr))[0, 0] == 255
    for bgr in ((0, 200, 0), (200, 0, 0), (0, 120, 200)):
        assert red.mask(_pixel(*bgr))[0, 0] == 0


def test_a_pixel_that_is_all_but_grey_has_no_hue() -> None:
    dark_green = _pixel(10, 14, 10)
    assert parse_hsv_range("40,0,0:80,255,255").mask(dark_green)[0, 0] == 0
    assert parse_hsv_range("0,0,0:179,255,60").mask(dark_green)[0, 0] == 255


def test_where_the_least_saturation_tells_enough_all_that_is_darker_is_left_out() -> None:
    green = parse_hsv_range("29,86,6:64,255,255")
    assert green.mask(_pixel(10, 25, 14))[0, 0] == 255
    assert green.mask(_pixel(10, 20, 12))[0, 0] == 0


def test_a_range_of_dark_colours_keeps_what_is_saturated() -> None:
    dark_green = parse_hsv_range("29,86,6:64,255,20")
    assert dark_green.mask(_pixel(2, 18, 6))[0, 0] == 255
    assert dark_green.mask(_pixel(8, 14, 10))[0, 0] == 0


@each_case(
    ("text", "said"),
    [
        (29, "is not a range of colours; write it as text"),
        ("", "has 1 limits, not 2"),
        ("29,86,6", "has 1 limits, not 2"),
        ("1,2,3:4,5,6:7,8,9", "has 3 limits, not 2"),
        ("29,86:64,255,255", "'29,86' has 2 numbers, not 3 for hue, saturation and value"),
        ("29,86,6,1:64,255,255", "has 4 numbers, not 3"),
        ("a,86,6:64,255,255", "hue 'a' is not a whole number"),
        ("29,86,6:64,255,1.5", "value '1.5' is not a whole number"),
        ("29,86,6:64,,255", "saturation '' is not a whole number"),
        ("180,86,6:64,255,255", "hue 180 is outside 0 to 179"),
        ("200,86,6:64,255,255", "a hue of 200 degrees is 100, since half the degrees are counted"),
        ("29,40%,6:64,255,255", "40 % of 255 are 102"),
        ("29,-1,6:64,255,255", "saturation -1 is outside 0 to 255"),
        ("29,86,6:64,255,256", "value 256 is outside 0 to 255"),
        ("29,86,6:64,20,255", "the lower saturation 86 is above the upper one 20, so no colour fits"),
        ("29,0,0:64,255,7", "raise the upper saturation 255 or the upper value 7, or let every hue count, 0 to 179"),
        ("29,0,0:64,40,40", "grey, which has no hue, so no colour fits"),
        ("²,86,6:64,255,255", "hue '²' is not a whole number"),
    ],
)
def test_what_is_wrong_is_said(text: object, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        parse_hsv_range(text)


_CHANNELS = st.tuples(st.integers(0, 179), st.integers(0, 255), st.integers(0, 255))


@given(lower=_CHANNELS, upper=_CHANNELS)
def test_what_is_written_is_read_again(lower: tuple[int, int, int], upper: tuple[int, int, int]) -> None:
    one = HsvRange(
        (lower[0], min(lower[1], upper[1]), min(lower[2], upper[2])),
        (upper[0], max(lower[1], upper[1]), max(lower[2], upper[2])),
    )
    assume(one.upper[1] * one.upper[2] >= 8 * 255)
    assert parse_hsv_range(str(one)) == one


@given(
    part=st.tuples(*[st.integers(1, 40)] * 2), corner=st.tuples(*[st.integers(0, 200)] * 2), seed=st.integers(0, 1000)
)
def test_a_part_of_a_picture_has_the_mask_that_it_has_in_the_whole(
    part: tuple[int, int], corner: tuple[int, int], seed: int
) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (300, 240, 3), dtype=np.uint8)
    rows, columns = (slice(first, first + size) for first, size in zip(corner, part, strict=True))
    green = parse_hsv_range("29,86,6:64,255,255")
    assert np.array_equal(green.mask(image[rows, columns]), green.mask(image)[rows, columns])


@given(saturation=st.integers(0, 255), value=st.integers(0, 255))
def test_no_pixel_has_a_hue_in_a_range_that_is_refused(saturation: int, value: int) -> None:
    value_of, grey = np.mgrid[:256, :256].astype(np.uint8)
    greens = np.stack((np.minimum(grey, value_of), value_of, np.minimum(grey, value_of)), axis=-1)
    upper = (160, saturation, value)
    try:
        parse_hsv_range(str(HsvRange((20, 0, 0), upper)))
    except ValueError:
        assert not HsvRange((20, 0, 0), upper).mask(greens).any()
    else:
        assert saturation * value > 1900


# From code values to light.


def test_srgb_is_decoded_as_the_standard_says() -> None:
    table = light_table("srgb")
    assert (table[0], table[255]) == (0.0, 1.0)
    assert table[10] == pytest.approx(10 / 255 / 12.92, rel=1e-6)
    assert table[188] == pytest.approx(0.5029, abs=1e-4)
    assert (np.diff(table) > 0).all()


def test_linear_values_are_in_proportion_to_the_light() -> None:
    assert light_table("linear") == pytest.approx(np.arange(256) / 255)


@pytest.mark.parametrize("shape", [(1,), (3, 4), (5, 4, 7, 3), (2, 3, 4, 5, 3)])
def test_codes_of_any_shape_are_decoded_as_by_the_table(shape) -> None:
    codes = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    for tone_curve in ("srgb", "linear"):
        table = light_table(tone_curve)
        assert np.array_equal(in_light(codes, table), table[codes])
