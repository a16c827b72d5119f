"""Whether a condition holds that is made of others: three-valued, and with a memory for each part."""

import itertools

from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Not, judge
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.measurement import Track, TrackStatus
from support.each_case import each_case

VALUES = (True, False, None)
A, B, C = (RuleCondition(rule=name) for name in "abc")


def given_rules(**active):
    return RuleInputs(tracks={}, now_s=0.0, active=active)


def value(condition, inputs):
    return judge(condition, inputs, (), is_active=False).value


def all_of(*conditions):
    return AllOf(conditions=conditions)


def any_of(*conditions):
    return AnyOf(conditions=conditions)


def not_(condition):
    return Not(condition=condition)


@each_case(("a", "b"), list(itertools.product(VALUES, VALUES)))
def test_all_and_any_are_the_least_and_the_greatest_of_false_unknown_true(a, b):
    order = {False: 0, None: 1, True: 2}
    inputs = given_rules(a=a, b=b)
    assert value(all_of(A, B), inputs) is min(a, b, key=order.get)
    assert value(any_of(A, B), inputs) is max(a, b, key=order.get)


TREES = st.recursive(
    st.sampled_from([A, B, C]),
    lambda inner: st.one_of(
        st.builds(not_, inner),
        st.builds(lambda parts: all_of(*parts), st.lists(inner, min_size=1, max_size=3)),
        st.builds(lambda parts: any_of(*parts), st.lists(inner, min_size=1, max_size=3)),
    ),
    max_leaves=12,
)
WORLDS = st.fixed_dictionaries(dict.fromkeys("abc", st.sampled_from(VALUES)))


@given(st.lists(TREES, min_size=1, max_size=4), WORLDS)
def test_de_morgan_holds_with_three_values(trees, world):
    inputs = given_rules(**world)
    opposites = [not_(tree) for tree in trees]
    assert value(not_(all_of(*trees)), inputs) is value(any_of(*opposites), inputs)
    assert value(not_(any_of(*trees)), inputs) is value(all_of(*opposites), inputs)
    assert value(not_(not_(trees[0])), inputs) is value(trees[0], inputs)


@given(TREES, WORLDS, st.fixed_dictionaries(dict.fromkeys("abc", st.booleans())))
def test_learning_what_was_unknown_never_turns_round_what_was_known(tree, world, learned):
    before = value(tree, given_rules(**world))
    after = value(tree, given_rules(**{name: learned[name] if a is None else a for name, a in world.items()}))
    if before is not None:
        assert after is before


def track(target, distance_m, sigma_m=0.02, status=TrackStatus.TRACKING):
    return Track(target=target, status=status, distance_m=distance_m, depth_m=distance_m, sigma_m=sigma_m, since_s=0.0)


def near(target="ball", below_m=1.0):
    return DistanceCondition(below=below_m, probability_on=0.8, deadband_sigmas=3.0, target=target)


def seeing(ball=3.0, tag=3.0, **more):
    tracks = {
        name: track(name, at_m or 1.0, status=TrackStatus.LOST if at_m is None else TrackStatus.TRACKING)
        for name, at_m in (("ball", ball), ("tag", tag))
    }
    return RuleInputs(tracks=tracks, now_s=10.0, **more)


class Alarm:
    """An alarm without delays, which is all that a condition needs to remember."""

    def __init__(self, condition):
        self.condition = condition
        self.is_active = False
        self.held = ()

    def see(self, inputs):
        verdict = judge(self.condition, inputs, self.held, is_active=self.is_active)
        self.held = verdict.held
        self.is_active = self.is_active if verdict.value is None else verdict.value
        return self.is_active


def test_the_part_that_holds_keeps_its_deadband_whichever_it_is():
    alarm = Alarm(any_of(near("ball"), near("tag")))
    assert [alarm.see(seeing(ball=d)) for d in (3.0, 0.9, 1.05, 1.05, 1.2, 1.05)] == [0, 1, 1, 1, 0, 0]


def test_a_part_that_did_not_hold_has_to_begin_though_the_alarm_is_active():
    alarm = Alarm(any_of(near("ball"), near("tag")))
    assert alarm.see(seeing(ball=0.5)) is True
    assert alarm.see(seeing(ball=0.5, tag=1.03)) is True
    assert alarm.held == (True, False)  # the tag is only within the band that keeps, not near
    assert alarm.see(seeing(ball=3.0, tag=1.03)) is False


def test_not_begins_beyond_the_deadband_and_ends_when_the_part_begins():
    away = Alarm(not_(near("ball")))
    assert [away.see(seeing(ball=d)) for d in (0.9, 1.03, 1.05)] == [0, 0, 0]
    assert [away.see(seeing(ball=d)) for d in (1.2, 1.05, 1.03, 0.995)] == [1, 1, 1, 1]
    assert [away.see(seeing(ball=d)) for d in (0.9, 1.03, 1.05, 1.2)] == [0, 0, 0, 1]


def test_a_part_out_of_sight_remembers_what_it_was():
    alarm = Alarm(any_of(near("ball"), near("tag")))
    assert alarm.see(seeing(ball=0.9)) is True
    assert alarm.see(seeing(ball=None)) is True
    assert alarm.held == (True, False)
    assert alarm.see(seeing(ball=1.05)) is True


def test_what_an_alarm_was_before_it_was_restored_counts_as_held():
    verdict = judge(any_of(near()), seeing(ball=1.05), (), is_active=True)
    assert (verdict.value, verdict.held) == (True, (True,))
    verdict = judge(not_(near()), seeing(ball=1.05), (), is_active=True)
    assert (verdict.value, verdict.held) == (True, (False,))


def test_parts_that_are_needless_while_one_decides_may_be_unknown():
    night = ScheduleCondition(from_s=79200.0, to_s=21600.0)
    assert value(all_of(near(), night), seeing(ball=3.0)) is False
    assert value(all_of(near(), night), seeing(ball=0.5)) is None
    assert value(any_of(near(), night), seeing(ball=0.5)) is True


def test_the_reason_names_each_part_and_whether_it_holds():
    condition = all_of(near(), not_(any_of(RuleCondition(rule="mute"), near("tag", 0.5))))
    inputs = seeing(ball=0.9, tag=None, active={"mute": False})
    words = describe_verdict(condition, inputs, (), is_active=False)
    assert words == (
        "all of (ball 0.90 m ± 0.02, below 1.00 m [yes]; "
        "not (any of (the rule mute is not active [no]; tag is lost: no distance [unknown])))"
    )
    why = describe_verdict(condition, inputs, (), is_active=False, with_probability=True)
    assert "below 1.00 m: P 1.00, begins at 0.80 [yes]" in why


figures = st.sampled_from([None, 0.5, 0.97, 0.99, 1.0, 1.03, 1.05, 1.08, 2.0])
sightings = st.builds(
    lambda ball, tag, sigma_m: RuleInputs(
        tracks={
            name: track(name, at_m or 1.0, sigma_m, TrackStatus.LOST if at_m is None else TrackStatus.TRACKING)
            for name, at_m in (("ball", ball), ("tag", tag))
        },
        now_s=10.0,
    ),
    figures,
    figures,
    st.sampled_from([0.005, 0.02, 0.1]),
)
mixed = st.recursive(
    st.builds(
        lambda target, sides, sure, off, sigmas: DistanceCondition(
            above=0.9 if "above" in sides else None,
            below=1.0 if "below" in sides else None,
            probability_on=sure,
            probability_off=off,
            deadband_sigmas=sigmas,
            target=target,
        ),
        st.sampled_from(["ball", "tag"]),
        st.sampled_from(["above", "below", "above and below"]),
        st.sampled_from([None, 0.5, 0.8, 0.2]),
        st.sampled_from([0.5, 0.3, 0.9]),
        st.sampled_from([0.0, 3.0]),
    ),
    lambda inner: st.one_of(
        st.builds(not_, inner),
        st.builds(lambda parts: all_of(*parts), st.lists(inner, min_size=1, max_size=3)),
        st.builds(lambda parts: any_of(*parts), st.lists(inner, min_size=1, max_size=3)),
    ),
    max_leaves=5,
)


@settings(deadline=None)
@given(mixed, st.lists(sightings, max_size=6), sightings)
def test_nothing_that_stands_still_makes_an_alarm_come_and_go(condition, way, still):
    alarm = Alarm(condition)
    for inputs in way:
        alarm.see(inputs)
    settled = [alarm.see(still) for _ in range(6)]
    assert settled[0] is settled[-1]
    assert len(set(settled[1:])) == 1


@settings(deadline=None)
@given(mixed, st.lists(sightings, min_size=1, max_size=8))
def test_what_is_not_known_changes_nothing(condition, way):
    blind = RuleInputs(tracks={name: track(name, 1.0, status=TrackStatus.LOST) for name in ("ball", "tag")}, now_s=10.0)
    alarm, blinded = Alarm(condition), Alarm(condition)
    for inputs in way:
        blinded.see(blind)
        assert alarm.see(inputs) is blinded.see(inputs)
