"""The table of things of unknown size counts right, so that it can be believed."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.mark.parametrize("kind", ["ball", "disc", "sheet", "tag"])
def test_a_size_that_the_detector_is_not_told_is_learnt_in_a_sequence(kind) -> None:
    from size_from_motion import ASSUMED_M, _Sequence

    (sample,) = _Sequence(kind, 2.0, 3, np.random.default_rng(3)).samples((0.5,))
    assert sample.row == f"{kind}, 2 m, 0.5 m"
    assert sample.true_m > 1.2 * ASSUMED_M
    assert 0 < abs(sample.error) < 0.08
    assert 0.02 < sample.sigma_m / sample.measured_m < 0.03


def test_a_sequence_whose_end_is_not_seen_counts_as_one_without_an_answer(monkeypatch) -> None:
    import size_from_motion

    sequence = size_from_motion._Sequence("tag", 2.0, 3, np.random.default_rng(3))
    look = sequence._look
    monkeypatch.setattr(sequence, "_look", lambda ahead_m: look(ahead_m) if ahead_m < 0.5 else None)
    (sample,) = sequence.samples((0.5,))
    assert sample.measured_m is None
