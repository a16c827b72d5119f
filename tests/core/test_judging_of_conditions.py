"""Alarms on conditions of every kind rest as long as nothing concerns them, and that changes nothing."""

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.plan import LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, Lost, LostPolicy, OnDelay
from support.conditions import closing, direction, separation
from support.observing import Rehearsal, measured, missed
from support.random_runs import with_all_active

targets = st.sampled_from(["ball", "tag"])
sure = {"probability_on": st.sampled_from([None, 0.5, 0.8]), "probability_off": st.sampled_from([0.5, 0.3])}
alone = st.one_of(
    st.builds(
        DistanceCondition,
        above_m=st.sampled_from([None, 0.95, 1.0]),
        below_m=st.sampled_from([None, 1.05, 1.3]),
        deadband_sigmas=st.sampled_from([0.0, 3.0]),
        target=targets,
        **sure,
    ),
    st.builds(direction, above=st.sampled_from([0.0, 0.1]), target=targets),
    st.builds(closing, above=st.sampled_from([0.0, 0.4]), target=targets, **sure),
    st.builds(
        TimeToContactCondition,
        below_s=st.sampled_from([1.0, 2.5]),
        closing_min_mps=st.sampled_from([0.0, 0.2]),
        target=targets,
        **sure,
    ),
    st.builds(separation, targets=st.just(("ball", "tag")), below=st.sampled_from([0.1, 0.5]), **sure),
    st.builds(PresenceCondition, seen=st.booleans(), for_s=st.sampled_from([0.0, 0.7]), target=targets),
    st.builds(CountCondition, at_least=st.sampled_from([1, 2])),
    st.just(ScheduleCondition(from_s=100.0, to_s=200.0)),
)


def made_of(simple):
    """Return conditions made of simple ones."""
    return st.recursive(
        simple,
        lambda inner: st.one_of(
            st.builds(Not, condition=inner),
            st.builds(AllOf, conditions=st.lists(inner, min_size=1, max_size=3).map(tuple)),
            st.builds(AnyOf, conditions=st.lists(inner, min_size=1, max_size=3).map(tuple)),
        ),
        max_leaves=4,
    )


def alarms(conditions, suppressed):
    """Return alarms on conditions."""
    return st.builds(
        AlarmRule,
        name=st.just("alarm"),
        target=targets,
        output=st.sampled_from([None, "motor"]),
        condition=conditions,
        on_delay=st.sampled_from([OnDelay(), OnDelay(hold_s=0.3), OnDelay(frames=2, of_frames=3)]),
        off_delay_s=st.sampled_from([0.0, 0.4]),
        latch=st.sampled_from([False, False, True]),
        lost=st.builds(
            Lost, grace_s=st.sampled_from([0.0, 0.3]), policy=st.sampled_from(LostPolicy), fault_after_s=st.just(0.6)
        ),
        suppress_when=suppressed,
    )


first = alarms(made_of(alone), st.none())
asking = made_of(st.one_of(alone, alone, alone, st.just(RuleCondition(rule="alarm-0"))))
later = alarms(asking, st.none() | asking)
plans = st.builds(
    lambda one, others: Plan(
        targets=("ball", "tag"),
        rules=tuple(
            replace(rule, name=f"alarm-{number}", priority=number) for number, rule in enumerate([one, *others])
        ),
        outputs=(LevelOutput(name="motor"),),
        tracking=Tracking(confirm_frames=1, outliers_max=0, coast_s=0.15),
        safety=Safety(good_frames=1),
    ),
    first,
    st.lists(later, max_size=3),
)
sights = st.sampled_from([None, 0.5, 0.97, 1.0, 1.02, 1.1, 1.5, 3.0])
moments = st.lists(
    st.tuples(
        sights,
        sights,
        st.sampled_from([0.002, 0.03, 0.3]),
        st.sampled_from([0.0, 0.05, 0.2]),
        st.sampled_from([None, 50.0, 150.0]),
        st.booleans(),
        st.integers(1, 6),
    ),
    min_size=1,
    max_size=8,
)


class Compared(Rehearsal):
    """A rehearsal beside which every rule is judged in every cycle, whether it rests or not."""

    def __init__(self, plan):
        super().__init__(plan)
        self.judged = initial_state(plan)

    def cycle(self, observation):
        decision = super().cycle(observation)
        restless = with_all_active(self.judged)
        self.judged, expected = decide(restless, observation)
        assert decision == expected
        assert dict(decision.reasons) == dict(expected.reasons)
        return decision

    def go_through(self, *moment):
        """Give some cycles in a row in which nothing moves."""
        ball_m, tag_m, sigma_m, bearing_rad, second, has_frame, cycles = moment
        wall = None if second is None else WallTime(second_of_day=second, weekday=0)
        for _ in range(cycles):
            self.now_s = round(self.now_s + 0.1, 9)
            seen = [("ball", ball_m, bearing_rad), ("tag", tag_m, -bearing_rad)] if has_frame else []
            self.cycle(
                Observation(
                    now_s=self.now_s,
                    frame=FrameStamp(sequence=len(self.decisions), captured_at_s=self.now_s) if has_frame else None,
                    measurements=tuple(
                        missed(target, self.now_s) if m is None else measured(target, self.now_s, m, sigma_m, bearing)
                        for target, m, bearing in seen
                    ),
                    wall=wall,
                )
            )


@given(plans, moments)
def test_an_alarm_that_rests_does_what_it_would_do_if_it_were_judged(plan, through):
    rehearsal = Compared(plan)
    for moment in through:
        rehearsal.go_through(*moment)


def test_a_band_that_a_target_skips_raises_an_alarm_that_does_not_wait():
    band = AlarmRule(
        name="band",
        target="ball",
        condition=DistanceCondition(above_m=0.9, below_m=1.0),
        off_delay_s=0.0,
    )
    plan = Plan(targets=("ball", "tag"), rules=(band,), tracking=Tracking(confirm_frames=1, outliers_max=0))
    rehearsal = Compared(plan)
    rehearsal.go_through(3.0, None, 0.002, 0.0, None, True, 5)
    rehearsal.go_through(0.4, None, 0.002, 0.0, None, True, 5)
    assert rehearsal.events("band") == ["raised", "cleared"]


def test_seen_for_a_time_is_noticed_though_nothing_happens():
    long_seen = AlarmRule(
        name="long", target="ball", condition=PresenceCondition(seen=True, for_s=1.0), off_delay_s=0.0
    )
    rehearsal = Compared(Plan(targets=("ball", "tag"), rules=(long_seen,)))
    rehearsal.go_through(3.0, None, 0.002, 0.0, None, True, 30)
    assert rehearsal.events("long") == ["raised"]
