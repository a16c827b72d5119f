"""How growth of memory is judged."""

import numpy as np
import pytest

TIMES_S = np.arange(0.0, 3900.0, 10.0)


@pytest.mark.parametrize("kb_per_hour", [0.0, 800.0])
def test_a_slope_lies_within_its_interval(kb_per_hour):
    import footprint

    noise = np.random.default_rng(3).normal(0, 40, TIMES_S.size)
    found = footprint.growth(TIMES_S, 90_000 + kb_per_hour * TIMES_S / 3600 + noise)
    assert abs(found.kb_per_hour - kb_per_hour) < found.interval_kb_per_hour < 100


def test_what_is_loaded_in_the_first_minute_is_no_growth():
    import footprint

    loading = np.where(TIMES_S <= footprint.SETTLED_S, 50_000.0, 90_000.0)
    assert footprint.growth(TIMES_S, loading).kb_per_hour == pytest.approx(0, abs=1e-6)
