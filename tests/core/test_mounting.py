"""A camera on its mount: the robot's frame, a base that tilts it, and whether it was moved."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_pose import Mount, Mounting, MountingStatus, step_mounting
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind
from stadimeter.core.liveness import EgoMotion, step_innovation
from stadimeter.core.measurement import Sighting
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import FollowRule, TwistRequest
from stadimeter.core.rules.follow import FloorPose, Law, RelativeTarget, step_target_motion, tilt_rate_radps
from stadimeter.core.rules.scheduler import arbitrate
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.observing import measured

# Whether distances count as unconfirmed: from the finding of a check until a person confirms the mounting.

TURNED = Mounting(status=MountingStatus.UNCONFIRMED, reason="turned by 0.31°")
CONFIRM = OperatorCommand(id="1", action=OperatorAction.CONFIRM_MOUNTING, by="zoe", why="aimed at the gate")


def step(was, mounting, *commands):
    return step_mounting(was_unconfirmed=was, mounting=mounting, commands=commands, now_s=5.0)


def test_a_camera_that_was_moved_is_one_fault_however_long_it_lasts() -> None:
    is_unconfirmed, _, (event,) = step(False, TURNED)
    assert is_unconfirmed
    assert (event.kind, event.source) == (EventKind.FAULT, "mounting")
    assert "turned by 0.31°" in event.reason
    assert step(True, TURNED) == (True, (), ())


def test_confirming_it_ends_the_fault_and_says_who_did() -> None:
    is_unconfirmed, (answer,), (event,) = step(True, TURNED, CONFIRM)
    assert not is_unconfirmed
    assert answer.accepted
    assert (event.kind, event.by) == (EventKind.FAULT_CLEARED, "zoe")
    assert "aimed at the gate" in event.reason


def test_there_is_nothing_to_confirm_where_nothing_was_found() -> None:
    for mounting in (None, Mounting(), Mounting(status=MountingStatus.NOT_JUDGED, reason="dark")):
        is_unconfirmed, (answer,), events = step(False, mounting, CONFIRM)
        assert not is_unconfirmed
        assert not answer.accepted
        assert events == ()


@given(st.lists(st.tuples(st.sampled_from([None, Mounting(), TURNED]), st.booleans()), max_size=30))
def test_faults_and_their_ends_alternate(cycles) -> None:
    was, kinds = False, []
    for mounting, confirms in cycles:
        was, answers, events = step(was, mounting, *([CONFIRM] if confirms else []))
        kinds += [event.kind for event in events]
        assert len(answers) == confirms
    assert kinds == [EventKind.FAULT, EventKind.FAULT_CLEARED] * (len(kinds) // 2) + [EventKind.FAULT] * (
        len(kinds) % 2
    )
    assert was == (len(kinds) % 2 == 1)


# Places in the robot's frame.


def test_a_camera_in_the_middle_that_looks_ahead_has_its_axes_exchanged() -> None:
    assert Mount().in_robot((0.1, 0.2, 3.0)) == pytest.approx((3.0, -0.1, -0.2))


def test_a_camera_that_looks_down_sees_the_floor_at_height_zero() -> None:
    tilt = math.radians(-30)
    mount = Mount(x_m=0.12, y_m=-0.05, z_m=0.5, tilt_rad=tilt)
    on_axis_m = 0.5 / math.sin(-tilt)
    assert mount.in_robot((0.0, 0.0, on_axis_m)) == pytest.approx((0.12 + 0.5 / math.tan(-tilt), -0.05, 0.0))


def test_a_camera_that_is_turned_to_the_left_looks_along_y() -> None:
    mount = Mount(x_m=0.1, yaw_rad=math.pi / 2, z_m=0.3)
    assert mount.in_robot((0.5, 0.0, 2.0)) == pytest.approx((0.1 + 0.5, 2.0, 0.3))


def test_the_robot_s_axes_are_at_right_angles_at_any_tilt() -> None:
    x, y, z = Mount(yaw_rad=0.7).axes(-0.4)
    for one, other, product in ((x, y, 0), (y, z, 0), (x, z, 0), (x, x, 1), (y, y, 1), (z, z, 1)):
        assert sum(a * b for a, b in zip(one, other, strict=True)) == pytest.approx(product)


# What a camera that tilts adds: a rate by the law of turning, and what it changes of what a picture must show.

RULE = FollowRule(name="look", target="ball", output="base", distance_m=1.0, linear_max_mps=0.0)
LAW = Law(turn_gain_per_s=1.5)
FRAME_S = 1 / 30


def rate_radps(elevation_rad: float, rising_mps: float = 0.0, before_radps: float = 0.0) -> float:
    seen = RelativeTarget(distance_m=2.0, bearing_rad=0.0, elevation_rad=elevation_rad, rising_mps=rising_mps)
    return tilt_rate_radps(RULE, seen, LAW, before_radps)


def test_it_tilts_up_to_a_target_above_and_with_one_that_rises() -> None:
    assert rate_radps(0.2) == pytest.approx(0.3)
    assert rate_radps(-0.2) == pytest.approx(-0.3)
    assert rate_radps(0.2, rising_mps=0.4) == pytest.approx(0.5)


def test_within_the_deadband_it_stands_and_goes_on_to_the_middle_once_it_moves() -> None:
    assert rate_radps(0.025) == 0.0
    assert rate_radps(0.025, before_radps=0.1) == pytest.approx(0.0375)


@given(st.floats(-3, 3), st.floats(-40, 40), st.floats(-2, 2))
def test_it_is_never_faster_than_its_rule_allows(elevation_rad: float, rising_mps: float, before_radps: float) -> None:
    assert abs(rate_radps(elevation_rad, rising_mps, before_radps)) <= RULE.angular_max_radps


@given(st.floats(-1.0, 1.0), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_where_a_tilted_camera_sees_a_target_is_where_it_is(tilt_rad: float, right: float, up: float) -> None:
    """A place in the frame of the camera, turned by the tilt, is the place in the frame of the floor."""
    distance_m = math.sqrt(1 + right**2 + up**2)
    sighting = Sighting(
        at_s=1.0,
        distance_m=distance_m,
        noise_m=0.01,
        scale_sigma=0.01,
        depth_share=1 / distance_m,
        bearing_rad=math.atan2(right, 1.0),
        elevation_rad=math.atan2(up, math.hypot(1.0, right)),
    )
    pose = FloorPose(at_s=1.0, tilt_rad=tilt_rad)
    target = step_target_motion(None, sighting, pose, 0.0, 1.0)
    forward_m = math.cos(tilt_rad) - up * math.sin(tilt_rad)
    assert (target.x_m, target.y_m) == pytest.approx((forward_m, -right), abs=1e-9)
    assert target.height_m == pytest.approx(up * math.cos(tilt_rad) + math.sin(tilt_rad), abs=1e-9)
    if not right:
        assert target.seen_from(pose).elevation_rad == pytest.approx(sighting.elevation_rad, abs=1e-9)


def commands_of(base: BaseOutput, seconds: float = 2.0, elevation_rad: float = 0.3) -> list[TwistCommand]:
    """Return what a base is commanded that sees a target ahead and above, which stays there in the view."""
    state, told = initial_state(Plan(targets=("ball",), rules=(RULE,), outputs=(base,))), []
    for number in range(round(seconds / FRAME_S)):
        at_s = 10.0 + number * FRAME_S
        seen = replace(measured("ball", at_s, 2.0), elevation_rad=elevation_rad)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        observation = Observation(now_s=at_s + 0.03, frame=frame, measurements=(seen,))
        state, decision = decide(state, observation)
        (command,) = decision.commands
        assert isinstance(command, TwistCommand)
        told.append(command)
    return told


def test_a_base_is_asked_to_tilt_if_it_can_and_speeds_up_as_its_limits_say() -> None:
    base = BaseOutput(name="base", angular_max_radps=0.4, angular_accel_radps2=2.0)
    assert {each.tilt_radps for each in commands_of(base)} == {0.0}
    rates_radps = [each.tilt_radps for each in commands_of(replace(base, tilts=True))]
    assert max(rates_radps) == pytest.approx(0.4)
    assert max(after - before for before, after in pairwise(rates_radps[1:])) <= 0.0668
    assert min(each.tilt_radps for each in commands_of(replace(base, tilts=True), elevation_rad=-0.3)) < -0.39


@pytest.mark.parametrize("elevation_rad", [math.nan, math.inf])
def test_an_elevation_that_is_no_number_tilts_nothing(elevation_rad: float) -> None:
    told = commands_of(BaseOutput(name="base", tilts=True), elevation_rad=elevation_rad)
    assert {each.tilt_radps for each in told} == {0.0}


@pytest.mark.parametrize(("first", "second", "counts"), [(0.4, 0.2, 0.2), (0.4, -0.2, 0.0), (-0.3, 0.0, 0.0)])
def test_of_two_equals_the_slower_tilt_counts(first: float, second: float, counts: float) -> None:
    def wants(rule: str, tilt_radps: float) -> TwistRequest:
        return TwistRequest(
            rule=rule, output="base", priority=5, linear_mps=0.0, angular_radps=0.0, tilt_radps=tilt_radps
        )

    (winner,) = arbitrate((wants("a", first), wants("b", second)), {"base": BaseOutput(name="base")})["base"]
    assert isinstance(winner, TwistRequest)
    assert winner.tilt_radps == counts


def turned(tilt_rad: float | None, seconds: float = 1.5) -> EgoMotion:
    """Return the motion of a camera that was turned to the left at 0.5 rad/s."""
    ego = EgoMotion()
    for number in range(round(seconds / FRAME_S)):
        at_s = number * FRAME_S
        side_m = 0.3 * 0.5 * at_s
        command = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.5, captured_at_s=at_s)
        report = BaseReport(at_s=at_s, left_m=-side_m, right_m=side_m, camera_tilt_rad=tilt_rad)
        ego = ego.step(at_s, command, report)
    return ego


@pytest.mark.parametrize("tilt_rad", [0.0, 0.5, -1.0])
def test_a_tilted_camera_is_expected_to_see_less_of_a_turn(tilt_rad: float) -> None:
    _, level_rad = turned(None).least_since(0.5, 1.3)
    _, tilted_rad = turned(tilt_rad).least_since(0.5, 1.3)
    assert tilted_rad == pytest.approx(level_rad * math.cos(tilt_rad), rel=1e-6)


def test_a_tilt_that_is_no_number_counts_as_it_was() -> None:
    assert turned(math.nan).at(1.0).tilt_rad == 0.0


def test_a_target_that_a_tilted_camera_keeps_in_the_middle_stays_where_it_is_on_the_map() -> None:
    seen = measured("ball", 1.0, 2.0)
    level, tilted = step_innovation(None, seen, turned(0.0)), step_innovation(None, seen, turned(0.6))
    assert level is not None
    assert tilted is not None
    assert math.hypot(*tilted.place_m) == pytest.approx(math.hypot(*level.place_m) * math.cos(0.6))
