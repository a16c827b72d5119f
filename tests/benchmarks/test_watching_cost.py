"""What it costs to be watched is really measured: under each condition there are cycles, and pictures are read."""

import pytest


@pytest.mark.long
def test_every_condition_is_measured():
    import watching_cost

    found = watching_cost.measure(minutes=0.1, block_s=1.5)
    assert list(found) == list(watching_cost.CONDITIONS)
    # On a busy machine few of the 45 cycles of each block come, and fewer pictures.
    assert all(figures["cycles"] > 2 for figures in found.values())
    assert all(figures["pictures read"] > 0 for name, figures in found.items() if name != "nobody")


def test_the_percentiles_are_those_of_the_cycles_within_the_spans():
    import numpy as np
    import watching_cost

    rows = np.array([[at_s, at_s / 1000, 0.0, 0.0] for at_s in range(100)], float)
    found = watching_cost.figures(rows, [("three", 9.5, 20.5), ("three", 49.5, 60.5)])
    assert found["cycles"] == 22
    assert found["cycle p50 ms"] == pytest.approx(35.0)
    assert found["cycle p99 ms"] == pytest.approx(60.0, abs=0.3)
