"""The scheduler against its oracle: judging every rule in every cycle gives the same decisions, to the last bit."""

import pytest

from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.conditions.discrete import PresenceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind, Severity
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.core.rules.quiescence import MAX_WOKEN
from support.observing import measured
from support.random_runs import first_difference, random_run, with_settings


def differing(seeds, *, is_aimed):
    return {seed: found[0] for seed in seeds if (found := first_difference(random_run(seed, is_aimed=is_aimed)))}


@pytest.mark.long
def test_quiescent_rules_do_what_they_would_do_if_every_rule_was_judged_in_every_cycle():
    assert differing(range(40), is_aimed=False) == {}


def test_alarms_that_gave_up_and_rules_that_ask_for_them_are_never_quiescent_on_a_stale_verdict():
    assert differing(range(40), is_aimed=True) == {}


@pytest.mark.parametrize(("seed", "is_aimed"), [(1560, False), (341, True)])
def test_a_latched_alarm_that_counts_as_holding_forgets_what_its_parts_did(seed, is_aimed):
    assert differing([seed], is_aimed=is_aimed) == {}


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 200), marks=pytest.mark.long)])
def test_a_quiescent_rule_notices_at_once_that_an_operator_has_set_something_of_it(seeds):
    assert {seed: found for seed in seeds if (found := first_difference(with_settings(random_run(seed), seed)))} == {}


def test_the_operators_of_random_runs_set_and_withdraw_thresholds_of_every_kind():
    kinds, units = set(), set()
    for seed in range(60):
        run = with_settings(random_run(seed), seed)
        state = initial_state(run.plan)
        for observation in run.observations:
            state, decision = decide(state, observation)
            kinds.update(event.kind for event in decision.events)
            records = [step.record for step in state.rules.steps if isinstance(step, AlarmStep)]
            units.update(each.unit for record in records for each in record.thresholds)
    assert {"threshold_set", "threshold_withdrawn", "observed", "acting", "refused"} <= kinds
    assert units >= {"m", "rad", "m/s", "s", "V"}


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_2000_random_runs_are_decided_as_if_every_rule_was_judged_in_every_cycle():
    assert differing(range(2000), is_aimed=False) == {}


@pytest.mark.long
@pytest.mark.timeout(600)
def test_500_runs_aimed_at_policies_and_dependants_are_decided_as_if_every_rule_was_judged():
    assert differing(range(500), is_aimed=True) == {}


def test_the_random_runs_raise_alarms_of_every_kind():
    kinds = set()
    for seed in range(40):
        run = random_run(seed)
        state = initial_state(run.plan)
        for observation in run.observations:
            state, decision = decide(state, observation)
            kinds.update(event.kind.value for event in decision.events)
    assert {"raised", "cleared", "realarmed", "suppressed", "shelved", "measurement_lost", "target_lost"} <= kinds


def test_a_thousand_alarms_that_are_due_at_once_are_raised_in_turn_and_those_for_safety_first():
    lost = PresenceCondition(seen=False, for_s=1.0)
    severities = [Severity.SAFETY if number % 500 == 499 else Severity.ALARM for number in range(1000)]
    rules = tuple(
        AlarmRule(name=f"rule-{number}", target="ball", severity=severity, condition=lost)
        for number, severity in enumerate(severities)
    )
    state, raised = initial_state(Plan(targets=("ball",), rules=rules)), []
    for cycle in range(120):
        at_s = cycle / 30
        seen = (measured("ball", at_s, 1.0),) if cycle < 30 else ()
        stamp = FrameStamp(sequence=cycle, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=stamp, measurements=seen))
        if names := [event.source for event in decision.events if event.kind is EventKind.RAISED]:
            raised.append(names)
    assert {"rule-499", "rule-999"} <= set(raised[0])
    assert [len(names) for names in raised] == [MAX_WOKEN] * (1000 // MAX_WOKEN) + [1000 % MAX_WOKEN]
    assert len({name for names in raised for name in names}) == 1000
