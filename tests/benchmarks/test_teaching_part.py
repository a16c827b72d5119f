"""The benchmarks of teaching run, and measure what they say."""

import pytest


@pytest.mark.long
def test_a_scene_is_taught_and_held_against_what_was_held_out(monkeypatch):
    import teaching

    monkeypatch.setattr(teaching, "VISITS", 6)
    results = teaching.measure_all([9101])
    assert results[0].outcome in {"equal", "other alarms"}
    assert "| scenes | |" in teaching.markdown(results)


@pytest.mark.long
def test_a_dragged_threshold_says_what_a_replay_says():
    import what_if

    rows, is_same = what_if.measure_all(900)
    assert is_same
    assert rows[1].processor_s < rows[-1].processor_s
    assert "those of `replay --diff`" in what_if.markdown(rows, is_same)
