"""Alarms: when they are raised and cleared, and what they do without their target."""

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import RuleStatus
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, Lost, LostPolicy, OnDelay
from support.each_case import each_case
from support.observing import Rehearsal

NEAR = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=1.0),
    off_delay_s=0.5,
    lost=Lost(grace_s=0.5, fault_after_s=5.0),
)
TRACKING = Tracking(confirm_frames=1, coast_s=0.15, outliers_max=0, acceleration_mps2=10.0, autocorrelation=0.0)


def rehearse(rule=NEAR, frame_s=0.1):
    plan = Plan(
        targets=("ball",),
        rules=(rule,),
        outputs=(LevelOutput(name="buzzer"), BaseOutput(name="base")),
        tracking=TRACKING,
        safety=Safety(good_frames=1),
    )
    return Rehearsal(plan, frame_s)


def level(decision):
    return decision.commands[0].level


def test_an_approach_raises_it_once_and_leaving_clears_it_once():
    run = rehearse()
    run.see(3, 2.5, 2, 1.5, 0.8, 0.7, 0.8)
    assert run.events("near") == ["raised"]
    assert level(run.see(0.8)) == 1.0
    run.see(1.5, 2, 2.5, 3, 3, 3, 3)
    assert run.events("near") == ["raised", "cleared"]
    assert level(run.see(3)) == 0.0


def test_a_target_that_is_inside_from_the_start_raises_it():
    run = rehearse()
    run.see(0.8, 0.7)
    assert run.events("near") == ["raised"]
    event = next(event for _, decision in run.decisions for event in decision.events if event.source == "near")
    assert event.reason.startswith("so from the start: ")


def test_at_the_start_it_may_be_announced_without_moving_the_output():
    run = rehearse(replace(NEAR, at_start="announce"))
    assert level(run.see(0.8, 0.7, 0.7)) == 0.0
    assert run.events("near") == ["raised"]
    run.see(3, 3, 3, 3, 3, 3, 3)
    assert level(run.see(0.8, 0.7)) == 1.0


def test_while_held_without_its_target_it_keeps_acting_for_a_while_and_then_gives_up():
    run = rehearse()
    run.see(3, 0.8, 0.8)
    assert level(run.see(*[None] * 40)) == 1.0
    assert level(run.see(*[None] * 20)) == 0.0
    assert run.events("near") == ["raised", "measurement_lost"]
    assert level(run.see(0.8)) == 1.0
    assert run.events("near") == ["raised", "measurement_lost", "measurement_back"]


def test_a_fast_target_that_skips_the_limit_is_caught():
    run = rehearse()
    run.see(3.0, 0.4)
    assert run.events("near") == ["raised"]


def test_one_bad_frame_does_not_restart_the_delay():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=0.5)))
    run.see(3, 0.8, 0.8, 0.8, 1.5, 0.8)
    assert run.events("near") == []
    run.see(0.8)
    assert run.events("near") == ["raised"]


def test_a_delay_stands_still_while_the_target_is_out_of_sight():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=0.5)))
    run.see(3, 0.8, 0.8, 0.8, *[None] * 4, 0.8, 0.8)
    assert run.events("near") == []
    assert run.decisions[-1][1].rules[0].status is RuleStatus.PENDING
    run.see(0.8)
    assert run.events("near") == ["raised"]


@each_case(
    ("policy", "before", "expected"),
    [
        (LostPolicy.HOLD, 0.8, ["raised"]),
        (LostPolicy.HOLD, 3.0, []),
        (LostPolicy.CLEAR, 0.8, ["raised", "cleared"]),
        (LostPolicy.CLEAR, 3.0, []),
        (LostPolicy.ASSERT, 0.8, ["raised"]),
        (LostPolicy.ASSERT, 3.0, ["raised"]),
    ],
)
def test_after_the_grace_the_policy_decides(policy, before, expected):
    run = rehearse(replace(NEAR, lost=Lost(grace_s=0.5, policy=policy)))
    run.see(before, before, before, *[None] * 4)
    assert run.events("near") == expected[: 1 if before < 1 else 0]
    run.see(*[None] * 12)
    assert run.events("near") == expected


def test_cannot_see_counts_as_danger_from_the_start_where_asked_for():
    run = rehearse(replace(NEAR, lost=Lost(grace_s=0.5, policy=LostPolicy.ASSERT)))
    assert level(run.see(*[None] * 8)) == 1.0


def test_timers_run_on_capture_time_and_not_on_the_number_of_frames():
    fast, slow = (
        rehearse(replace(NEAR, on_delay=OnDelay(hold_s=1.0)), 0.01),
        rehearse(replace(NEAR, on_delay=OnDelay(hold_s=1.0)), 0.25),
    )
    fast.see(3, *[0.8] * 100)
    slow.see(3, *[0.8] * 4)
    assert fast.events("near") == slow.events("near") == []
    fast.see(0.8, 0.8)
    slow.see(0.8)
    assert fast.events("near") == slow.events("near") == ["raised"]


def test_an_alarm_that_drives_a_base_stops_it():
    run = rehearse(replace(NEAR, output="base"))
    decision = run.see(3, 0.8, 0.8)
    assert decision.outputs[1].winner == "near"
    assert (decision.commands[1].linear_mps, decision.commands[1].angular_radps) == (0.0, 0.0)
    assert decision.reasons["near"] == "0.800 m ± 0.010, below 1.05 m"


def test_being_seen_and_being_lost_are_conditions_too():
    lost = rehearse(replace(NEAR, name="gone", condition=PresenceCondition(seen=False)))
    lost.see(2, 2, *[None] * 5)
    assert lost.events("gone") == ["raised"]
    seen = rehearse(replace(NEAR, name="there", condition=PresenceCondition(seen=True)))
    seen.see(None, None, 2)
    assert seen.events("there") == ["raised"]


@given(st.lists(st.one_of(st.none(), st.floats(0.3, 3)), max_size=60))
def test_raised_and_cleared_always_alternate(distances):
    run = rehearse()
    if distances:
        run.see(*distances, sigma_m=0.05)
    changes = [kind for kind in run.events("near") if kind in {"raised", "cleared"}]
    assert changes == ["raised", "cleared"] * (len(changes) // 2) + ["raised"] * (len(changes) % 2)


def test_a_delay_is_forgotten_when_the_target_was_away_for_longer_than_the_grace():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=0.5)))
    run.see(3, 0.8, 0.8, 0.8, 0.8, *[None] * 12, 0.8, 0.8, 0.8, 0.8)
    assert run.events("near") == []


def test_an_alarm_that_was_only_announced_acts_when_the_target_is_lost_and_that_means_danger():
    run = rehearse(replace(NEAR, at_start="announce", lost=Lost(grace_s=0.3, policy=LostPolicy.ASSERT)))
    assert level(run.see(0.8, 0.8, 0.8)) == 0.0
    assert level(run.see(*[None] * 8)) == 1.0


def test_a_camera_that_is_dead_means_that_the_target_is_gone():
    run = rehearse(replace(NEAR, name="gone", condition=PresenceCondition(seen=False), on_delay=OnDelay(hold_s=1.0)))
    run.see(2, 2, 2)
    run.wait(0.8)
    assert run.events("gone") == []
    run.wait(1.0)
    assert run.events("gone") == ["raised"]


def test_a_camera_that_is_dead_ends_being_seen():
    run = rehearse(replace(NEAR, name="there", condition=PresenceCondition(seen=True)))
    run.see(2, 2, 2)
    assert run.events("there") == ["raised"]
    run.wait(2.0)
    assert run.events("there") == ["raised", "cleared"]


def test_a_target_that_creeps_over_the_limit_is_noticed_when_that_is_likely_enough():
    run = Rehearsal(Plan(targets=("ball",), rules=(replace(NEAR, output=None),)))
    run.see(*[1.1] * 10, *[0.997] * 10, sigma_m=0.03)
    assert run.events("near") == []
    run.see(0.98, 0.97, 0.96, 0.95, 0.94, 0.93, sigma_m=0.03)
    assert run.events("near") == ["raised"]


def test_a_target_between_two_limits_that_is_no_longer_sure_to_be_there_is_noticed():
    between = DistanceCondition(above=0.98, below=1.02, deadband_sigmas=0.0)
    run = Rehearsal(Plan(targets=("ball",), rules=(replace(NEAR, output=None, condition=between),)))
    run.see(*[1.0] * 10, sigma_m=0.001)
    run.see(*[1.0] * 30, sigma_m=0.5)
    assert run.events("near") == ["raised", "cleared"]
