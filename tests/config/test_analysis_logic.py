"""What the analysis says of conditions is true of every situation: held against the core, which judges them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.config.analysis.logic import Intervals, Logic, Wanted, interval, union_of, week_of
from stadimeter.config.analysis.regions import beginning_of
from stadimeter.core.base_report import BaseReport
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not, judge
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_base import BatteryCondition, ContactSensorCondition
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.observation import WallTime
from stadimeter.core.track import Track, TrackStatus
from support.conditions import closing, direction, separation

NOW_S = 1000.0
TARGETS = ("ball", "tag")
RULES = ("one", "two")

# Limits are whole and figures are not: exactly at a limit nothing is claimed.
limits = st.integers(1, 4).map(float)
figures = st.integers(0, 5).map(lambda whole: whole + 0.5)
targets = st.sampled_from(TARGETS)


def ends(draw: st.DrawFn) -> tuple[float | None, float | None]:
    return draw(st.one_of(st.tuples(limits, st.none()), st.tuples(st.none(), limits), st.tuples(limits, limits)))


VOLTAGES_V = (None, 10.0, 11.0, 12.0)


@st.composite
def leaves(draw: st.DrawFn) -> Condition:
    low, high = ends(draw)
    target, deadband = draw(targets), float(draw(st.integers(0, 2)))
    hours = st.integers(0, 23).map(lambda hour: hour * 3600.0)
    return draw(
        st.sampled_from(
            [
                DistanceCondition(
                    above_m=low,
                    below_m=high,
                    quantity=draw(st.sampled_from(["distance", "depth"])),
                    deadband_m=deadband,
                    deadband_sigmas=0.0,
                    probability_on=None,
                    target=target,
                ),
                direction(above=low, below=high, deadband=deadband, target=target),
                closing(above=low, below=high, deadband_sigmas=0.0, probability_on=None, target=target),
                TimeToContactCondition(
                    below_s=draw(limits), closing_min_mps=draw(limits), probability_on=None, target=target
                ),
                separation(targets=TARGETS, above=low, below=high, deadband_sigmas=0.0, probability_on=None),
                PresenceCondition(seen=draw(st.booleans()), for_s=float(draw(st.integers(0, 3))), target=target),
                CountCondition(at_least=draw(st.integers(1, 3)), at_most=draw(st.none() | st.integers(0, 2))),
                RuleCondition(rule=draw(st.sampled_from(RULES))),
                ContactSensorCondition(sensor=draw(st.sampled_from(["is_bumped", "is_at_cliff"]))),
                BatteryCondition(below_v=draw(st.sampled_from([10.8, 11.4]))),
                UndeliveredCondition(for_s=draw(st.sampled_from([0.5, 5.0]))),
                ScheduleCondition(from_s=draw(hours), to_s=draw(hours), weekdays=draw(st.sampled_from([(), (0, 5)]))),
            ]
        )
    )


def trees() -> st.SearchStrategy[Condition]:
    return st.recursive(
        leaves(),
        lambda inner: st.one_of(
            st.lists(inner, min_size=1, max_size=3).map(lambda parts: AllOf(conditions=tuple(parts))),
            st.lists(inner, min_size=1, max_size=3).map(lambda parts: AnyOf(conditions=tuple(parts))),
            inner.map(lambda part: Not(condition=part)),
        ),
        max_leaves=5,
    )


@st.composite
def tracks(draw: st.DrawFn, target: str) -> Track:
    since_s = NOW_S - draw(figures)
    if draw(st.integers(0, 3)) == 0:
        return Track(target=target, status=TrackStatus.LOST, since_s=since_s)
    bearing_rad = draw(st.sampled_from([-0.5, 0.5]))
    depth_m = draw(figures)
    return Track(
        target=target,
        status=TrackStatus.TRACKING,
        distance_m=depth_m / math.cos(bearing_rad),
        depth_m=depth_m,
        closing_mps=draw(figures),
        sigma_m=0.0,
        closing_sigma_mps=0.0,
        closing_cov_m2ps=0.0,
        bearing_rad=bearing_rad,
        elevation_rad=0.0,
        as_of_s=NOW_S,
        since_s=since_s,
    )


@st.composite
def situations(draw: st.DrawFn) -> RuleInputs:
    hour = draw(st.integers(0, 23))
    return RuleInputs(
        tracks={target: draw(tracks(target)) for target in TARGETS},
        now_s=NOW_S,
        wall=draw(st.none() | st.builds(WallTime, second_of_day=st.just(hour * 3600.0 + 1), weekday=st.integers(0, 6))),
        base=draw(
            st.none() | st.builds(BaseReport, at_s=st.just(NOW_S), battery_v=st.none() | st.sampled_from(VOLTAGES_V))
        ),
        undelivered_since_s=draw(st.none() | st.sampled_from([0.0, 1.0, 8.0]).map(lambda waited_s: NOW_S - waited_s)),
        active={rule: draw(st.sampled_from([True, False, None])) for rule in RULES},
    )


@pytest.mark.long
@given(condition=trees(), inputs=situations())
def test_what_can_never_hold_is_never_judged_to_hold(condition: Condition, inputs: RuleInputs) -> None:
    if judge(condition, inputs, (), is_active=False).value is True:
        assert Logic(targets=TARGETS).can_be((beginning_of(condition), Wanted.TRUE))


@pytest.mark.long
@given(first=trees(), second=trees(), inputs=situations())
def test_two_that_were_judged_together_can_be_so_together(
    first: Condition, second: Condition, inputs: RuleInputs
) -> None:
    goals = []
    for condition in (first, second):
        value = judge(condition, inputs, (), is_active=False).value
        wanted = {True: Wanted.TRUE, False: Wanted.NOT_TRUE, None: Wanted.NOT_TRUE}[value]
        goals.append((condition if wanted is Wanted.NOT_TRUE else beginning_of(condition), wanted))
    if not _has_deadband_below_not(first) and not _has_deadband_below_not(second):
        assert Logic(targets=TARGETS).can_be(*goals)


def _has_deadband_below_not(condition: Condition) -> bool:
    return beginning_of(condition) != condition


@pytest.mark.long
@pytest.mark.parametrize(("goal", "opposite"), [(Wanted.TRUE, Wanted.NOT_TRUE), (Wanted.FALSE, Wanted.NOT_FALSE)])
@settings(max_examples=50, deadline=None)
@given(condition=trees())
def test_nothing_is_so_and_not_so(goal: Wanted, opposite: Wanted, condition: Condition) -> None:
    assert not Logic(targets=TARGETS).can_be((condition, goal), (condition, opposite))


def test_an_analysis_that_gives_up_says_that_everything_is_possible() -> None:
    impossible = AllOf(
        conditions=(DistanceCondition(below_m=1.0, target="ball"), DistanceCondition(above_m=2.0, target="ball"))
    )
    assert not Logic(targets=TARGETS).can_be((impossible, Wanted.TRUE))
    assert Logic(targets=TARGETS, steps_left=1).can_be((impossible, Wanted.TRUE))


@pytest.mark.long
def test_twenty_thousand_parts_are_looked_at_without_deep_recursion() -> None:
    near = DistanceCondition(below_m=1.0, target="ball")
    many = AllOf(conditions=(*[near] * 20_000, PresenceCondition(seen=False, target="ball")))
    assert not Logic(targets=TARGETS).can_be((many, Wanted.TRUE))


@given(
    parts=st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9))),
    number=st.integers(-10, 10).map(lambda n: n + 0.5),
)
def test_a_number_is_in_a_set_or_in_its_complement(parts: list[tuple[float, float]], number: float) -> None:
    numbers = union_of(parts)
    assert _holds(numbers, number) == any(low < number < high for low, high in parts)
    assert _holds(~numbers, number) is not _holds(numbers, number)
    assert (numbers & ~numbers).is_empty
    assert ~~numbers == numbers


def _holds(numbers: Intervals, number: float) -> bool:
    return not (numbers & interval(number - 0.1, number + 0.1)).is_empty


def test_a_night_that_begins_on_sunday_ends_on_monday() -> None:
    night = ScheduleCondition(from_s=22 * 3600.0, to_s=6 * 3600.0, weekdays=(6,))
    assert week_of(night).parts == ((0.0, 6 * 3600.0), (6 * 86400.0 + 22 * 3600.0, 7 * 86400.0))
