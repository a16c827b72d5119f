"""What other rules change over a recording: events, chatter, lateness, what they let pass."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.workbench.replay.comparison import compare
from stadimeter.workbench.replay.replay_figures import Stay, Tally, stays
from support.observing import Rehearsal

FRAME_S = 0.05


def plan(below_m=1.0, **changes):
    alarm = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=below_m), off_delay_s=0.0)
    return Plan(targets=("ball",), rules=(replace(alarm, **changes),))


def tallied(rules, distances_m):
    class Tallied(Rehearsal):
        def cycle(self, observation):
            decision = super().cycle(observation)
            tally.add(observation, decision)
            return decision

    tally = Tally(rules)
    Tallied(rules, frame_s=FRAME_S).see(*distances_m)
    return tally


def way(*legs):
    """Return distances a frame at a time: of each leg from where, to where, at what speed."""
    distances_m = []
    for from_m, to_m, speed_mps in legs:
        frames = round(abs(to_m - from_m) / speed_mps / FRAME_S)
        distances_m += [from_m + (to_m - from_m) * number / frames for number in range(frames)]
    return distances_m


IN_AND_OUT = way((3.0, 0.5, 0.5), (0.5, 3.0, 0.5))


def kinds(diff):
    return [(change.change, change.event.kind.value, change.event.source) for change in diff.changes]


def test_the_same_rules_change_nothing():
    diff = compare(tallied(plan(), IN_AND_OUT), tallied(plan(), IN_AND_OUT))
    assert diff.changes == ()
    assert diff.same == 3
    assert diff.minutes == pytest.approx(len(IN_AND_OUT) * FRAME_S / 60, rel=0.02)


def test_a_nearer_limit_moves_the_alarm_later_and_its_end_earlier():
    diff = compare(tallied(plan(1.2), IN_AND_OUT), tallied(plan(1.0), IN_AND_OUT))
    raised, cleared = diff.changes
    assert (raised.change, raised.event.kind, cleared.change, cleared.event.kind) == (
        "moved",
        EventKind.RAISED,
        "moved",
        EventKind.CLEARED,
    )
    assert raised.by_s == pytest.approx(0.2 / 0.5, abs=0.11)
    assert cleared.by_s == pytest.approx(-0.2 / 0.5, abs=0.11)


def test_a_limit_that_is_never_crossed_loses_the_alarm_and_the_other_way_round_adds_it():
    crossed, never = tallied(plan(1.0), IN_AND_OUT), tallied(plan(0.3), IN_AND_OUT)
    assert kinds(compare(crossed, never)) == [("lost", "raised", "near"), ("lost", "cleared", "near")]
    assert kinds(compare(never, crossed)) == [("added", "raised", "near"), ("added", "cleared", "near")]


def test_an_on_delay_shows_as_lateness_and_as_distance_let_pass():
    prompt = tallied(plan(), IN_AND_OUT).figures()[0]
    slow = tallied(plan(on_delay=OnDelay(hold_s=0.5)), IN_AND_OUT).figures()[0]
    assert prompt.late_median_s == pytest.approx(0.0, abs=0.1)
    assert slow.late_median_s == pytest.approx(0.5, abs=0.12)
    assert slow.least_distance_m == pytest.approx(1.0 - 0.5 * 0.5, abs=0.06)
    assert prompt.least_distance_m > slow.least_distance_m
    assert (slow.missed, slow.unfounded) == (0, 0)


def test_a_crossing_that_raised_nothing_is_missed():
    figures = tallied(plan(on_delay=OnDelay(hold_s=60.0)), IN_AND_OUT).figures()[0]
    assert (figures.raised, figures.missed, figures.late_median_s) == (0, 1, None)


def test_rules_that_only_one_side_has_are_shown_for_that_side():
    other = Plan(targets=("ball",), rules=(replace(plan().rules[0], name="close"),))
    changes = compare(tallied(plan(), IN_AND_OUT), tallied(other, IN_AND_OUT)).rules
    assert [(change.rule, change.old is None, change.new is None) for change in changes] == [
        ("close", True, False),
        ("near", False, True),
    ]


def seconds(count):
    return [number * FRAME_S for number in range(count)]


def test_the_moment_of_a_crossing_is_found_between_frames_and_without_delay():
    distances_m = [2.0 - 1.0 * at_s for at_s in seconds(40)]
    (stay,) = stays(seconds(40), distances_m, DistanceCondition(below=1.123))
    assert stay == Stay(pytest.approx(0.877, abs=1e-6), pytest.approx(39 * FRAME_S), is_entered=True)


@given(
    distances_m=st.lists(st.floats(0.1, 10) | st.just(math.nan), max_size=60),
    gaps_s=st.lists(st.floats(0.01, 2), min_size=60, max_size=60),
)
def test_stays_are_in_order_apart_and_within_what_was_measured(distances_m, gaps_s):
    at_s = [sum(gaps_s[: number + 1]) for number in range(len(distances_m))]
    found = stays(at_s, distances_m, DistanceCondition(below=3.0, above=1.0))
    bounds_s = [bound_s for stay in found for bound_s in (stay.from_s, stay.to_s)]
    assert bounds_s == sorted(bounds_s)
    assert all(at_s[0] <= bound_s <= at_s[-1] for bound_s in bounds_s)


@given(
    old_s=st.lists(st.floats(0, 100), max_size=12).map(sorted),
    new_s=st.lists(st.floats(0, 100), max_size=12).map(sorted),
)
def test_every_event_is_counted_once(old_s, new_s):
    def raised(times_s):
        tally = Tally(plan())
        tally.events = [
            Event(kind=EventKind.RAISED, source="near", at_s=at_s, severity=Severity.ALARM, reason="")
            for at_s in times_s
        ]
        return tally

    diff = compare(raised(old_s), raised(new_s))
    count = {name: sum(change.change == name for change in diff.changes) for name in ("added", "lost", "moved")}
    assert diff.same + count["moved"] + count["lost"] == len(old_s)
    assert diff.same + count["moved"] + count["added"] == len(new_s)
    assert all(abs(change.by_s) <= 5.0 for change in diff.changes)
