"""Conditions that rest are not judged until something concerns them, and that changes nothing."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.core.condition import (
    AllOf,
    AnyOf,
    ClosingCondition,
    CountCondition,
    DirectionCondition,
    DistanceCondition,
    Not,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
    SeparationCondition,
    TimeToContactCondition,
)
from stadimeter.core.conditions.crossings import crossings_of
from stadimeter.core.conditions.figures import (
    ClosingFigure,
    ContactFigure,
    CountFigure,
    DirectionFigure,
    DistanceFigure,
    PaceFigure,
    PresenceFigure,
    SeparationFigure,
)
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.verdict import due_s, judge, rests
from stadimeter.core.observation import WallTime
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from stadimeter.core.track import Track, TrackStatus

NAN = math.nan


def alarm(condition, name="alarm", **more):
    return AlarmRule(name=name, target="ball", condition=condition, **more)


def track(target="ball", distance_m=2.0, status=TrackStatus.TRACKING, **more):
    figures = {
        "depth_m": distance_m,
        "sigma_m": 0.02,
        "closing_mps": 0.5,
        "closing_sigma_mps": 0.1,
        "bearing_rad": 0.0,
        "elevation_rad": 0.0,
        "closing_cov_m2ps": 0.0,
        "since_s": 0.0,
    }
    return Track(target=target, status=status, distance_m=distance_m, **{**figures, **more})


def known(*tracks):
    return Known(tracks={each.target: each for each in tracks}, now_s=1.0)


def limits(rules):
    return {each.of: (each.limits, each.owners) for each in crossings_of(rules)}


def test_limits_on_one_figure_stand_together_in_order():
    rules = [
        alarm(DistanceCondition(below_m=3.0)),
        alarm(DistanceCondition(above_m=1.0, below_m=2.0)),
        alarm(DistanceCondition(below_m=1.5, quantity="depth")),
    ]
    assert limits(rules) == {
        DistanceFigure("ball", "distance"): ((1.0, 2.0, 3.0), (1, 1, 0)),
        DistanceFigure("ball", "depth"): ((1.5,), (2,)),
    }


def test_every_part_of_a_condition_and_of_what_suppresses_it_counts():
    condition = AllOf(
        conditions=(
            DistanceCondition(below_m=3.0, target="tag"),
            Not(condition=AnyOf(conditions=(DirectionCondition(above_rad=0.1), ClosingCondition(above_mps=0.5)))),
            SeparationCondition(targets=("ball", "tag"), below_m=1.0),
        )
    )
    rules = [alarm(condition, suppress_when=PresenceCondition(seen=False, target="tag"))]
    assert set(limits(rules)) == {
        DistanceFigure("tag", "distance"),
        DirectionFigure("ball", "bearing"),
        ClosingFigure("ball"),
        SeparationFigure("ball", "tag"),
        PresenceFigure("tag"),
    }


def test_a_time_to_contact_is_concerned_by_the_time_and_by_how_sure_the_speed_is():
    found = limits([alarm(TimeToContactCondition(below_s=2.0, contact_m=0.5))])
    assert found == {
        ContactFigure("ball", 0.5): ((2.0,), (0,)),
        PaceFigure("ball", 0.1, 2.0): ((0.5, 1.5), (0, 0)),
    }


def test_ramps_and_follow_rules_are_concerned_by_the_distance():
    ramp = RampRule(name="ramp", target="ball", start_m=3.0, full_m=1.0)
    table = RampRule(name="table", target="ball", start_m=3.0, full_m=1.0, points=((0.5, 1.0), (1.0, 0.5), (4.0, 0.0)))
    follow = FollowRule(name="follow", target="tag", distance_m=1.0)
    assert limits([ramp, table, follow]) == {
        DistanceFigure("ball", "distance"): ((0.5, 1.0, 1.0, 3.0, 4.0), (1, 0, 1, 0, 1)),
        DistanceFigure("tag", "distance"): ((), ()),
    }


@pytest.mark.parametrize(
    ("condition", "before", "now", "is_concerned"),
    [
        (CountCondition(at_least=2), (1, 0), (1, 1), True),
        (CountCondition(at_least=2), (1, 0), (0, 1), False),
        (CountCondition(at_most=1, targets=("ball",)), (0, 1), (1, 1), False),
        (PresenceCondition(seen=True), (1, 1), (0, 1), True),
        (PresenceCondition(seen=True), (1, 1), (1, 0), False),
    ],
)
def test_who_is_in_sight_is_a_figure_too(condition, before, now, is_concerned):
    (crossings,) = crossings_of([alarm(condition)])
    first, then = (
        known(*(track(name, status=TrackStatus.TRACKING if is_seen else TrackStatus.LOST) for name, is_seen in seen))
        for seen in (zip(("ball", "tag"), sights, strict=True) for sights in (before, now))
    )
    assert crossings.between(crossings.figure(first), crossings.figure(then)) == ((0,) if is_concerned else ())


def test_a_figure_that_comes_or_goes_concerns_all_that_go_by_it():
    (crossings,) = crossings_of([alarm(DistanceCondition(below_m=1.0)), alarm(DistanceCondition(below_m=9.0))])
    seen, lost = crossings.figure(known(track())), crossings.figure(known(track(status=TrackStatus.LOST)))
    assert seen == 2.0
    assert math.isnan(lost)
    assert crossings.between(seen, lost) == crossings.between(lost, seen) == (0, 1)
    assert crossings.between(lost, lost) == ()


def test_figures_are_those_of_the_tracks():
    tracks = track(bearing_rad=0.3, elevation_rad=0.1), track("tag", distance_m=3.0, status=TrackStatus.COASTING)
    seen = known(*tracks)
    assert DirectionFigure("ball", "bearing").of(seen) == 0.3
    assert DirectionFigure("ball", "elevation").of(seen) == 0.1
    assert ClosingFigure("ball").of(seen) == 0.5
    assert ContactFigure("ball", 1.0).of(seen) == 2.0
    assert ContactFigure("ball", 1.0).of(known(track(closing_mps=-0.5))) == math.inf
    assert SeparationFigure("ball", "tag").of(known(track(), track("tag", 3.5))) == pytest.approx(1.5)
    assert CountFigure(()).of(seen) == 2.0
    assert math.isnan(ContactFigure("ball", 1.0).of(known(track(closing_sigma_mps=None))))


def test_many_rules_on_one_figure_take_one_figure():
    rules = [alarm(DistanceCondition(below_m=1.0 + n / 1000)) for n in range(1000)]
    (crossings,) = crossings_of(rules)
    assert crossings.between(1.4995, 1.5015) == (500, 501)
    assert len(crossings.limits) == 1000


targets = st.sampled_from(["ball", "tag"])
sure = {
    "probability_on": st.sampled_from([None, 0.5, 0.8, 0.2]),
    "probability_off": st.sampled_from([0.5, 0.3, 0.9]),
}
near_a_limit = st.sampled_from([0.97, 0.99, 1.0, 1.01, 1.03, 1.05])
simple = st.one_of(
    st.builds(
        DistanceCondition,
        above_m=st.none() | near_a_limit,
        below_m=st.none() | st.just(1.1),
        deadband_sigmas=st.sampled_from([0.0, 3.0]),
        quantity=st.sampled_from(["distance", "depth"]),
        target=targets,
        **sure,
    ),
    st.builds(DirectionCondition, above_rad=st.sampled_from([0.0, 0.1]), target=targets),
    st.builds(ClosingCondition, above_mps=st.sampled_from([0.0, 0.4]), target=targets, **sure),
    st.builds(
        TimeToContactCondition,
        below_s=st.sampled_from([1.0, 2.5]),
        deadband_sigmas=st.sampled_from([0.0, 2.0]),
        closing_min_mps=st.sampled_from([0.0, 0.2]),
        target=targets,
        **sure,
    ),
    st.builds(SeparationCondition, targets=st.just(("ball", "tag")), below_m=st.sampled_from([0.05, 0.5]), **sure),
    st.builds(PresenceCondition, seen=st.booleans(), for_s=st.sampled_from([0.0, 0.7, 2.0]), target=targets),
    st.builds(CountCondition, at_least=st.sampled_from([1, 2]), at_most=st.sampled_from([None, 1])),
    st.just(RuleCondition(rule="other")),
    st.just(ScheduleCondition(from_s=100.0, to_s=200.0)),
)
conditions = st.recursive(
    simple,
    lambda inner: st.one_of(
        st.builds(Not, condition=inner),
        st.builds(AllOf, conditions=st.lists(inner, min_size=1, max_size=3).map(tuple)),
        st.builds(AnyOf, conditions=st.lists(inner, min_size=1, max_size=3).map(tuple)),
    ),
    max_leaves=6,
)
sights = st.none() | st.tuples(
    st.sampled_from([0.4, 2.0]) | near_a_limit,
    st.sampled_from([0.002, 0.03, 0.3]),
    st.sampled_from([-0.5, 0.1, 0.3, 0.5, 1.0]),
    st.sampled_from([0.01, 0.2]),
    st.sampled_from([-0.2, 0.05, 0.2]),
)
moments = st.lists(
    st.tuples(
        sights,
        sights,
        st.sampled_from([0.05, 0.5]),
        st.sampled_from([True, False, None]),
        st.sampled_from([None, 50.0, 150.0]),
        st.integers(1, 3),
    ),
    min_size=1,
    max_size=10,
)


def seen(target, sight, before, now_s):
    """Return a track that goes on from the one before."""
    if sight is None:
        status, figures = TrackStatus.LOST, {}
    else:
        distance_m, sigma_m, closing_mps, closing_sigma_mps, bearing_rad = sight
        status, figures = (
            TrackStatus.TRACKING,
            {
                "distance_m": distance_m,
                "depth_m": distance_m - 0.01,
                "sigma_m": sigma_m,
                "closing_mps": closing_mps,
                "closing_sigma_mps": closing_sigma_mps,
                "bearing_rad": bearing_rad,
                "elevation_rad": 0.0,
            },
        )
    is_same = before is not None and before.is_valid is (sight is not None)
    return Track(target=target, status=status, since_s=before.since_s if is_same else now_s, **figures)


def way(through):
    """Return what is known in each cycle of a way through moments, some of which last for several cycles."""
    now_s, tracks = 0.0, {}
    for ball, tag, step_s, other, second, cycles in through:
        for _ in range(cycles):
            now_s += step_s
            before = tracks
            sighted = {"ball": ball, "tag": tag}
            tracks = {name: seen(name, sight, before.get(name), now_s) for name, sight in sighted.items()}
            wall = None if second is None else WallTime(second_of_day=second, weekday=0)
            yield Known(tracks=tracks, now_s=now_s, wall=wall, active={"other": other}, before=before)


class Watched:
    """An alarm without delays that is judged when it must be, or always."""

    def __init__(self, condition, *, may_rest):
        self.condition, self.may_rest = condition, may_rest
        self.crossings = crossings_of([alarm(condition)])
        self.figures = [NAN] * len(self.crossings)
        self.is_active, self.held, self.is_resting, self.due_s, self.other = False, (), False, math.inf, None
        self.judged = 0

    def see(self, known):
        figures = [each.figure(known) for each in self.crossings]
        pairs = zip(self.crossings, self.figures, figures, strict=True)
        is_concerned = any(each.between(before, now) for each, before, now in pairs)
        is_due = known.now_s >= self.due_s or known.active["other"] is not self.other
        self.figures, self.other = figures, known.active["other"]
        if not self.is_resting or is_concerned or is_due:
            self._judge(known)
        return self.is_active

    def _judge(self, known):
        self.judged += 1
        verdict = judge(self.condition, known, self.held, is_active=self.is_active)
        self.held = verdict.held
        self.is_active = self.is_active if verdict.value is None else verdict.value
        self.is_resting = self.may_rest and rests(self.condition, known, self.held, is_active=self.is_active)
        self.due_s = due_s(self.condition, known)


@settings(max_examples=400, deadline=None)
@given(conditions, moments)
def test_a_condition_that_rests_says_what_it_would_say_if_it_were_judged(condition, through):
    resting, restless = Watched(condition, may_rest=True), Watched(condition, may_rest=False)
    for known_now in way(through):
        assert resting.see(known_now) is restless.see(known_now)


def test_a_condition_far_from_its_limits_is_hardly_ever_judged():
    condition = AllOf(conditions=(DistanceCondition(below_m=1.0, target="ball"), ClosingCondition(target="ball")))
    watched = Watched(condition, may_rest=True)
    for known_now in way([((2.0, 0.02, 0.1, 0.01, 0.0), None, 0.05, None, None, 100)]):
        watched.see(known_now)
    assert watched.judged == 1
