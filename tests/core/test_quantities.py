"""Conditions and ramps on any quantity of a target, on two targets compared, and on standing still."""

import math

import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Mount
from stadimeter.core.command import BaseReport
from stadimeter.core.conditions.evidence import describe_begin, describe_end, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import uncertain_of
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.measurement import Sighting, Track, TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.persistence import reload
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule, RampRule
from stadimeter.core.tracking.transverse import Viewpoint
from support.conditions import compared, still
from support.observing import measured

LENS = replace(CameraModel.with_focal_length(600.0, 640, 480), focal_relative_sigma=0.02)
VIEW = Viewpoint(height_m=1.0, lens=LENS)


def track(distance_m=2.0, bearing_deg=0.0, elevation_deg=0.0, *, target="ball", sigma_m=0.05, noise_m=0.01):
    return Track(
        target=target,
        status=TrackStatus.TRACKING,
        distance_m=distance_m,
        depth_m=distance_m * math.cos(math.radians(bearing_deg)) * math.cos(math.radians(elevation_deg)),
        sigma_m=sigma_m,
        noise_m=noise_m,
        closing_mps=0.0,
        closing_sigma_mps=0.1,
        bearing_rad=math.radians(bearing_deg),
        elevation_rad=math.radians(elevation_deg),
    )


def sighting(seen, size_share=0.1):
    return Sighting(
        at_s=1.0,
        distance_m=seen.distance_m,
        noise_m=0.01,
        scale_sigma=0.0,
        depth_share=1.0,
        bearing_rad=seen.bearing_rad,
        elevation_rad=seen.elevation_rad,
        size_share=size_share,
    )


def inputs(*tracks, **more):
    known = {
        "tracks": {each.target: each for each in tracks},
        "now_s": 1.0,
        "sightings": {each.target: sighting(each) for each in tracks},
        "viewpoint": VIEW,
    }
    return RuleInputs(**known | more)


@pytest.mark.parametrize(
    ("quantity", "expected"), [("x", 2 * math.sin(math.radians(30))), ("y", 0.0), ("z", 2 * math.cos(math.radians(30)))]
)
def test_a_place_is_in_the_camera_frame(quantity, expected):
    assert uncertain_of(inputs(track(2.0, 30.0)), "ball", quantity)[0] == pytest.approx(expected)


def test_a_height_counts_from_the_floor_and_grows_with_the_elevation():
    value, *_ = uncertain_of(inputs(track(2.0, 0.0, 30.0)), "ball", "height")
    assert value == pytest.approx(1.0 + 1.0)
    assert uncertain_of(inputs(track(2.0, 0.0, 30.0)), "ball", "height_above_camera")[0] == pytest.approx(1.0)


def test_a_height_counts_how_the_camera_is_mounted_and_how_its_base_tilts_it():
    seen = track(2.0, 40.0, 10.0)
    mounted = replace(VIEW, tilt_rad=math.radians(20))
    base = BaseReport(at_s=1.0, camera_tilt_rad=math.radians(20))
    fixed, _, _ = uncertain_of(inputs(seen, viewpoint=mounted), "ball", "height")
    on_servos, _, _ = uncertain_of(inputs(seen, base=base), "ball", "height")
    x, y, z = (uncertain_of(inputs(seen), "ball", axis)[0] for axis in "xyz")
    up = -y * math.cos(math.radians(20)) + z * math.sin(math.radians(20))
    assert fixed == pytest.approx(1.0 + up)
    assert on_servos == pytest.approx(fixed)
    assert math.hypot(x, y, z) == pytest.approx(2.0)


def test_a_height_above_a_floor_that_is_unknown_is_unknown():
    high = FigureCondition(quantity="height", above=1.0, target="ball")
    assert high.holds(inputs(track(), viewpoint=Viewpoint()), is_on=False) is None
    assert "the height is not known" in describe_verdict(
        high, inputs(track(), viewpoint=Viewpoint()), (), is_active=False
    )


def test_across_the_line_of_sight_the_noise_of_the_angle_counts_and_along_it_that_of_the_distance():
    _, across, _ = uncertain_of(inputs(track()), "ball", "x")
    _, along, _ = uncertain_of(inputs(track()), "ball", "z")
    half_extent_m = 0.1 * 640 / 600 / 2 * 2.0
    assert across == pytest.approx(0.01 / 2.0 * half_extent_m)  # half the extent has the noise share of the distance
    assert along == pytest.approx(0.05)


def test_a_size_in_the_picture_does_not_care_for_errors_that_stay():
    value, sigma, noise = uncertain_of(inputs(track()), "ball", "size")
    assert (value, sigma, noise) == (pytest.approx(0.1), pytest.approx(0.0005), pytest.approx(0.0005))


def test_without_a_picture_a_size_is_unknown():
    seen = track()
    assert uncertain_of(inputs(seen, sightings={"ball": sighting(seen, None)}), "ball", "size") is None


# Comparisons


def test_an_error_of_the_focal_length_cancels_where_two_targets_are_compared():
    lasting = 0.02 * 2.0  # all of it is of the focal length
    near = track(2.0, sigma_m=math.hypot(lasting, 0.01))
    other = track(2.0, target="tag", sigma_m=math.hypot(lasting, 0.01))
    value, sigma, noise = uncertain_of(inputs(near, other), "ball", "distance", "tag")
    assert value == 0.0
    assert sigma == pytest.approx(math.hypot(0.01, 0.01))
    assert noise == pytest.approx(math.hypot(0.01, 0.01))


def test_an_error_of_a_size_does_not_cancel():
    near = track(2.0, sigma_m=0.1)
    other = track(2.0, target="tag", sigma_m=0.1)
    _, sigma, _ = uncertain_of(inputs(near, other), "ball", "distance", "tag")
    own = math.sqrt(0.1**2 - (0.02 * 2.0) ** 2)
    assert sigma == pytest.approx(math.hypot(own, own))


def test_two_targets_are_compared_with_an_offset():
    nearer = compared("distance", "ball", "tag", below=-0.2)
    assert [nearer.holds(inputs(track(d), track(2.0, target="tag")), is_on=False) for d in (1.5, 1.75, 1.9, 2.5)] == [
        True,
        True,
        False,
        False,
    ]
    assert describe_begin(nearer) == "70% sure that `ball` is nearer than `tag` by 0.20 m (0.7 ft)"


def test_what_is_left_in_the_picture_is_left():
    left = compared("bearing", "ball", "tag", below=0.0)
    assert left.holds(inputs(track(2.0, -5.0), track(9.0, 3.0, target="tag")), is_on=False) is True
    assert describe_begin(left) == "70% sure that `ball` is left of `tag`"
    assert describe_end(left) == "its difference in bearing is above 0.0° by 3 standard deviations of the noise"


def test_a_comparison_is_unknown_while_one_of_the_two_is_out_of_sight():
    nearer = compared("distance", "ball", "tag", below=0.0)
    lost = replace(track(target="tag"), status=TrackStatus.LOST, reason="hidden")
    assert nearer.holds(inputs(track(1.0), lost), is_on=False) is None
    assert describe_verdict(nearer, inputs(track(1.0), lost), (), is_active=False) == "tag is lost: hidden"


def test_a_comparison_ends_over_a_deadband_of_the_noise_of_both():
    nearer = compared("distance", "ball", "tag", below=0.0)
    found = [nearer.holds(inputs(track(d), track(2.0, target="tag")), is_on=True) for d in (2.02, 2.06, 2.2)]
    assert found == [True, False, False]  # 3 · √2 · 1 cm beyond
    assert nearer.holds(inputs(track(2.02), track(2.0, target="tag")), is_on=False) is False


# Motion


def run(path, *rules, seconds=6.0, rate_hz=30.0, output="motor", tilt=0.0):
    """Decide a run in which the ball is where `path` says: distance, bearing and elevation at a time; None for gone."""
    plan = Plan(
        targets=("ball",), rules=rules, outputs=(LevelOutput(name=output),), viewpoint=replace(VIEW, tilt_rad=tilt)
    )
    state, decisions = initial_state(plan), []
    for frame in range(int(seconds * rate_hz)):
        at_s = frame / rate_hz
        place = path(at_s)
        found = ()
        if place is not None:
            distance_m, bearing_rad, elevation_rad = place
            seen = measured("ball", at_s, distance_m, 0.005 * distance_m, bearing_rad)
            found = (replace(seen, elevation_rad=elevation_rad, size_share=0.2 / distance_m),)
        stamp = FrameStamp(sequence=frame, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=stamp, measurements=found))
        decisions.append((at_s, decision))
    return state, decisions


def raised_at(decisions):
    return [event.at_s for _, decision in decisions for event in decision.events if event.kind == "raised"]


FAST = AlarmRule(
    name="fast",
    target="ball",
    condition=FigureCondition(quantity="speed", above=2.0, probability_on=0.95, deadband_sigmas=2.0),
)


@pytest.mark.parametrize(
    "path",
    [
        lambda t: (3.0, max(0.0, t - 3.0), 0.0),
        lambda t: (3.0, -max(0.0, t - 3.0), 0.0),
        lambda t: (3.0, 0.0, max(0.0, t - 3.0)),
        lambda t: (6.0 - 3.0 * max(0.0, t - 3.0), 0.0, 0.0),
        lambda t: (3.0 + 3.0 * max(0.0, t - 3.0), 0.0, 0.0),
    ],
)
def test_a_ball_that_is_thrown_moves_fast_in_whatever_direction(path):
    _, decisions = run(path, FAST, seconds=4.2)
    (at_s,) = raised_at(decisions)
    assert 3.0 < at_s < 3.4


def test_one_wrong_direction_is_no_speed():
    _, decisions = run(lambda t: (3.0, 0.3 if abs(t - 3.0) < 0.01 else 0.0, 0.0), FAST, seconds=5.0)
    assert raised_at(decisions) == []


@pytest.mark.parametrize(("rate_radps", "expected"), [(0.2, 0.6), (-0.2, -0.6)])
def test_a_speed_sideways_is_positive_to_the_right(rate_radps, expected):
    ask = AlarmRule(name="a", target="ball", condition=FigureCondition(quantity="sideways_speed", above=9.0))
    _, decisions = run(lambda t: (3.0, rate_radps * (t - 3.0), 0.0), ask)
    value, sigma, _ = uncertain_of(decisions[-1][1].reasons.inputs, "ball", "sideways_speed")
    assert value == pytest.approx(expected, abs=3 * sigma)
    assert sigma < 0.1


def test_motion_across_the_line_of_sight_is_worked_out_only_for_those_who_ask():
    by_distance = RampRule(name="r", target="ball", output="motor", start=1.0, full=2.0)
    by_bearing = replace(by_distance, quantity="bearing")
    state, _ = run(lambda _: (3.0, 0.0, 0.0), by_distance, by_bearing, seconds=0.5)
    assert state.motions == ()
    state, _ = run(lambda _: (3.0, 0.0, 0.0), FAST, seconds=0.5)
    assert [each.target for each in state.motions] == ["ball"]


STILL = AlarmRule(name="still", target="ball", condition=still(3.0))


def test_what_has_not_moved_for_a_time_is_still():
    _, decisions = run(lambda _: (3.0, 0.1, 0.0), STILL)
    (at_s,) = raised_at(decisions)
    assert 3.0 <= at_s <= 3.3


@pytest.mark.parametrize("moved", [(3.0, 0.2, 0.0), (3.0, 0.1, 0.1), (3.3, 0.1, 0.0)], ids=["sideways", "up", "away"])
def test_a_move_in_any_direction_starts_the_time_over(moved):
    _, decisions = run(lambda t: (3.0, 0.1, 0.0) if t < 2.0 else moved, STILL)
    (at_s,) = raised_at(decisions)
    assert 5.0 <= at_s <= 5.4


def test_what_creeps_has_moved_once_it_is_far_from_where_it_began():
    _, decisions = run(lambda t: (3.0, 0.1 + 0.05 * t, 0.0), STILL, seconds=10.0)
    assert raised_at(decisions) == []


def test_a_moment_out_of_sight_is_no_move_and_many_seconds_may_be():
    _, decisions = run(lambda t: None if 1.0 < t < 2.5 else (3.0, 0.1, 0.0), STILL)
    assert [round(at_s) for at_s in raised_at(decisions)] == [3]
    _, decisions = run(lambda t: None if 1.0 < t < 7.0 else (3.0, 0.1, 0.0), STILL, seconds=12.0)
    assert [round(at_s) for at_s in raised_at(decisions)] == [10]


def test_a_reload_lets_the_time_go_on_for_rules_that_ask_for_it_still():
    state, _ = run(lambda _: (3.0, 0.1, 0.0), STILL, seconds=2.0)
    sooner = replace(STILL, condition=still(1.0))
    again = reload(state, replace(state.plan, rules=(sooner, FAST))).state
    assert again.motions == state.motions
    assert reload(state, replace(state.plan, rules=())).state.motions == ()


def test_a_program_that_stood_still_saw_no_one_stand_still():
    def seen(at_s, sequence):
        stamp = FrameStamp(sequence=sequence, captured_at_s=at_s)
        return Observation(now_s=at_s, frame=stamp, measurements=(measured("ball", at_s, 3.0),))

    state, _ = run(lambda _: (3.0, 0.0, 0.0), STILL, seconds=2.0)
    decisions = []
    for number in range(60):
        at_s = 12.0 + number / 30
        state, decision = decide(state, seen(at_s, 100 + number))
        decisions.append((at_s, decision))
    assert raised_at(decisions) == []


# Ramps


def test_ahead_and_left_are_from_the_middle_of_the_robot_along_the_floor():
    mounted = replace(VIEW, tilt_rad=0.0, mount=Mount(x_m=0.1, y_m=0.02))
    seen = inputs(track(2.0, 30.0), viewpoint=mounted)
    assert uncertain_of(seen, "ball", "ahead")[0] == pytest.approx(0.1 + 2 * math.cos(math.radians(30)))
    assert uncertain_of(seen, "ball", "left")[0] == pytest.approx(0.02 - 2 * math.sin(math.radians(30)))
    # A camera that looks down by 30° has what is on its axis nearer along the floor.
    down = inputs(track(2.0), viewpoint=replace(mounted, tilt_rad=math.radians(-30)))
    assert uncertain_of(down, "ball", "ahead")[0] == pytest.approx(0.1 + 2 * math.cos(math.radians(30)))
