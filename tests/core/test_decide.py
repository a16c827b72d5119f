"""The decision as a whole: safety, purity, one command for each output."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp, Observation, OutputFault
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from support.observing import Rehearsal, measured

PLAN = Plan(
    targets=("ball",),
    rules=(
        AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=0.5)),
        RampRule(name="far", target="ball", output="motor", start=3.0, full=6.0, level_min=0.2),
        FollowRule(name="follow", target="ball", output="base", distance_m=1.0),
        AlarmRule(name="too-near", target="ball", output="base", priority=200, condition=DistanceCondition(below=0.4)),
    ),
    outputs=(LevelOutput(name="motor", safe_level=0.1), LevelOutput(name="buzzer"), BaseOutput(name="base")),
    tracking=Tracking(confirm_frames=1),
    safety=Safety(max_frame_age_s=0.2, good_frames=3),
)
SAFE = (
    LevelCommand(output="motor", level=0.1),
    LevelCommand(output="buzzer", level=0.0),
    TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0),
)


def run(*distances, frame_s=0.1, **how):
    rehearsal = Rehearsal(PLAN, frame_s)
    if distances:
        rehearsal.see(*distances, **how)
    return rehearsal


def test_nothing_moves_before_enough_fresh_frames():
    rehearsal = run(5, 5)
    assert [decision.commands for _, decision in rehearsal.decisions] == [SAFE, SAFE]
    assert rehearsal.decisions[-1][1].safety_reason == "2 of 3 fresh frames in a row"
    assert rehearsal.see(5).commands != SAFE


def test_commands_name_the_frame_that_justifies_them():
    rehearsal = run(5, 5, 5, 5)
    motor, _, base = rehearsal.decisions[-1][1].commands
    assert motor.captured_at_s == base.captured_at_s == rehearsal.now_s


def test_a_camera_that_stops_stops_everything_within_the_frame_age():
    rehearsal = run(*[5] * 5)
    assert rehearsal.wait(0.2).commands != SAFE
    decision = rehearsal.wait(0.1)
    assert decision.commands == SAFE
    assert decision.safety is SafetyMode.STALE
    assert decision.safety_reason == "the newest frame is 300 ms old, limit 200 ms: no frame in time"
    assert rehearsal.events("camera") == ["fault"]


def test_after_a_standstill_it_takes_fresh_frames_again():
    rehearsal = run(*[5] * 5)
    rehearsal.wait(1.0)
    assert rehearsal.see(5, 5).commands == SAFE
    assert rehearsal.see(5).commands != SAFE
    assert rehearsal.events("camera") == ["fault", "fault_cleared"]


def test_a_driver_that_repeats_an_old_frame_is_a_camera_that_stopped():
    rehearsal = run(*[5] * 5)
    old = FrameStamp(sequence=4, captured_at_s=rehearsal.now_s)
    for late_s in (0.1, 0.2, 0.3):
        now_s = 0.5 + late_s
        decision = rehearsal.cycle(
            Observation(now_s=now_s, frame=old, measurements=(measured("ball", old.captured_at_s, 5.0),))
        )
    assert decision.commands == SAFE
    assert decision.safety is SafetyMode.STALE


@pytest.mark.parametrize("stamp", [math.nan, math.inf, 99.0])
def test_a_frame_from_the_future_or_with_no_time_is_not_believed(stamp):
    rehearsal = run(*[5] * 5)
    bad = FrameStamp(sequence=9, captured_at_s=stamp)
    for late_s in (0.1, 0.2, 0.3):
        decision = rehearsal.cycle(
            Observation(now_s=0.5 + late_s, frame=bad, measurements=(measured("ball", stamp, 5.0),))
        )
    assert decision.commands == SAFE
    rehearsal.now_s = 0.8
    assert rehearsal.see(5, 5, 5).commands != SAFE


def test_a_lost_target_stops_the_base_at_once_and_lets_the_motor_go_to_its_safe_level():
    rehearsal = run(*[5] * 5)
    decision = rehearsal.see(*[None] * 5)
    assert decision.safety is SafetyMode.ACTIVE
    assert decision.commands == SAFE
    assert decision.outputs[2].winner == "safe"


def test_an_output_that_is_out_of_order_is_left_at_its_safe_value_and_the_others_go_on():
    rehearsal = run(*[5] * 5)
    now_s = 0.6
    decision = rehearsal.cycle(
        Observation(
            now_s=now_s,
            frame=FrameStamp(sequence=5, captured_at_s=now_s),
            measurements=(measured("ball", now_s, 5.0),),
            output_faults=(OutputFault(output="base", reason="unplugged"),),
        )
    )
    assert decision.commands[2] == SAFE[2]
    assert decision.outputs[2].winner == "safety"
    assert decision.outputs[2].losers == ("follow",)
    assert decision.commands[0].level > 0.5
    assert rehearsal.events("base") == ["fault"]


def test_a_fault_is_reported_again_when_its_reason_changes_and_its_output_goes_on_from_the_safe_value():
    rehearsal = run(*[5] * 5)

    def cycle(now_s, *reasons):
        return rehearsal.cycle(
            Observation(
                now_s=now_s,
                frame=FrameStamp(sequence=round(now_s * 100), captured_at_s=now_s),
                measurements=(measured("ball", now_s, 5.0),),
                output_faults=tuple(OutputFault(output="base", reason=reason) for reason in reasons),
            )
        )

    driven_mps = rehearsal.decisions[-1][1].commands[2].linear_mps
    for now_s, reason in ((0.6, "unplugged"), (0.7, "unplugged"), (0.8, "it answers again"), (0.9, "it answers again")):
        assert cycle(now_s, reason).commands[2] == SAFE[2]
    assert 0 < cycle(1.0).commands[2].linear_mps < driven_mps
    assert rehearsal.events("base") == ["fault", "fault", "fault_cleared"]


anything = st.one_of(
    st.none(), st.floats(allow_nan=True, allow_infinity=True), st.floats(0.1, 8), st.floats(0.1, 8), st.just("wait")
)


@example([1.0, 6.5e221], 0.0, 1.0)
@example([1.0, 2.0, 3.0], 0.0, 1e200)
@given(
    st.lists(anything, max_size=40), st.floats(-1.5, 1.5) | st.just(math.nan), st.floats(1e-3, 1) | st.just(math.nan)
)
def test_whatever_is_observed_stale_unknown_or_broken_figures_move_nothing(sights, bearing, sigma):
    rehearsal = run()
    for sight in sights:
        waits = sight == "wait"
        decision = rehearsal.wait(0.1) if waits else rehearsal.see(sight, bearing_rad=bearing, sigma_m=sigma)
        state = rehearsal.state
        newest = state.safety.frame
        assert len(decision.commands) == len(PLAN.outputs)
        for command, safe in zip(decision.commands, SAFE, strict=True):
            if command == safe:
                continue
            assert decision.safety is SafetyMode.ACTIVE
            assert newest is not None
            assert command.captured_at_s == newest.captured_at_s
            assert rehearsal.now_s - command.captured_at_s <= PLAN.safety.max_frame_age_s + 1e-9
        base = decision.commands[2]
        if base.linear_mps != 0.0:
            assert decision.tracks[0].is_valid
        elif base.angular_radps != 0.0:
            assert decision.tracks[0].status is not TrackStatus.SEARCHING, "it turns to what it sees, or saw before"


def test_time_that_stands_still_does_no_harm():
    state = initial_state(PLAN)
    seen = Observation(
        now_s=1.0, frame=FrameStamp(sequence=0, captured_at_s=1.0), measurements=(measured("ball", 1.0, 5.0),)
    )
    for _ in range(5):
        state, decision = decide(state, seen)
    assert decision.commands == SAFE


def test_after_a_gap_a_base_starts_from_standing_and_gently():
    rehearsal = run(*[5] * 10)
    assert rehearsal.decisions[-1][1].commands[2].linear_mps > 0.2
    rehearsal.now_s += 5.0
    decision = rehearsal.see(5)
    assert decision.commands[2].linear_mps <= 0.2 * 0.5 + 1e-9, "0.2 s at 0.5 m/s2, from standing"


def test_a_base_does_not_drive_by_a_distance_that_is_hardly_known():
    rehearsal = run(*[5.0] * 6, sigma_m=4.0)
    decision = rehearsal.decisions[-1][1]
    assert decision.tracks[0].is_valid
    assert decision.commands[2] == SAFE[2]
