"""Runs that have every kind of rule and condition at once: decided, kept and restored as they must be."""

from collections import defaultdict
from itertools import islice

import pytest
from msgspec.structs import replace

from stadimeter.app.exact_json import decode, encode
from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.alarms.alarm import GatedStep
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_rules import RuleCondition, SequenceCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.persistence import AlarmSnapshot, find_absences, restore_alarms, snapshot_alarms
from stadimeter.core.rule import AlarmRule, conditions_of
from support.random_runs import first_difference
from support.whole_runs import whole_run


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 500), marks=pytest.mark.long)])
def test_with_all_kinds_at_once_the_two_ways_of_an_alarm_decide_alike(seeds):
    assert {seed: found for seed in seeds if (found := first_difference(whole_run(seed)))} == {}


def kind_of(leaf):
    """Return what a simple condition is, as finely as it matters here."""
    match leaf:
        case FigureCondition():
            return f"{'difference in ' if leaf.is_comparison else ''}{leaf.quantity}"
        case RememberedCondition():
            return f"sum in {leaf.unit}" if leaf.rules else "figure"
        case ScheduleCondition():
            return f"schedule by {'sun' if leaf.is_by_sun else 'dates' if leaf.dates else 'clock'}"
        case _:
            return type(leaf).__name__


@pytest.mark.long
def test_the_runs_have_every_kind_true_false_and_where_it_can_be_unknown():
    answers, gates, events, sent = defaultdict(set), set(), set(), set()
    for seed in range(80):
        run = whole_run(seed)
        state = initial_state(run.plan)
        for observation in run.observations:
            state, decision = decide(state, observation)
            inputs = decision.reasons.inputs_of_rules()
            for rule in state.rules.rules:
                for leaf in (leaf for condition in conditions_of(rule) for leaf in leaves(condition)):
                    answers[kind_of(leaf)].add(leaf.holds(inputs, False))
            steps = zip(run.plan.rules, state.rules.steps, strict=True)
            gates |= {(type(rule).__name__, step.is_open) for rule, step in steps if isinstance(step, GatedStep)}
            events |= {event.kind.value for event in decision.events}
            sent |= {notice.event.kind.value for notice in decision.notices}
    never_unknown = {"PresenceCondition", "UndeliveredCondition"}
    wanted = {kind: {True, False} if kind in never_unknown else {True, False, None} for kind in answers}
    assert dict(answers) == wanted
    assert set(QUANTITIES) <= {*answers, "distance", "depth"}
    assert {"figure", "sum in times", "sum in s", "schedule by sun", "schedule by dates", "schedule by clock"} <= {
        *answers
    }
    assert {each.__name__ for each in (CountCondition, RuleCondition, SequenceCondition)} <= {*answers}
    kinds = ("RampRule", "FollowRule", "ReportRule")
    assert gates == {(kind, answer) for kind in kinds for answer in (True, False, None)}
    assert {"raised", "cleared", "shelved", "unshelved", "suppressed", "reset", "threshold_set", "observed"} <= events
    assert {"report", "raised", "cleared"} <= sent


RESTARTS = [range(15), pytest.param(range(15, 300), marks=pytest.mark.long)]


def until(run, cycle):
    """Return the state of a run after some cycles."""
    state = initial_state(run.plan)
    for observation in islice(run.observations, cycle):
        state, _ = decide(state, observation)
    return state


def cut_of(seed):
    """Return after how many cycles a run is interrupted: each phase has its turn."""
    return 5 + 37 * seed % 90


@pytest.mark.parametrize("seeds", RESTARTS)
def test_a_run_that_goes_on_from_its_state_as_text_decides_as_if_it_had_not_been_interrupted(seeds):
    for seed in seeds:
        run, cut = whole_run(seed), cut_of(seed)
        state = until(run, cut)
        restored = read_state(state_text(state), initial_state(run.plan))
        for observation in run.observations[cut:]:
            state, expected = decide(state, observation)
            restored, decision = decide(restored, observation)
            assert decision == expected, seed
            assert dict(decision.reasons) == dict(expected.reasons), seed


def facts(state):
    """Return what a run remembers beyond its end, apart from delays that run and how it is to go on."""
    rows = (replace(row, record=replace(row.record, timers=None, resumed=None)) for row in snapshot_alarms(state))
    kept = [replace(row, is_first_out=False, summary=row.summary and row.summary.slots) for row in rows]
    return kept, dict(state.rules.raised_at_s), dict(state.rules.first_out)


@pytest.mark.parametrize("seeds", RESTARTS)
def test_nothing_that_alarms_windows_sequences_and_messages_remember_is_lost_by_a_restart(seeds):
    about_inhibits = {"suppressed", "unsuppressed", "shelved", "unshelved", "calmed"}
    for seed in seeds:
        run, cut = whole_run(seed), cut_of(seed)
        state = until(run, cut)
        stored = decode(encode(snapshot_alarms(state)), tuple[AlarmSnapshot, ...])
        begun = restore_alarms(
            initial_state(run.plan), stored, find_absences(state), shift_s=0.0, from_s=state.now_s, now_s=state.now_s
        )
        # A ramp begins to act anew, as after any time out of sight; that is not what is compared here.
        gated = {rule.name for rule in run.plan.rules if not isinstance(rule, AlarmRule)}
        active = {**begun.rules.active, **{name: it for name, it in state.rules.active.items() if name in gated}}
        restored = replace(state, rules=replace(begun.rules, active=active), figures=begun.figures)
        assert facts(restored) == facts(state), seed
        if any(each.began_s is not None and state.now_s >= each.began_s + DAY_S for each in state.figures):
            continue  # clocks were put back: it may be another day, and that is not known before the next cycle
        # In the cycle after, nothing acts, or is told, only since it was not known yet what is remembered.
        (_, expected), (_, decision) = (decide(each, run.observations[cut]) for each in (state, restored))
        assert decision.figures == expected.figures, seed
        told = [
            [(each.source, each.kind) for each in one.events if each.kind.value in about_inhibits]
            for one in (decision, expected)
        ]
        assert told[0] == told[1], seed
        reports = [[each for each in one.notices if each.event.kind.value == "report"] for one in (decision, expected)]
        assert reports[0] == reports[1], seed
