"""Rules that rest are not judged, and that changes nothing."""

import math

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.discrete import PresenceCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, FollowRule, Lost, LostPolicy, OnDelay, RampRule
from support.observing import Rehearsal
from support.random_runs import with_all_active

near_a_limit = st.floats(0.9, 1.1)  # the limits are here as well, so the probability decides
conditions = st.builds(
    lambda limits, sides, **how: DistanceCondition(
        above_m=min(limits) if "above" in sides else None, below_m=max(limits) if "below" in sides else None, **how
    ),
    st.tuples(st.floats(0.9, 1.1), st.floats(0.9, 1.1) | st.floats(0.5, 3)).filter(
        lambda limits: limits[0] != limits[1]
    ),
    st.sampled_from(["above", "below", "above and below"]),
    quantity=st.sampled_from(["distance", "depth"]),
    deadband_sigmas=st.sampled_from([0.0, 3.0]),
    probability_on=st.sampled_from([None, 0.1, 0.5, 0.8, 0.99]),
    probability_off=st.sampled_from([0.2, 0.5, 0.9]),
) | st.builds(PresenceCondition, seen=st.booleans())
losses = st.builds(
    Lost, grace_s=st.sampled_from([0.0, 0.3]), policy=st.sampled_from(LostPolicy), fault_after_s=st.just(0.6)
)
delays = st.sampled_from([OnDelay(), OnDelay(hold_s=0.3), OnDelay(frames=3, of_frames=5)])
alarms = st.builds(
    AlarmRule,
    name=st.just("alarm"),
    target=st.just("ball"),
    output=st.sampled_from([None, "motor", "base"]),
    condition=conditions,
    on_delay=delays,
    off_delay_s=st.sampled_from([0.0, 0.4]),
    lost=losses,
    at_start=st.sampled_from(["act", "announce"]),
)
ramps = st.builds(
    RampRule,
    name=st.just("ramp"),
    target=st.just("ball"),
    output=st.sampled_from([None, "motor"]),
    start=st.floats(0.5, 1.5),
    full=st.floats(1.6, 3) | st.floats(0.1, 0.4),
    level_min=st.sampled_from([0.0, 0.3]),
    bias=st.sampled_from(["neutral", "cautious", "quiet"]),
)
follows = st.just(FollowRule(name="follow", target="ball", output="base", distance_m=1.0))
plans = st.builds(
    lambda rules, safety: Plan(
        targets=("ball",),
        rules=tuple(replace(rule, name=f"{rule.name}-{number}") for number, rule in enumerate(rules)),
        outputs=(LevelOutput(name="motor"), BaseOutput(name="base")),
        tracking=Tracking(confirm_frames=1, outliers_max=0, coast_s=0.15),
        safety=safety,
    ),
    st.lists(alarms | alarms | alarms | ramps | follows, min_size=1, max_size=6),
    st.just(Safety(good_frames=1)),
)
sights = st.none() | near_a_limit | near_a_limit | st.floats(0.3, 3.5) | st.sampled_from([float("nan"), "wait"])
ways = st.lists(st.tuples(sights, st.sampled_from([0.002, 0.03, 0.3])), min_size=1, max_size=8)


class Compared(Rehearsal):
    """A rehearsal beside which every rule is judged in every cycle, whether it rests or not."""

    def __init__(self, plan, scale_sigma=0.0):
        super().__init__(plan)
        self.judged = initial_state(plan)
        self.scale_sigma = scale_sigma

    def cycle(self, observation):
        seen = tuple(self.unsure(each) for each in observation.measurements)
        observation = replace(observation, measurements=seen)
        decision = super().cycle(observation)
        restless = with_all_active(self.judged)
        self.judged, expected = decide(restless, observation)
        assert decision == expected
        assert dict(decision.reasons) == dict(expected.reasons)
        return decision

    def unsure(self, seen):
        """Return a measurement that may also be wrong by the same share in every frame."""
        if seen.distance_m is None:
            return seen
        return replace(seen, sigma_m=math.hypot(seen.sigma_m, self.scale_sigma * seen.distance_m))


@given(plans, ways, st.sampled_from([0.0, 0.1]))
def test_a_rule_that_rests_does_what_it_would_do_if_it_were_judged(plan, ways, scale_sigma):
    rehearsal = Compared(plan, scale_sigma)
    for way, sigma_m in ways:
        if way == "wait":
            rehearsal.wait(0.5)
        else:
            rehearsal.see(*[way] * 6, sigma_m=sigma_m)
            rehearsal.see(*[None if way is None else way + nearer for nearer in (0.02, 0.04, 0.0)], sigma_m=sigma_m)


def test_a_target_that_creeps_over_the_limit_is_noticed_when_that_is_likely_enough():
    near = AlarmRule(name="near", target="ball", condition=DistanceCondition(below_m=1.0))
    rehearsal = Compared(Plan(targets=("ball",), rules=(near,)))
    rehearsal.see(*[1.1] * 10, *[0.997] * 10, sigma_m=0.03)
    assert rehearsal.events("near") == []
    rehearsal.see(0.98, 0.97, 0.96, 0.95, 0.94, 0.93, sigma_m=0.03)
    assert rehearsal.events("near") == ["raised"]


def test_a_target_between_two_limits_that_is_no_longer_sure_to_be_there_is_noticed():
    between = AlarmRule(name="there", target="ball", condition=DistanceCondition(above_m=0.98, below_m=1.02))
    rehearsal = Compared(
        Plan(targets=("ball",), rules=(replace(between, condition=replace(between.condition, deadband_sigmas=0.0)),))
    )
    rehearsal.see(*[1.0] * 10, sigma_m=0.001)
    rehearsal.see(*[1.0] * 30, sigma_m=0.5)
    assert rehearsal.events("there") == ["raised", "cleared"]


def many_rules():
    rules = tuple(
        AlarmRule(name=f"r{n}", target="ball", condition=DistanceCondition(below_m=0.5 + n / 50)) for n in range(100)
    )
    return Rehearsal(Plan(targets=("ball",), rules=rules))


def test_of_many_rules_only_those_near_the_target_do_not_rest():
    rehearsal = many_rules()
    rehearsal.see(*[1.505] * 100)
    assert len(rehearsal.state.rules.quiescence.active) <= 6


def test_while_the_target_is_out_of_sight_rules_that_are_not_raised_rest():
    rehearsal = many_rules()
    rehearsal.see(*[5.0] * 10, *[None] * 10)
    assert rehearsal.state.rules.quiescence.active == frozenset()


def test_what_did_not_change_is_the_same_object():
    rehearsal = many_rules()
    rehearsal.see(*[1.505] * 100)
    assert rehearsal.decisions[-1][1].rules is rehearsal.decisions[-2][1].rules
