"""What alarms remember beyond a restart and a reload: the same happens as without it."""

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Struct
from msgspec.structs import fields, replace

from stadimeter.core.alarms.machine import AlarmRecord, AlarmState
from stadimeter.core.alarms.state import Inhibits, Leg, Resumed, Timers
from stadimeter.core.conditions.compounds import AllOf
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.persistence import (
    SnapshotChange,
    classify_change,
    find_absences,
    meaning_of,
    reload,
    restore_alarms,
    shift_times,
    snapshot_alarms,
)
from stadimeter.core.rule import EscalationStep, LostPolicy, OnDelay
from support.each_case import each_case
from support.observing import Rehearsal
from support.two_rules import FAR, NEAR, plan_of, rehearse

# What alarms remember beyond a restart: the same happens as without it.


class Life:
    """A run that is restarted now and then, and what the world does meanwhile.

    The world's time goes on. Each run has a clock of its own, as after another boot of the computer.
    """

    def __init__(self, plan, distance_m, clock_s=0.0):
        self.plan = plan
        self.distance_m = distance_m
        self.run = Rehearsal(plan)
        self.time_s = 0.0
        self.offset_s = 0.0
        self.past = []
        self.run.now_s = clock_s
        self.offset_s = clock_s

    def live(self, until_s):
        while self.time_s < until_s - 1e-9:
            self.time_s = round(self.time_s + 0.1, 9)
            self.run.see(self.distance_m(self.time_s))

    def restart(self, down_s, clock_s):
        memories, absences, saved_s = snapshot_alarms(self.run.state), find_absences(self.run.state), self.run.now_s
        self.past += self.events_of_this_run()
        self.time_s = round(self.time_s + down_s, 9)
        fresh = Rehearsal(self.plan)
        fresh.now_s = clock_s
        from_s = clock_s - down_s
        fresh.state = restore_alarms(
            fresh.state, memories, absences, shift_s=from_s - saved_s, from_s=from_s, now_s=clock_s
        )
        self.offset_s = clock_s - self.time_s
        self.run = fresh

    def events_of_this_run(self):
        return [
            (round(now_s - self.offset_s, 3), event.kind.value, event.notify)
            for now_s, decision in self.run.decisions
            for event in decision.events
            if event.source == "near"
        ]

    def events(self):
        return self.past + self.events_of_this_run()


def comes_and_goes(time_s):
    """Near from 3 s to 9 s, and again from 14 s to 20 s."""
    return 0.6 if 3 <= time_s < 9 or 14 <= time_s < 20 else 3.0


VARIANTS = {
    "plain": NEAR,
    "pending": replace(NEAR, on_delay=OnDelay(hold_s=2.95)),
    "frames": replace(NEAR, on_delay=OnDelay(frames=3, of_frames=5)),
    "acknowledge": replace(NEAR, ack="required"),
    "latch": replace(NEAR, latch=True),
    "cooldown": replace(NEAR, cooldown_s=12.95),
    "again": replace(NEAR, realarm_s=2.45),
    "first": replace(NEAR, group="door"),
    "then": replace(NEAR, escalation=(EscalationStep(after_s=1.5, output="motor", for_s=2.0),)),
}


SHORT, LONG = (0.1, 1000.0), (1.0, 5.0)
"""For how long it is down, and what its clock says afterwards; random ones are tried below."""


@cache
def undisturbed(variant, until_s):
    """Return what happens without a restart."""
    life = Life(plan_of(VARIANTS[variant], FAR), comes_and_goes)
    life.live(until_s)
    return life.events()


@pytest.mark.long
@each_case("variant", VARIANTS)
@each_case(
    ("restart_s", "down_s", "clock_s"),
    [
        (restart_s, *(SHORT if number % 2 else LONG))
        for number, restart_s in enumerate((1.0, 3.1, 3.3, 4.5, 6.0, 9.2, 10.5, 12.0, 15.0))
    ],
)
def test_after_a_restart_the_same_happens_as_without_it(variant, restart_s, down_s, clock_s):
    disturbed = Life(plan_of(VARIANTS[variant], FAR), comes_and_goes)
    disturbed.live(restart_s)
    disturbed.restart(down_s, clock_s)
    disturbed.live(25)
    expected, found = undisturbed(variant, 25), disturbed.events()
    assert [each[1:] for each in found] == [each[1:] for each in expected]
    back_s = restart_s + down_s + 0.41  # then the target is confirmed again
    late_s = 0.1 if variant == "again" else 1e-6  # it is reported again some time after it was last reported
    for (found_s, *_), (expected_s, *_) in zip(found, expected, strict=True):
        is_in_time = expected_s - 1e-6 <= found_s <= expected_s + late_s + 1e-6
        assert is_in_time or restart_s < expected_s <= found_s <= back_s


@pytest.mark.long
@settings(max_examples=40)
@given(
    variant=st.sampled_from(sorted(VARIANTS)),
    restarts=st.lists(st.tuples(st.floats(0.3, 8), st.floats(0, 1), st.floats(0, 1e6)), min_size=1, max_size=4),
)
def test_however_often_it_is_restarted_no_alarm_is_lost_and_none_comes_twice(variant, restarts):
    disturbed = Life(plan_of(VARIANTS[variant], FAR), comes_and_goes)
    for after_s, down_s, clock_s in restarts:
        disturbed.live(disturbed.time_s + round(after_s, 1))
        disturbed.restart(round(down_s, 1), round(clock_s, 1))
    disturbed.live(40)
    lives = undisturbed(variant, 40), disturbed.events()
    expected, found = (sorted(kind for _, kind, _ in events if kind != "realarmed") for events in lives)
    assert found == expected


def test_an_alarm_that_is_active_comes_back_active_and_is_not_raised_again():
    life = Life(plan_of(NEAR), lambda _time_s: 0.6)
    life.live(3)
    life.restart(60.0, 7.0)
    life.live(70)
    assert [kind for _, kind, _ in life.events()] == ["raised"]
    assert life.run.decisions[-1][1].commands[0].level == 1.0


def test_outputs_move_only_when_fresh_frames_come_after_the_restart():
    life = Life(plan_of(NEAR), lambda _time_s: 0.6)
    life.live(3)
    life.restart(0.5, 7.0)
    assert life.run.wait(1.0).commands[0].level == 0.0
    assert life.run.see(0.6).commands[0].level == 1.0


def test_shelving_ends_when_it_would_have_ended():
    life = Life(plan_of(NEAR), lambda _time_s: 3.0)
    life.live(1)
    life.run.tell("shelve", "near", for_s=10.0)
    life.restart(4.0, 500.0)
    life.live(20)
    shelved, unshelved = life.events()
    assert (shelved[1], unshelved[1]) == ("shelved", "unshelved")
    assert unshelved[0] == pytest.approx(11.0, abs=0.15)


def test_what_people_have_said_is_remembered():
    life = Life(plan_of(replace(NEAR, ack="required")), lambda _time_s: 0.6)
    life.live(1)
    life.run.tell("acknowledge", "near", by="Ada", why="on my way")
    ago_s = life.run.now_s - life.run.state.rules.steps[0].record.acknowledgement.at_s
    life.run.tell("take-out", "near", by="Ada")
    life.restart(1.0, 500.0)
    (trace,) = life.run.state.rules.traces
    said = life.run.state.rules.steps[0].record.acknowledgement
    assert (said.by, said.why) == ("Ada", "on my way")
    assert said.at_s == pytest.approx(500.0 - 1.0 - ago_s, abs=0.1)  # one second down, on another clock
    assert trace.acknowledged
    assert trace.inhibits == ("out of service",)


def test_a_target_that_is_out_of_sight_after_the_restart_is_waited_for_before_anything_is_concluded():
    clear = replace(NEAR, lost=replace(NEAR.lost, policy=LostPolicy.CLEAR))
    life = Life(plan_of(clear), lambda time_s: 0.6 if time_s < 3 else None)
    life.live(2)
    life.restart(2.0, 50.0)
    life.live(9)
    assert [kind for _, kind, _ in life.events()] == ["raised"]
    life.live(20)
    assert [kind for _, kind, _ in life.events()] == ["raised", "cleared"]


@pytest.mark.parametrize("restart_s", [4.0, 9.0])
def test_how_long_a_target_has_been_away_is_counted_on(restart_s):
    rule = replace(NEAR, condition=PresenceCondition(seen=False, for_s=20.0), on_delay=OnDelay())
    life = Life(plan_of(rule), lambda time_s: 3.0 if time_s < 3 else None)
    life.live(restart_s)
    life.restart(2.0, 50.0)
    life.live(30)
    ((raised_s, kind, _),) = life.events()
    assert kind == "raised"
    assert raised_s == pytest.approx(3.0 + 20, abs=0.3)


@pytest.mark.parametrize("seen", [True, False])
def test_a_restart_is_no_reason_to_take_a_target_for_lost(seen):
    rule = replace(NEAR, condition=PresenceCondition(seen=seen), off_delay_s=0.3)
    life = Life(plan_of(rule), lambda _time_s: 3.0)
    life.live(3)
    before = life.events()
    life.restart(2.0, 50.0)
    life.run.wait(1.5)  # the camera is starting
    life.live(9)
    assert life.events() == before
    assert [kind for _, kind, _ in before] == (["raised"] if seen else [])


def test_a_target_that_stays_away_after_a_restart_is_lost_in_the_end():
    rule = replace(NEAR, condition=PresenceCondition(seen=False))
    life = Life(plan_of(rule), lambda time_s: 3.0 if time_s < 3 else None)
    life.live(2.5)
    life.restart(2.0, 50.0)
    life.live(20)
    ((raised_s, kind, _),) = life.events_of_this_run()
    assert kind == "raised"
    assert raised_s == pytest.approx(4.5 + 10, abs=0.3)


def test_a_safety_rule_does_not_wait_for_its_target_after_a_restart():
    rule = replace(NEAR, condition=PresenceCondition(seen=False), severity=Severity.SAFETY)
    life = Life(plan_of(rule), lambda time_s: 3.0 if time_s < 3 else None)
    life.live(2.5)
    life.restart(2.0, 50.0)
    life.live(6)
    assert [kind for _, kind, _ in life.events_of_this_run()] == ["raised"]


def test_an_alarm_that_had_given_up_before_the_restart_says_when_its_target_is_back():
    life = Life(plan_of(NEAR), lambda time_s: 0.6 if time_s < 2 or time_s > 15 else None)
    life.live(10)
    life.restart(1.0, 50.0)
    life.live(17)
    assert [kind for _, kind, _ in life.events()] == ["raised", "measurement_lost", "measurement_back"]


def test_a_timer_that_was_written_long_before_a_crash_goes_on_from_there():
    rule = replace(NEAR, on_delay=OnDelay(hold_s=5.0))
    run = rehearse(rule)
    run.see(3, 3, 0.6, 0.6)
    memories, saved_s = snapshot_alarms(run.state), run.now_s
    run.see(*[0.6] * 20)
    crashed_s = run.now_s
    again = rehearse(rule)
    again.now_s = crashed_s + 0.5
    again.state = restore_alarms(again.state, memories, shift_s=0.0, from_s=saved_s, now_s=again.now_s)
    again.see(*[0.6] * 30)
    (raised_s,) = [event.at_s for _, decision in again.decisions for event in decision.events if event.source == "near"]
    assert raised_s == pytest.approx(0.3 + 5.0, abs=0.11)


def test_a_rule_that_means_something_else_starts_anew():
    run = rehearse(NEAR)
    run.see(3, 0.6, 0.6, 0.6)
    other = rehearse(replace(NEAR, condition=DistanceCondition(below=0.9)))
    state = restore_alarms(other.state, snapshot_alarms(run.state), shift_s=0.0, from_s=1.0, now_s=1.0)
    assert state.rules.steps[0].record == AlarmRecord()


# What a rule means


@each_case(
    "other",
    [
        replace(NEAR, condition=DistanceCondition(below=1.1)),
        replace(NEAR, condition=DistanceCondition(above=1.0)),
        replace(NEAR, condition=AllOf(conditions=(NEAR.condition,))),
        replace(NEAR, condition=PresenceCondition(seen=True)),
        replace(NEAR, severity=Severity.SAFETY),
        replace(NEAR, off_delay_s=2.1),
        replace(NEAR, latch=True),
        replace(NEAR, target="tag"),
        replace(NEAR, name="nearer"),
        replace(NEAR, escalation=(EscalationStep(output="motor"),)),
    ],
)
def test_rules_that_differ_mean_different_things(other):
    assert meaning_of(other) != meaning_of(NEAR)


def test_equal_rules_mean_the_same_in_every_process():
    assert meaning_of(replace(NEAR)) == meaning_of(NEAR)
    assert meaning_of(FAR) == "7009e6a80ba2bcea248cbbcff7b483f76dbf1042b2c35bfc395129d3e965de0c"


# Which times are times


def everything_in(value, name=""):
    if isinstance(value, Struct):
        for field in fields(value):
            yield from everything_in(getattr(value, field.name), field.name)
    elif isinstance(value, float):
        yield name, value


EVERYTHING = AlarmRecord(
    state=AlarmState.ACKNOWLEDGED,
    timers=Timers(held_s=1.0, ended_s=1.0),
    unknown_since_s=1.0,
    raised_at_s=1.0,
    reported_at_s=1.0,
    notified_at_s=1.0,
    leg=Leg(
        on="raised",
        began_s=1.0,
        event=Event(
            kind=EventKind.RAISED,
            source="near",
            at_s=1.0,
            severity=Severity.INFO,
            reason="",
            distance_m=1.0,
            sigma_m=1.0,
        ),
    ),
    inhibits=Inhibits(shelved_until_s=1.0),
    resumed=Resumed(from_s=1.0, at_s=1.0),
)


def test_times_move_to_the_new_clock_and_durations_and_lengths_do_not():
    moved = [name for name, value in everything_in(shift_times(EVERYTHING, 100.0)) if value == 101.0]
    stayed = [name for name, value in everything_in(shift_times(EVERYTHING, 100.0)) if value == 1.0]
    times = "at_s at_s began_s from_s notified_at_s raised_at_s reported_at_s shelved_until_s unknown_since_s"
    assert sorted(moved) == times.split()
    assert sorted(stayed) == ["distance_m", "ended_s", "held_s", "sigma_m"]


# A changed configuration is taken over by the rules that mean the same; and what of it all is worth writing down.

# What is worth writing down


def turns(run, *distances_m, **how):
    found = []
    for distance_m in distances_m:
        before = run.state
        run.see(distance_m, **how)
        found.append(classify_change(before, run.state))
    return found


def test_a_quiet_scene_is_nothing_to_write_down():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3)
    assert set(turns(run, *[3.0, 3.01, 2.99] * 20)) == {SnapshotChange.NOTHING}


def test_a_timer_that_runs_is_nothing_and_one_that_begins_is_passing():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=5.0)))
    run.see(3, 3, 3)
    found = turns(run, *[0.6] * 10)
    assert found.count(SnapshotChange.PASSING) == 1
    assert SnapshotChange.LASTING not in found


@pytest.mark.parametrize(("for_s", "expected"), [(20.0, SnapshotChange.PASSING), (0.0, SnapshotChange.NOTHING)])
def test_that_a_target_goes_is_worth_it_if_a_rule_counts_the_time(for_s, expected):
    rule = replace(NEAR, condition=PresenceCondition(seen=False, for_s=for_s), on_delay=OnDelay(hold_s=1e6))
    run = rehearse(rule)
    run.see(3, 3, 3)
    before = run.state
    while run.state.tracks[0].track.is_valid:
        before = run.state
        run.see(None)
    assert classify_change(replace(before, rules=run.state.rules), run.state) is expected


def test_what_people_are_told_of_is_lasting():
    run = rehearse(NEAR)
    run.see(3, 3, 3)
    assert max(turns(run, 0.6, 0.6)) is SnapshotChange.LASTING


def test_what_people_say_is_lasting():
    run = rehearse(NEAR)
    run.see(3, 3, 3)
    before = run.state
    run.tell("shelve", "near", for_s=60)
    assert classify_change(before, run.state) is SnapshotChange.LASTING


# A changed configuration


def test_rules_that_mean_the_same_go_on_as_if_nothing_had_happened():
    run = rehearse(NEAR, FAR)
    run.see(3, 0.6, 0.6, 0.6)
    steps = run.state.rules.steps
    taken = reload(run.state, plan_of(replace(NEAR, name="other", output=None), NEAR, FAR))
    assert taken.state.rules.steps[1:] == steps
    assert (taken.kept, taken.added, taken.changed, taken.removed) == (("near", "far"), ("other",), (), ())
    run.state = taken.state
    assert run.see(0.6).commands[0].level == 1.0
    assert run.events("near") == ["raised"]


def test_an_alarm_whose_rule_is_removed_clears_and_lets_its_output_go_at_once():
    run = rehearse(NEAR, FAR)
    run.see(3, 0.6, 0.6, 0.6)
    run.state = reload(run.state, plan_of(FAR)).state
    decision = run.see(0.6)
    (event,) = [event for event in decision.events if event.source == "near"]
    assert (event.kind, event.reason) == (EventKind.CLEARED, "removed from the configuration")
    assert event.sequence == len(run.events()) - 1
    assert decision.commands[0].level == 0.0
    assert [trace.rule for trace in decision.rules] == ["far"]
    run.see(0.6, 0.6)
    assert run.events("near") == ["raised", "cleared"]


def test_an_alarm_whose_rule_is_changed_clears_and_begins_anew():
    run = rehearse(NEAR)
    run.see(3, 0.6, 0.6, 0.6)
    taken = reload(run.state, plan_of(replace(NEAR, condition=DistanceCondition(below=0.7))))
    assert taken.changed == ("near",)
    run.state = taken.state
    run.see(0.6, 0.6)
    assert run.events("near") == ["raised", "cleared", "raised"]


def test_a_rule_that_did_nothing_is_removed_without_a_word():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3)
    run.state = reload(run.state, plan_of(FAR)).state
    run.see(3)
    assert run.events("near") == []


def test_targets_outputs_and_safety_go_on():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3, 3)
    before = run.state
    after = reload(before, plan_of(FAR)).state
    assert (after.tracks, after.outputs, after.safety, after.now_s) == (
        before.tracks,
        before.outputs,
        before.safety,
        before.now_s,
    )
    run.state = after
    assert run.see(3).commands[1].level == pytest.approx(0.5, abs=0.01)


def test_taking_over_the_same_configuration_changes_no_decision():
    with_reload, without = rehearse(NEAR, FAR), rehearse(NEAR, FAR)
    for count, distance_m in enumerate([3, 2, 0.6, 0.6, 0.6, 3, 3, 3, None, None, 0.6, 0.6] * 3):
        with_reload.state = reload(with_reload.state, plan_of(NEAR, FAR)).state
        assert with_reload.see(distance_m) == without.see(distance_m), count
