from __future__ import annotations

import pytest
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.liveness import LivenessState, step_liveness
from stadimeter.core.observation import FlowSince, FrameStamp, Observation, PictureFlow

CYCLE_S = 1 / 30


def flow_since(at_s: float, age_s: float, shift_px: float, sigma_px2: float = 0.001) -> FlowSince:
    return FlowSince(
        since_s=at_s - age_s,
        step_s=CYCLE_S,
        focal_px=150.0,
        aside_px=40.0,
        blocks=40,
        shift2_px2=shift_px**2,
        sigma_px2=sigma_px2,
    )


def found_at_s(
    linear_mps: float, angular_radps: float, shift_px: float, *, sigma_px2: float = 0.001, seconds: float = 3.0
) -> float | None:
    """Return how long after the wheels began to turn a picture is found to stand still; None for never.

    Args:
        shift_px: What the picture shows of the motion, since each of the earlier ones.
    """
    state = LivenessState()
    for number in range(round(seconds / CYCLE_S)):
        at_s = number * CYCLE_S
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=at_s)
        looks = tuple(flow_since(at_s, age_s, shift_px, sigma_px2) for age_s in (0.13, 0.3, 1.0) if at_s >= age_s)
        observation = Observation(
            now_s=at_s,
            frame=FrameStamp(sequence=number, captured_at_s=at_s),
            flow=PictureFlow(textured=0.6, since=looks),
        )
        state, cause = step_liveness(state, observation, command, is_new=True)
        if cause:
            assert cause.startswith("the picture stands still while the wheels turn (")
            return at_s
    return None


@pytest.mark.parametrize(
    ("linear_mps", "angular_radps", "within_s"),
    [(0.3, 0.0, 0.45), (0.2, 0.0, 0.55), (0.0, 1.0, 0.45), (0.05, 0.0, 1.3)],
)
def test_a_picture_that_stands_still_while_the_wheels_turn_is_found(
    linear_mps: float, angular_radps: float, within_s: float
) -> None:
    assert (found_at_s(linear_mps, angular_radps, shift_px=0.0) or 9.9) <= within_s


@pytest.mark.parametrize(("linear_mps", "angular_radps"), [(0.3, 0.0), (0.1, 0.0), (0.0, 1.0), (0.3, 0.5)])
def test_a_picture_that_flows_is_believed(linear_mps: float, angular_radps: float) -> None:
    assert found_at_s(linear_mps, angular_radps, shift_px=0.5) is None


def test_below_the_least_motion_nothing_is_claimed() -> None:
    assert found_at_s(0.02, 0.0, shift_px=0.0, seconds=10.0) is None
    assert found_at_s(0.0, 0.1, shift_px=0.0, seconds=10.0) is None, "a motor may not turn at so little"
    assert found_at_s(0.0, 0.0, shift_px=0.0, seconds=10.0) is None


def test_a_look_with_so_much_noise_that_it_cannot_tell_says_nothing() -> None:
    assert found_at_s(0.3, 0.0, shift_px=0.0, sigma_px2=1.0) is None


def came_again_at_s(linear_mps: float, angular_radps: float, **look: float | bool) -> float | None:
    """Return when pictures that flow as they must are found to be those of a while ago; None for never."""
    state = LivenessState()
    for number in range(120):
        at_s = number * CYCLE_S
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=at_s)
        of_now = flow_since(at_s, 0.13, 0.5)
        again = replace(flow_since(at_s, 1.5, float(look.get("shift_px", 0.0))), is_slid=bool(look.get("is_slid")))
        flow = PictureFlow(textured=0.6, since=(of_now,), again=(again,) if at_s >= 1.5 else ())
        observation = Observation(now_s=at_s, frame=FrameStamp(sequence=number, captured_at_s=at_s), flow=flow)
        state, cause = step_liveness(state, observation, command, is_new=True)
        if cause:
            assert cause.startswith("old pictures have come again: this one is of 1.5 s ago")
            return at_s
    return None


@pytest.mark.parametrize(("linear_mps", "angular_radps"), [(0.1, 0.0), (0.3, 0.0), (0.0, 0.5), (0.2, -0.5)])
def test_a_picture_that_comes_again_elsewhere_is_old_however_well_it_flows(
    linear_mps: float, angular_radps: float
) -> None:
    assert (came_again_at_s(linear_mps, angular_radps) or 9.9) <= 1.7


def test_a_view_that_comes_again_where_the_robot_has_not_moved_on_is_believed() -> None:
    assert came_again_at_s(0.0, 0.0) is None
    assert came_again_at_s(0.0, 0.1) is None, "a motor may not turn at so little"
    assert came_again_at_s(0.3, 0.0, shift_px=1.5) is None, "it is another view"


def test_a_picture_that_is_slid_over_another_shows_a_drive_and_no_turn() -> None:
    assert (came_again_at_s(0.3, 0.0, is_slid=True) or 9.9) <= 1.7
    assert came_again_at_s(0.0, 0.8, is_slid=True) is None


def test_without_a_camera_that_shows_motion_nothing_is_judged() -> None:
    state, cause = LivenessState(), ""
    command = TwistCommand(output="base", linear_mps=0.3, angular_radps=0.0, captured_at_s=0.0)
    for number in range(90):
        stamp = FrameStamp(sequence=number, captured_at_s=number * CYCLE_S)
        state, cause = step_liveness(state, Observation(now_s=number * CYCLE_S, frame=stamp), command, is_new=True)
        assert cause == ""
