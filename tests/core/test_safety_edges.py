"""Edges of the safety machine: exact limits, and what it says."""

import pytest

from stadimeter.core.decision import SafetyMode
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Safety
from stadimeter.core.safety import FROM_THE_FUTURE_S, SafetyState, is_gap, step_safety, usual_step_s

SETTINGS = Safety(max_frame_age_s=0.25, good_frames=2)


def run(*cycles, state=None):
    """Step through cycles of (now, capture time of a new frame or None, fault of the camera)."""
    state = state or SafetyState()
    for sequence, (now_s, captured_at_s, fault) in enumerate(cycles):
        frame = None if captured_at_s is None else FrameStamp(sequence=sequence, captured_at_s=captured_at_s)
        state = step_safety(state, Observation(now_s=now_s, frame=frame, camera_fault=fault), SETTINGS)
    return state


ACTIVE = [(1.0, 1.0, ""), (1.125, 1.125, "")]


def test_it_is_active_after_enough_frames_and_gives_no_reason():
    assert run(ACTIVE[0]).mode is SafetyMode.STARTING
    assert run(ACTIVE[0]).reason == "1 of 2 fresh frames in a row"
    assert (run(*ACTIVE).mode, run(*ACTIVE).reason) == (SafetyMode.ACTIVE, "")


@pytest.mark.parametrize(("now_s", "mode"), [(1.375, SafetyMode.ACTIVE), (1.3751, SafetyMode.STALE)])
def test_a_frame_of_exactly_the_limit_is_fresh(now_s, mode):
    assert run(*ACTIVE, (now_s, None, "")).mode is mode


def test_an_old_frame_is_reported_with_its_age_the_limit_and_the_cameras_words():
    assert run(*ACTIVE, (2.125, None, "")).reason == "the newest frame is 1000 ms old, limit 250 ms"
    assert run(*ACTIVE, (2.125, None, "unplugged")).reason.endswith("limit 250 ms: unplugged")


def test_without_any_frame_the_cameras_words_are_the_reason():
    assert run((1.0, None, "")).reason == "no frame yet"
    assert run((1.0, None, "unplugged")).reason == "unplugged"


def test_a_frame_that_comes_again_is_not_counted():
    assert run(ACTIVE[0], (1.1, 1.0, "")).mode is SafetyMode.STARTING


def test_after_stale_frames_the_row_begins_anew():
    stale = run(*ACTIVE, (2.125, None, ""))
    assert run((2.2, 2.2, ""), state=stale).mode is SafetyMode.STALE
    assert run((2.2, 2.2, ""), (2.3, 2.3, ""), state=stale).mode is SafetyMode.ACTIVE


@pytest.mark.parametrize(("ahead_s", "mode"), [(FROM_THE_FUTURE_S, SafetyMode.ACTIVE), (0.0626, SafetyMode.STARTING)])
def test_a_stamp_from_the_future_is_not_believed(ahead_s, mode):
    assert run(ACTIVE[0], (1.125, 1.125 + ahead_s, "")).mode is mode


def test_a_gap_is_named_with_its_length_and_the_limit():
    seen = Observation(now_s=5.0, frame=FrameStamp(sequence=9, captured_at_s=5.0))
    after = step_safety(run(*ACTIVE), seen, SETTINGS, gap_s=3.875)
    assert after.mode is SafetyMode.STALE
    assert after.reason == (
        "the program stood still for 3.88 s, limit 250 ms (safety.max_frame_age); 1 of 2 fresh frames in a row"
    )


@pytest.mark.parametrize(
    ("step_s", "usual_s", "gap"),
    [(0.25, 0.1, False), (0.2500005, 0.1, False), (0.26, 0.1, True), (0.26, 0.13, False), (9.0, 0.0, False)],
)
def test_a_gap_is_longer_than_the_limit_and_twice_as_long_as_usual(step_s, usual_s, gap):
    assert is_gap(step_s, usual_s, SETTINGS) is gap


@pytest.mark.parametrize(
    ("step_s", "usual_s", "usual"), [(0.3, 0.0, 0.3), (0.3, 0.2, 0.3), (0.9, 0.2, 0.4), (0.1, 0.2, 0.1)]
)
def test_the_usual_step_at_most_doubles(step_s, usual_s, usual):
    assert usual_step_s(step_s, usual_s) == pytest.approx(usual)
