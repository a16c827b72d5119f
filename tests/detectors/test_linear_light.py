"""From code values to light."""

from __future__ import annotations

import numpy as np
import pytest

from stadimeter.detectors.sampling import in_light, light_table

pytestmark = pytest.mark.vision


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
