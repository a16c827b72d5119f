"""Random rules over random tracks: whatever is configured and seen, what moves is justified and within limits."""

import math

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import SafetyMode, Severity
from stadimeter.core.observation import FrameStamp, Observation, OutputFault, WallTime
from stadimeter.core.operator import OperatorCommand
from stadimeter.core.outputs import safe_command
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import (
    AlarmRule,
    EscalationStep,
    FollowRule,
    Lost,
    LostPolicy,
    OnDelay,
    Pattern,
    RampRule,
    Send,
    Template,
)
from stadimeter.core.track import TrackStatus
from stadimeter.operator_actions import OperatorAction
from support.conditions import closing, direction, separation
from support.observing import measured, missed
from support.random_runs import with_all_active

TARGETS = ("ball", "tag")
FRAME_S = 0.1
MAX_AGE_S = 0.25

target = st.sampled_from(TARGETS)
metres = st.floats(0.3, 3.0)
some = st.sampled_from
chances = {
    "probability_on": some([None, 0.1, 0.5, 0.8, 0.99]),
    "probability_off": some([0.2, 0.5, 0.9]),
    "deadband_sigmas": some([0.0, 3.0]),
}
leaf = st.one_of(
    st.builds(DistanceCondition, below_m=metres, target=target, quantity=some(["distance", "depth"]), **chances),
    st.builds(DistanceCondition, above_m=metres, target=target, **chances),
    st.builds(lambda a, b: DistanceCondition(above_m=min(a, b), below_m=max(a, b) + 0.01), metres, metres),
    st.builds(direction, quantity=some(["bearing", "elevation"]), above=st.floats(-0.3, 0.3), target=target),
    st.builds(closing, above=st.floats(-1, 1), target=target, **chances),
    st.builds(TimeToContactCondition, below_s=st.floats(0.2, 5), contact_m=some([0.0, 0.3]), target=target, **chances),
    st.builds(separation, targets=st.just(TARGETS), below=metres, **chances),
    st.builds(PresenceCondition, seen=st.booleans(), for_s=some([0.0, 0.5]), target=target),
    st.builds(CountCondition, at_least=some([1, 2])),
    st.builds(ScheduleCondition, from_s=some([0.0, 43200.0]), to_s=some([43200.5, 80000.0])),
)
condition = st.recursive(
    leaf,
    lambda part: st.one_of(
        st.builds(AllOf, conditions=st.lists(part, min_size=1, max_size=3).map(tuple)),
        st.builds(AnyOf, conditions=st.lists(part, min_size=1, max_size=3).map(tuple)),
        st.builds(Not, condition=part),
    ),
    max_leaves=4,
)
pattern = some([None, None, Pattern(steps=((1.0, 0.2), (0.0, 0.1))), Pattern(steps=((0.5, 0.1), (0.2, 0.3)), times=2)])
send = Send(template=Template(text="{rule}"), topic="alert")
step = st.builds(
    EscalationStep,
    on=some(["raised", "cleared"]),
    after_s=some([0.0, 0.3, 1.0]),
    only_unacknowledged=st.booleans(),
    output=some([None, "motor", "lamp", "base"]),
    level=some([0.2, 0.9]),
    pattern=pattern,
    for_s=some([0.4, math.inf]),
    send=some([None, send]),
)
common = {
    "target": target,
    "priority": st.integers(0, 5),
    "observe": some([False, False, False, True]),
    "lost": st.builds(
        Lost, grace_s=some([0.0, 0.3]), policy=st.sampled_from(LostPolicy), fault_after_s=some([0.3, 0.8])
    ),
}
alarm = st.builds(
    AlarmRule,
    name=st.just("alarm"),
    output=some([None, "motor", "lamp", "base"]),
    severity=some([Severity.WARNING, Severity.SAFETY]),
    condition=condition,
    on_delay=some([OnDelay(), OnDelay(hold_s=0.3), OnDelay(frames=3, of_frames=5)]),
    off_delay_s=some([0.0, 0.4]),
    at_start=st.sampled_from(["act", "announce"]),
    pattern=pattern,
    latch=st.booleans(),
    ack=st.sampled_from(["required", "none"]),
    realarm_s=some([None, 0.7]),
    cooldown_s=some([0.0, 1.0]),
    group=some(["", "door"]),
    suppress_when=st.none() | condition,
    escalation=st.lists(step, max_size=3).map(tuple),
    **common,
)
ramp = st.builds(
    RampRule,
    name=st.just("ramp"),
    output=some(["motor", "lamp"]),
    start=st.floats(0.5, 1.5),
    full=st.floats(1.6, 3) | st.floats(0.1, 0.4),
    level_min=some([0.0, 0.3]),
    bias=some(["neutral", "cautious", "quiet"]),
    **common,
)
follow = st.builds(
    FollowRule,
    name=st.just("follow"),
    output=st.just("base"),
    distance_m=metres,
    reverse_max_mps=some([0.0, 5.0]),
    **common,
)
OUTPUTS = (
    LevelOutput(name="motor", rise_per_s=2.0, fall_per_s=4.0),
    LevelOutput(name="lamp", safe_level=0.3, combine="max"),
    BaseOutput(name="base", combine="most_restrictive"),
)


def plan_of(rules, asks):
    """Name the rules, and let some ask for the one before them."""
    named = []
    for number, rule in enumerate(rules):
        named_rule = replace(rule, name=f"{rule.name}-{number}")
        if asks and number and isinstance(named_rule, AlarmRule):
            named_rule = replace(named_rule, suppress_when=RuleCondition(rule=named[-1].name))
        named.append(named_rule)
    return Plan(
        targets=TARGETS,
        rules=tuple(reversed(named)),
        outputs=OUTPUTS,
        tracking=Tracking(confirm_frames=1, outliers_max=0, coast_s=0.15),
        safety=Safety(max_frame_age_s=MAX_AGE_S, good_frames=2),
    )


plans = st.builds(plan_of, st.lists(alarm | alarm | ramp | follow, min_size=1, max_size=6), st.booleans())
sight = st.none() | st.floats(0.3, 3.5) | st.sampled_from([math.nan, math.inf, 1.0])
command = st.builds(
    OperatorCommand,
    id=st.just("1"),
    action=st.sampled_from(OperatorAction) | some([OperatorAction.SET_THRESHOLD, OperatorAction.WITHDRAW_THRESHOLD]),
    rule=some(["", "alarm-0", "alarm-1", "nobody"]),
    for_s=some([None, 0.5, math.nan]),
    one_shot=st.booleans(),
    key=some(["", "", "below", "above", "between.near", "between.far", "any.0.below", "lost_for", "nothing"]),
    value=st.floats(0.3, 3.5) | some([None, math.nan, math.inf, -1.0]),
    unit=some(["", "", "m", "s", "furlong"]),
)
scene = st.fixed_dictionaries(
    {
        "frames": st.integers(1, 12),
        "distances": st.tuples(sight, sight),
        "closing": some([0.0, 1.0, -1.0]),
        "bearing": st.floats(-0.5, 0.5),
        "sigma_m": some([0.002, 0.03, 0.3]),
        "noise_share": some([1.0, 1.0, 0.1]),
        "camera": some(["good", "good", "good", "frozen", "gone", "from the future"]),
        "told": st.none() | command,
        "wall": some([None, WallTime(second_of_day=100.0, weekday=2)]),
        "fault": some([(), (), (OutputFault(output="motor", reason="unplugged"),)]),
    }
)
scenes = st.lists(scene, min_size=1, max_size=6)


def observations(scenes):
    """Yield what is seen of the scenes, a cycle after the other."""
    now_s, frame = 0.0, FrameStamp(sequence=0, captured_at_s=-1.0)
    for scene in scenes:
        for number in range(scene["frames"]):
            now_s = round(now_s + FRAME_S, 6)
            if scene["camera"] == "good":
                frame = FrameStamp(sequence=frame.sequence + 1, captured_at_s=now_s)
            elif scene["camera"] == "from the future":
                frame = FrameStamp(sequence=frame.sequence + 1, captured_at_s=now_s + 100)
            is_told = scene["told"] is not None and number == 0
            yield Observation(
                now_s=now_s,
                frame=None if scene["camera"] == "gone" else frame,
                measurements=tuple(
                    look(name, distance_m, scene, frame.captured_at_s, number)
                    for name, distance_m in zip(TARGETS, scene["distances"], strict=True)
                ),
                output_faults=scene["fault"],
                wall=scene["wall"],
                operator_commands=(scene["told"],) if is_told else (),
            )


def look(name, distance_m, scene, at_s, number):
    if distance_m is None:
        return missed(name, at_s)
    distance_m = distance_m - scene["closing"] * FRAME_S * number
    seen = measured(name, at_s, distance_m, scene["sigma_m"], scene["bearing"])
    return replace(seen, noise_m=scene["noise_share"] * scene["sigma_m"])


def run(plan, scenes):
    """Yield each cycle: the decision before, the observation, the state and the decision."""
    state, before = initial_state(plan), None
    for observation in observations(scenes):
        state, decision = decide(state, observation)
        yield before, observation, state, decision
        before = decision


fast = settings(suppress_health_check=[HealthCheck.too_slow])


@fast
@given(plans, scenes)
def test_nothing_moves_on_stale_or_unknown_data_or_on_no_number(plan, scenes):
    for _, observation, state, decision in run(plan, scenes):
        newest_s = state.safety.frame.captured_at_s if state.safety.frame else -math.inf
        tracks = {track.target: track for track in decision.tracks}
        for command, output, trace in zip(decision.commands, OUTPUTS, decision.outputs, strict=True):
            is_safe = command == safe_command(output)
            if decision.safety is not SafetyMode.ACTIVE or trace.winner == "safety":
                assert is_safe
            if is_safe:
                continue
            assert command.captured_at_s == newest_s
            assert -0.05 <= observation.now_s - newest_s <= MAX_AGE_S + 1e-6
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


@fast
@given(plans, scenes)
def test_each_output_gets_one_command_from_at_most_one_winner_of_the_highest_priority(plan, scenes):
    priorities = {rule.name: rule.priority for rule in plan.rules}
    for _, _, state, decision in run(plan, scenes):
        assert [command.output for command in decision.commands] == [output.name for output in OUTPUTS]
        for trace, output in zip(decision.outputs, state.outputs, strict=True):
            names = trace.winner.split("+")
            assert not set(names) & set(trace.losers)
            if names[0] in priorities:
                highest = max(request.priority for request in output.wanted)
                assert all(priorities[name] == highest for name in names)


@fast
@given(plans, scenes)
def test_every_command_is_within_its_limits_and_its_slew(plan, scenes):
    motor, _, base = OUTPUTS
    for before, _, _, decision in run(plan, scenes):
        level, _, twist = decision.commands
        assert isinstance(level, LevelCommand)
        assert abs(twist.linear_mps) <= base.linear_max_mps
        assert abs(twist.angular_radps) <= base.angular_max_radps
        if before is None:
            continue
        assert level.level - before.commands[0].level <= motor.rise_per_s * FRAME_S + 1e-9
        if decision.outputs[0].winner != "safety":
            assert before.commands[0].level - level.level <= motor.fall_per_s * FRAME_S + 1e-9
        assert abs(twist.linear_mps) - abs(before.commands[2].linear_mps) <= base.linear_accel_mps2 * FRAME_S + 1e-9
        turned = abs(twist.angular_radps) - abs(before.commands[2].angular_radps)
        assert turned <= base.angular_accel_radps2 * FRAME_S + 1e-9


@fast
@given(plans, scenes)
def test_a_rule_that_rests_does_what_it_would_do_if_it_were_judged(plan, scenes):
    state = judged = initial_state(plan)
    for observation in observations(scenes):
        state, decision = decide(state, observation)
        restless = with_all_active(judged)
        judged, expected = decide(restless, observation)
        assert decision == expected
        assert dict(decision.reasons) == dict(expected.reasons)


@fast
@given(plans, scenes)
def test_people_are_told_no_more_often_than_the_cooldown_allows_and_never_by_a_quiet_rule(plan, scenes):
    alarms = {rule.name: rule for rule in plan.rules if isinstance(rule, AlarmRule)}
    told_s: dict[str, float] = {}
    for _, observation, _, decision in run(plan, scenes):
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


@fast
@given(plans, scenes)
def test_whether_an_alarm_is_active_is_what_its_events_say(plan, scenes):
    active = {rule.name: False for rule in plan.rules if isinstance(rule, AlarmRule)}
    for _, _, state, decision in run(plan, scenes):
        for event in decision.events:
            if event.source in active and event.kind.value in {"raised", "cleared"}:
                assert active[event.source] is (event.kind.value == "cleared")
                active[event.source] = event.kind.value == "raised"
        for rule, step in zip(plan.rules, state.rules.steps, strict=True):
            if rule.name in active:
                assert step.record.is_active is active[rule.name]
