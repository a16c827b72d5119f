"""On-delay and off-delay, and time in which the program stood still."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.alarms.state import Sample
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import RuleStatus, SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, DelayTolerance, FollowRule, Lost, LostPolicy, OnDelay
from stadimeter.core.rules.explaining import explain
from support.conditions import direction
from support.observing import Rehearsal, measured

# On-delay and off-delay: what they wait for lasts throughout, apart from noise that the rule forgives.

NEAR = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=1.0, probability_on=None))
BEARING = AlarmRule(
    name="near", target="ball", condition=direction(quantity="bearing", above=0.0), raises_per_min_max=0
)
"""It holds in exactly those frames in which the target is seen to the right: nothing is filtered."""
TRACKING = Tracking(confirm_frames=1, coast_s=0.15, outliers_max=0, acceleration_mps2=10.0, autocorrelation=0.0)
ROUNDING_S = 1e-6


def rehearse(rule, frame_s=0.1, tracking=TRACKING):
    plan = Plan(targets=("ball",), rules=(rule,), tracking=tracking, safety=Safety(good_frames=1))
    return Rehearsal(plan, frame_s)


def seen(run, *stretches):
    """Show the ball near (True) or away, for some seconds each, and return the times at which events came."""
    for is_near, for_s in stretches:
        run.see(*[0.5 if is_near else 2.0] * round(for_s / 0.1))
    return {
        event.kind.value: at_s
        for at_s, decision in run.decisions
        for event in decision.events
        if event.source == "near"
    }


def test_near_twice_for_less_than_the_delay_is_not_near_throughout():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=10.0)))
    assert "raised" not in seen(run, (False, 2), (True, 8), (False, 5), (True, 8))
    assert seen(run, (True, 3))["raised"] == pytest.approx(25.1, abs=0.2)


def test_a_light_goes_off_when_the_ball_has_been_away_throughout_and_not_before():
    run = rehearse(replace(NEAR, off_delay_s=30.0))
    happened = seen(run, (False, 1), (True, 4), (False, 28), (True, 3), (False, 45))
    assert happened["cleared"] == pytest.approx(66.0, abs=0.3)


def test_to_be_lost_with_a_delay_is_to_be_lost_for_that_long():
    lost = AlarmRule(
        name="near", target="ball", condition=PresenceCondition(seen=False), on_delay=OnDelay(hold_s=300.0)
    )
    lost_for = replace(lost, condition=PresenceCondition(seen=False, for_s=300.0), on_delay=OnDelay())
    raised_s = []
    for rule in (lost, lost_for):
        run = rehearse(rule, tracking=Tracking(confirm_frames=3, coast_s=0.3))
        run.see(*[1.0] * 20)
        for _ in range(8):
            run.see(*[None] * 480, *[1.0] * 20)
        run.see(*[None] * 3100)
        raised_s += [at_s for at_s, decision in run.decisions for each in decision.events if each.source == "near"]
    assert len(raised_s) == 2
    assert raised_s[0] == pytest.approx(raised_s[1], abs=0.2)


def test_a_rule_that_waits_says_for_how_long_it_has_held_without_a_break():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=20.0)))
    seen(run, (False, 1), (True, 5), (False, 2), (True, 1.8))
    assert "held for 1.7 s of the 20.0 s" in explain(run.decisions[-1][1], "near").sentence


# A naive judgement: every sample is looked at again for each


def is_forgiven(tolerance, before_s, run_s):
    return len(run_s) <= tolerance.samples or 0 < run_s[-1] - before_s <= tolerance.for_s + ROUNDING_S


def is_throughout(samples, delay_s, awaited, tolerance):
    """Return whether it has been so throughout some stretch of samples, long enough, that ends with the newest one."""
    if samples[-1][1] is not awaited:
        return False
    return any(
        is_so is awaited
        and samples[-1][0] - from_s + ROUNDING_S >= delay_s
        and all(is_forgiven(tolerance, before_s, run) for before_s, run in contrary_runs(samples[first:], awaited))
        for first, (from_s, is_so) in enumerate(samples)
    )


def contrary_runs(samples, awaited):
    """Yield each run of samples to the contrary, after the time of the sample before it."""
    run, before_s = [], math.nan
    for at_s, is_so in samples:
        if is_so is not awaited:
            run.append(at_s)
            continue
        if run:
            yield before_s, run
        run, before_s = [], at_s


def judged_naively(rule, samples):
    """Yield whether the alarm is active after each sample."""
    is_active, begun = False, 0
    for number in range(len(samples)):
        delay_s = rule.off_delay_s if is_active else rule.on_delay.hold_s
        stretch = samples[begun : number + 1]
        if is_throughout(stretch, delay_s, not is_active, rule.delay_tolerance):
            is_active, begun = not is_active, number + 1
        yield is_active


tolerances = st.sampled_from(
    [
        DelayTolerance(),
        DelayTolerance(samples=0, for_s=0.0),
        DelayTolerance(samples=0, for_s=0.3),
        DelayTolerance(samples=3, for_s=0.0),
    ]
)
delays = st.sampled_from([0.0, 0.2, 0.5, 1.0])
steps = st.sampled_from([1 / 30, 1 / 15, 0.1, 0.2, 0.5])
stretches = st.lists(st.tuples(st.booleans(), st.integers(1, 7)), min_size=1, max_size=25)


@settings(max_examples=150)
@given(tolerances, delays, delays, steps, stretches)
def test_it_is_raised_and_cleared_as_a_naive_judgement_of_every_stretch_says(tolerance, on_s, off_s, step_s, stretches):
    rule = replace(BEARING, on_delay=OnDelay(hold_s=on_s), off_delay_s=off_s, delay_tolerance=tolerance)
    holds = [is_so for is_so, count in stretches for _ in range(count)]
    samples = [(number * step_s, is_so) for number, is_so in enumerate(holds, start=1)]
    plan = Plan(targets=("ball",), rules=(rule,), tracking=TRACKING, safety=Safety(good_frames=1, max_frame_age_s=2.0))
    state, active = initial_state(plan), []
    for number, (at_s, is_so) in enumerate(samples):
        sight = measured("ball", at_s, 1.0, bearing_rad=0.1 if is_so else -0.1)
        stamp = FrameStamp(sequence=number, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=stamp, measurements=(sight,)))
        active.append(decision.rules[0].active)
    assert active == list(judged_naively(rule, samples))


# What cannot be judged


def judged_alone(rule, samples, step_s=0.1):
    """Return the state of an alarm after samples, None for one that cannot be judged."""
    state, at_s = AlarmRecord(), 0.0
    for holds in samples:
        at_s += step_s
        if holds is None:
            machine.take_nothing(rule, state, at_s)
            continue
        machine.come_back(rule, state, at_s)
        machine.take_sample(rule, state, Sample(at_s, step_s), holds, (), now_s=at_s)
    return state


WAITS = replace(BEARING, on_delay=OnDelay(hold_s=5.0), lost=Lost(grace_s=1.0))


def test_what_cannot_be_judged_counts_neither_for_nor_against_a_delay():
    held = judged_alone(WAITS, [True] * 11 + [None] * 5 + [True] * 11)
    assert held.timers.held_s == pytest.approx(2.0)
    assert judged_alone(WAITS, [True] * 11 + [None] * 5 + [False, True]).timers.held_s == pytest.approx(1.1)


def test_time_out_of_sight_between_two_samples_to_the_contrary_belongs_to_them():
    over = judged_alone(WAITS, [True] * 11 + [False] + [None] * 5 + [False, True])
    assert over.timers.held_s == 0.0
    strict = replace(WAITS, delay_tolerance=DelayTolerance(samples=0, for_s=0.3))
    assert judged_alone(strict, [True] * 11 + [None] * 5 + [False, True]).timers.held_s == 0.0


def test_frames_that_were_refused_as_outliers_count_neither_way_for_both_delays():
    rule = replace(NEAR, on_delay=OnDelay(hold_s=1.0), off_delay_s=1.0)
    delays_s = []
    for refused in ([], [8.0]):
        run = rehearse(rule, tracking=replace(TRACKING, outliers_max=3))
        run.see(*[2.0] * 5, *[0.5] * 8, *refused, *[0.5] * 16)
        gone_s = run.decisions[-1][0]
        run.see(*[2.0] * 8, *refused, *[2.0] * 16)
        happened = seen(run)
        delays_s.append((happened["raised"], happened["cleared"] - gone_s))
    (on_s, off_s), (on_refused_s, off_refused_s) = delays_s
    assert (on_refused_s - on_s, off_refused_s - off_s) == pytest.approx((0.1, 0.1), abs=0.01)


def test_an_off_delay_that_the_policy_counted_goes_on_when_the_target_is_seen_away():
    rule = replace(WAITS, on_delay=OnDelay(), off_delay_s=3.0, lost=Lost(grace_s=0.5, policy=LostPolicy.CLEAR))
    state = judged_alone(rule, [True] * 5 + [None] * 20 + [False] * 5)
    assert state.is_active
    assert state.timers.ended_s == pytest.approx(1.5 + 0.4, abs=0.15)


def test_one_frame_a_second_is_forgiven_one_frame_and_not_two():
    assert judged_alone(WAITS, [True, True, False, True, True, True], 1.0).is_active
    assert not judged_alone(WAITS, [True, True, False, False, True, True, True], 1.0).is_active


def test_an_off_delay_takes_two_samples_however_far_they_are_apart():
    rule = replace(BEARING, on_delay=OnDelay(), off_delay_s=1.0)
    assert judged_alone(rule, [True, True, False], 2.0).is_active
    assert not judged_alone(rule, [True, True, False, False], 2.0).is_active


def test_frames_of_frames_are_counted_as_before():
    rule = replace(BEARING, on_delay=OnDelay(frames=3, of_frames=5))
    assert judged_alone(rule, [True, False, False, True, True]).is_active
    assert not judged_alone(rule, [True, False, False, False, True, True]).is_active


# Time in which the program stood still: nothing that was known before it goes on by itself.

FRAME_S = 0.1
NEAR_FOR_14_S = AlarmRule(
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


def rehearse_outputs(*rules, frame_s=FRAME_S, **safety):
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
    run = rehearse_outputs(FOLLOW)
    assert run.see(*[3.0] * 10).commands[1].linear_mps > 0
    pause(run, 10.0)
    first, second = run.see(3.0), run.see(3.0)
    assert [decision.safety for decision in (first, second)] == [SafetyMode.STALE] * 2
    assert [decision.commands[1].linear_mps for decision in (first, second)] == [0.0, 0.0]
    assert run.see(3.0).commands[1].linear_mps > 0
    assert run.events("camera") == ["fault", "fault_cleared"]


def test_after_a_pause_of_the_process_a_target_is_lost_until_it_is_confirmed_anew():
    run = rehearse_outputs()
    run.see(*[3.0] * 10)
    pause(run, 10.0)
    (track,) = run.see(3.0).tracks
    assert track.status is TrackStatus.LOST
    (track,) = run.see(3.0).tracks
    assert track.status is TrackStatus.TRACKING
    assert run.events("ball") == ["target_seen", "target_lost", "target_seen"]


def test_the_reason_names_the_pause_and_the_key_of_its_limit():
    run = rehearse_outputs()
    run.see(*[3.0] * 10)
    pause(run, 10.0)
    decision = run.see(3.0)
    for reason in (decision.safety_reason, *(event.reason for event in decision.events)):
        assert "10.10 s" in reason
        assert "safety.max_frame_age" in reason


@pytest.mark.parametrize(("rule", "before", "after"), [(NEAR_FOR_14_S, 0.5, 0.5), (GONE, None, None)])
def test_an_on_delay_is_not_satisfied_by_time_in_which_nobody_observed(rule, before, after):
    run = rehearse_outputs(rule)
    run.see(*[3.0] * 5, *[before] * frames(4.0))
    pause(run, 11.0)
    resumed_s = run.now_s
    run.see(*[after] * frames(16.0))
    assert raised_at_s(run, rule.name) - resumed_s >= 14.0


def test_an_off_delay_is_not_satisfied_by_time_in_which_nobody_observed():
    run = rehearse_outputs(replace(NEAR_FOR_14_S, on_delay=OnDelay()))
    run.see(*[3.0] * 5, *[0.5] * 20, *[3.0] * frames(4.0))
    pause(run, 11.0)
    assert "cleared" not in run.events("near")
    run.see(*[3.0] * frames(13.0))
    assert "cleared" not in run.events("near")
    run.see(*[3.0] * frames(2.0))
    assert "cleared" in run.events("near")


def test_how_long_a_target_is_out_of_sight_is_counted_anew_after_a_pause():
    rule = replace(GONE, condition=PresenceCondition(seen=False, for_s=14.0), on_delay=OnDelay())
    run = rehearse_outputs(rule)
    run.see(*[3.0] * 5, *[None] * frames(4.0))
    pause(run, 11.0)
    resumed_s = run.now_s
    run.see(*[None] * frames(16.0))
    assert raised_at_s(run, "gone") - resumed_s >= 14.0


@pytest.mark.parametrize("frame_s", [0.25, 1.0])
def test_a_camera_or_a_computer_that_is_always_slow_makes_no_gaps(frame_s):
    run = rehearse_outputs(replace(NEAR_FOR_14_S, on_delay=OnDelay(hold_s=3.0)), frame_s=frame_s)
    run.see(*[0.5] * 30)
    assert run.decisions[-1][1].safety is SafetyMode.ACTIVE
    assert run.events("near") == ["raised"]
    assert run.events("ball") == ["target_seen"]


def test_a_camera_of_unknown_age_moves_nothing_while_alarms_go_on():
    run = rehearse_outputs(FOLLOW, replace(NEAR_FOR_14_S, on_delay=OnDelay()))
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
    run = rehearse_outputs(NEAR_FOR_14_S)
    run.see(*[3.0] * 3, *[0.5] * frames(before_s))
    for pause_s in pauses_s:
        pause(run, pause_s)
        run.see(*[0.5] * (1 + frames(between_s)))
        assert run.events("near") == []
