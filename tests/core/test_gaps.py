"""Time in which the program stood still: nothing that was known before it goes on by itself."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import RuleStatus, SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, FollowRule, OnDelay
from support.observing import Rehearsal, measured

FRAME_S = 0.1
NEAR = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=1.0),
    on_delay=OnDelay(hold_s=14.0),
    off_delay_s=14.0,
)
GONE = AlarmRule(
    name="gone", target="ball", output=None, condition=PresenceCondition(seen=False), on_delay=OnDelay(hold_s=14.0)
)
FOLLOW = FollowRule(name="follow", target="ball", output="base", distance_m=1.0)


def rehearse(*rules, frame_s=FRAME_S, **safety):
    return Rehearsal(
        Plan(
            targets=("ball",),
            rules=rules,
            outputs=(LevelOutput(name="buzzer"), BaseOutput(name="base")),
            tracking=Tracking(confirm_frames=2),
            safety=Safety(**safety),
        ),
        frame_s,
    )


def pause(run, seconds):
    """Let the process stand still: not even a cycle comes."""
    run.now_s += seconds


def frames(seconds):
    return round(seconds / FRAME_S)


def raised_at_s(run, rule):
    return next(
        at_s
        for at_s, decision in run.decisions
        for event in decision.events
        if (event.source, event.kind) == (rule, "raised")
    )


def test_after_a_pause_of_the_process_nothing_moves_until_enough_fresh_frames_have_come():
    run = rehearse(FOLLOW)
    assert run.see(*[3.0] * 10).commands[1].linear_mps > 0
    pause(run, 10.0)
    first, second = run.see(3.0), run.see(3.0)
    assert [decision.safety for decision in (first, second)] == [SafetyMode.STALE] * 2
    assert [decision.commands[1].linear_mps for decision in (first, second)] == [0.0, 0.0]
    assert run.see(3.0).commands[1].linear_mps > 0
    assert run.events("camera") == ["fault", "fault_cleared"]


def test_after_a_pause_of_the_process_a_target_is_lost_until_it_is_confirmed_anew():
    run = rehearse()
    run.see(*[3.0] * 10)
    pause(run, 10.0)
    (track,) = run.see(3.0).tracks
    assert track.status is TrackStatus.LOST
    (track,) = run.see(3.0).tracks
    assert track.status is TrackStatus.TRACKING
    assert run.events("ball") == ["target_seen", "target_lost", "target_seen"]


def test_the_reason_names_the_pause_and_the_key_of_its_limit():
    run = rehearse()
    run.see(*[3.0] * 10)
    pause(run, 10.0)
    decision = run.see(3.0)
    for reason in (decision.safety_reason, *(event.reason for event in decision.events)):
        assert "10.10 s" in reason
        assert "safety.max_frame_age" in reason


@pytest.mark.parametrize(("rule", "before", "after"), [(NEAR, 0.5, 0.5), (GONE, None, None)])
def test_an_on_delay_is_not_satisfied_by_time_in_which_nobody_observed(rule, before, after):
    run = rehearse(rule)
    run.see(*[3.0] * 5, *[before] * frames(4.0))
    pause(run, 11.0)
    resumed_s = run.now_s
    run.see(*[after] * frames(16.0))
    assert raised_at_s(run, rule.name) - resumed_s >= 14.0


def test_an_off_delay_is_not_satisfied_by_time_in_which_nobody_observed():
    run = rehearse(replace(NEAR, on_delay=OnDelay()))
    run.see(*[3.0] * 5, *[0.5] * 20, *[3.0] * frames(4.0))
    pause(run, 11.0)
    assert "cleared" not in run.events("near")
    run.see(*[3.0] * frames(13.0))
    assert "cleared" not in run.events("near")
    run.see(*[3.0] * frames(2.0))
    assert "cleared" in run.events("near")


def test_how_long_a_target_is_out_of_sight_is_counted_anew_after_a_pause():
    rule = replace(GONE, condition=PresenceCondition(seen=False, for_s=14.0), on_delay=OnDelay())
    run = rehearse(rule)
    run.see(*[3.0] * 5, *[None] * frames(4.0))
    pause(run, 11.0)
    resumed_s = run.now_s
    run.see(*[None] * frames(16.0))
    assert raised_at_s(run, "gone") - resumed_s >= 14.0


@pytest.mark.parametrize("frame_s", [0.25, 1.0])
def test_a_camera_or_a_computer_that_is_always_slow_makes_no_gaps(frame_s):
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=3.0)), frame_s=frame_s)
    run.see(*[0.5] * 30)
    assert run.decisions[-1][1].safety is SafetyMode.ACTIVE
    assert run.events("near") == ["raised"]
    assert run.events("ball") == ["target_seen"]


def test_a_camera_of_unknown_age_moves_nothing_while_alarms_go_on():
    run = rehearse(FOLLOW, replace(NEAR, on_delay=OnDelay()))
    for number in range(20):
        run.now_s += FRAME_S
        run.cycle(
            Observation(
                now_s=run.now_s,
                frame=FrameStamp(sequence=number, captured_at_s=run.now_s),
                measurements=(measured("ball", run.now_s, 0.5),),
                not_for_motion="its pictures are of unknown age",
            )
        )
    decision = run.decisions[-1][1]
    assert (decision.safety, decision.safety_reason) == (SafetyMode.STARTING, "its pictures are of unknown age")
    assert [
        getattr(command, "level", None) or getattr(command, "linear_mps", 0.0) for command in decision.commands
    ] == [0.0, 0.0]
    assert decision.rules[1].status is RuleStatus.ACTIVE


@settings(max_examples=40)
@given(
    before_s=st.floats(0.5, 13.0),
    pauses_s=st.lists(st.floats(0.45, 60.0), min_size=1, max_size=4),
    between_s=st.floats(0.0, 13.0),
)
def test_no_alarm_is_raised_by_less_observation_than_its_on_delay(before_s, pauses_s, between_s):
    run = rehearse(NEAR)
    run.see(*[3.0] * 3, *[0.5] * frames(before_s))
    for pause_s in pauses_s:
        pause(run, pause_s)
        run.see(*[0.5] * (1 + frames(between_s)))
        assert run.events("near") == []
