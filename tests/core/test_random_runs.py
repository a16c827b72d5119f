"""Random rules over random tracks: what moves is justified and within limits, and nothing is lost by a restart."""

import math
import random
from collections import defaultdict
from functools import cache
from itertools import islice

import pytest
from msgspec.structs import replace

from stadimeter.app.exact_json import decode, encode
from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.alarms.alarm import GatedStep
from stadimeter.core.clock import DAY_S
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_rules import RuleCondition, SequenceCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp, OutputFault
from stadimeter.core.outputs import safe_command
from stadimeter.core.persistence import AlarmSnapshot, find_absences, restore_alarms, snapshot_alarms
from stadimeter.core.rule import AlarmRule, FollowRule, conditions_of
from support.random_runs import OUTPUTS, first_difference, random_run, whole_run, with_settings

# Random rules over random tracks: whatever is configured and seen, what moves is justified and within limits.

RUNS = 40


def spoiled(observations, rng):
    """Yield observations of which every eighth or so has something wrong: figures, stamps, or outputs."""
    last = None
    for each in observations:
        yield (one := broken(each, last, rng))
        last = one.frame or last


def broken(each, last, rng):
    match rng.choice(("figure", "frozen", "future", "no time", "fault", *["nothing"] * 35)):
        case "figure":
            distance_m = rng.choice((math.nan, math.inf, -1.0, 0.0))
            return replace(each, measurements=tuple(replace(it, distance_m=distance_m) for it in each.measurements))
        case "frozen":
            return replace(each, frame=last)
        case "future" | "no time" as when:
            at_s = math.nan if when == "no time" else each.now_s + 100.0
            return replace(each, frame=FrameStamp(sequence=10**6, captured_at_s=at_s))
        case "fault":
            return replace(each, output_faults=(OutputFault(output=rng.choice(OUTPUTS).name, reason="unplugged"),))
        case _:
            return each


@cache
def cycles(seed):
    """Return the plan of a run and its cycles: the decision before, the observation, the state and the decision."""
    run = with_settings(random_run(seed), seed)
    state, before, found = initial_state(run.plan), None, []
    for observation in spoiled(run.observations, random.Random(seed)):  # noqa: S311 - the same run each time
        state, decision = decide(state, observation)
        found.append((before, observation, state, decision))
        before = decision
    return run.plan, found


@pytest.fixture(params=range(RUNS), ids="seed {}".format)
def run(request):
    return cycles(request.param)


def test_nothing_moves_on_stale_or_unknown_data_or_on_no_number(run):
    plan, cycles = run
    for _, observation, state, decision in cycles:
        newest_s = state.safety.frame.captured_at_s if state.safety.frame else -math.inf
        tracks = {track.target: track for track in decision.tracks}
        for command, output, trace in zip(decision.commands, OUTPUTS, decision.outputs, strict=True):
            is_safe = command == safe_command(output)
            if decision.safety is not SafetyMode.ACTIVE or trace.winner == "safety":
                assert is_safe
            if is_safe:
                continue
            assert command.captured_at_s == newest_s
            assert -0.05 <= observation.now_s - newest_s <= plan.safety.max_frame_age_s + 1e-6
            for name in trace.winner.split("+") if trace.winner != "safe" else ():
                justified(plan, state, tracks, name, command)


def justified(plan, state, tracks, name, command):
    """The rule that wins may: it is active, and if it goes by a distance, its target is in sight."""
    rule, step = next(pair for pair in zip(plan.rules, state.rules.steps, strict=True) if pair[0].name == name)
    assert not rule.observe
    if isinstance(rule, AlarmRule):
        assert not step.trace.inhibits
        assert not step.record.has_let_go, "a latched alarm stands until it is reset, whatever is seen; another lets go"
        is_moving = isinstance(command, TwistCommand) and (command.linear_mps, command.angular_radps) != (0.0, 0.0)
        assert not is_moving
    elif isinstance(rule, FollowRule) and not tracks[rule.target].is_valid:
        assert rule.search is not None
        assert tracks[rule.target].status is TrackStatus.LOST
        assert command.linear_mps == 0.0, "a base that searches turns in place"
    else:
        assert tracks[rule.target].is_valid
        assert math.isfinite(tracks[rule.target].distance_m)


def test_each_output_gets_one_command_from_at_most_one_winner_of_the_highest_priority(run):
    plan, cycles = run
    priorities = {rule.name: rule.priority for rule in plan.rules}
    for _, _, state, decision in cycles:
        assert [command.output for command in decision.commands] == [output.name for output in OUTPUTS]
        for trace in decision.outputs:
            names = trace.winner.split("+")
            assert not set(names) & set(trace.losers)
            if names[0] in priorities:
                highest = max(request.priority for request in state.rules.wanted[trace.output])
                assert all(priorities[name] == highest for name in names)


def test_every_command_is_within_its_limits_and_its_slew(run):
    motor, _, base = OUTPUTS
    at_s = 0.0
    for before, observation, _, decision in run[1]:
        level, _, twist = decision.commands
        step_s, at_s = observation.now_s - at_s, observation.now_s
        assert isinstance(level, LevelCommand)
        assert abs(twist.linear_mps) <= base.linear_max_mps
        assert abs(twist.angular_radps) <= base.angular_max_radps
        if before is None:
            continue
        assert level.level - before.commands[0].level <= motor.rise_per_s * step_s + 1e-9
        if decision.outputs[0].winner != "safety":
            assert before.commands[0].level - level.level <= motor.fall_per_s * step_s + 1e-9
        assert abs(twist.linear_mps) - abs(before.commands[2].linear_mps) <= base.linear_accel_mps2 * step_s + 1e-9
        turned = abs(twist.angular_radps) - abs(before.commands[2].angular_radps)
        assert turned <= base.angular_accel_radps2 * step_s + 1e-9


def test_people_are_told_no_more_often_than_the_cooldown_allows_and_never_by_a_quiet_rule(run):
    plan, cycles = run
    alarms = {rule.name: rule for rule in plan.rules if isinstance(rule, AlarmRule)}
    told_s: dict[str, float] = {}
    for _, observation, _, decision in cycles:
        inhibits = {trace.rule: trace.inhibits for trace in decision.rules}
        for event in decision.events:
            rule = alarms.get(event.source)
            if rule is None or not event.notify or event.kind.value not in {"raised", "realarmed"}:
                continue
            assert not rule.observe
            waited_s = observation.now_s - told_s.get(rule.name, -math.inf)
            assert waited_s >= min(rule.cooldown_s, rule.realarm_s or math.inf) - 1e-6
            told_s[rule.name] = observation.now_s
        assert all(not inhibits[notice.rule] for notice in decision.notices)


def test_whether_an_alarm_is_active_is_what_its_events_say(run):
    plan, cycles = run
    active = {rule.name: False for rule in plan.rules if isinstance(rule, AlarmRule)}
    for _, _, state, decision in cycles:
        for event in decision.events:
            if event.source in active and event.kind.value in {"raised", "cleared"}:
                assert active[event.source] is (event.kind.value == "cleared")
                active[event.source] = event.kind.value == "raised"
        for rule, step in zip(plan.rules, state.rules.steps, strict=True):
            if rule.name in active:
                assert step.record.is_active is active[rule.name]


def test_the_runs_raise_alarms_of_every_kind_and_move_thresholds_of_every_unit():
    events = [event for seed in range(RUNS) for *_, decision in cycles(seed)[1] for event in decision.events]
    kinds = {"raised", "cleared", "realarmed", "suppressed", "shelved", "measurement_lost", "target_lost", "fault"}
    kinds |= {"threshold_set", "threshold_withdrawn", "observed", "acting", "refused"}
    assert kinds <= {event.kind.value for event in events}
    states = [state for seed in range(RUNS) for _, _, state, _ in cycles(seed)[1]]
    alarms = [step.record for state in states for step in state.rules.steps if hasattr(step, "record")]
    units = {each.unit for record in alarms if hasattr(record, "thresholds") for each in record.thresholds}
    assert units >= {"m", "rad", "m/s", "s", "V"}


SEEDS = [(*range(15), 253), pytest.param(range(15, 300), marks=pytest.mark.long)]


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("is_aimed", [False, True])
def test_an_alarm_that_stays_as_it_is_decides_in_two_ways_alike(seeds, is_aimed):
    runs = {seed: with_settings(random_run(seed, is_aimed=is_aimed), seed) for seed in seeds}
    assert {seed: found[0] for seed, run in runs.items() if (found := first_difference(run))} == {}


# Runs that have every kind of rule and condition at once: decided, kept and restored as they must be.


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
