"""No order that is permitted to everybody makes an output act that would not act without it."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.outputs import safe_command
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, EscalationStep, FollowRule, Pattern, RampRule, Send, Template
from stadimeter.core.safety import could_let_act
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.random_runs import OUTPUTS, random_run

NEAR = DistanceCondition(below=1.0)
TELLS = AlarmRule(name="tells", target="ball", condition=NEAR, ack="required", latch=True)
BUZZES = replace(TELLS, name="buzzes", output="motor")
STOPS = replace(TELLS, name="stops", output="base", priority=200)
FOLLOWS = FollowRule(name="follows", target="ball", output="base", distance_m=1.0)
SHAKES = RampRule(name="shakes", target="ball", output="lamp", start=2.0, full=0.5)
ASKS = RuleCondition(rule="tells")
SEND = Send(template=Template(text="{rule}"), topic="alert")

ON_RULES = [action for action in OperatorAction if not action.is_on_outputs]
QUIETING = {OperatorAction.ACKNOWLEDGE, OperatorAction.SHELVE, OperatorAction.TAKE_OUT, OperatorAction.OBSERVE}


def plan_of(*rules):
    return Plan(targets=("ball",), rules=rules, outputs=OUTPUTS)


def permitted(plan, rule):
    return {action for action in ON_RULES if not could_let_act(plan, action, rule)}


@pytest.mark.parametrize(
    ("kind", "plan", "expected"),
    [
        ("sends only", plan_of(TELLS, BUZZES, FOLLOWS), set(ON_RULES)),
        ("sends only, in steps", plan_of(replace(TELLS, escalation=(EscalationStep(send=SEND),))), set(ON_RULES)),
        ("alone on an actuator", plan_of(replace(BUZZES, name="tells"), STOPS), QUIETING),
        ("a ramp with a dead zone", plan_of(replace(SHAKES, name="tells", dead_zone=0.2)), set()),
        ("a ramp alone on an actuator", plan_of(replace(SHAKES, name="tells")), QUIETING),
        ("one of two on an actuator", plan_of(replace(BUZZES, name="tells"), replace(BUZZES, name="other")), set()),
        ("a pattern", plan_of(replace(BUZZES, name="tells", pattern=Pattern(steps=((1.0, 0.1),), times=2))), set()),
        ("a step with an output", plan_of(replace(TELLS, escalation=(EscalationStep(output="lamp"),))), set()),
        ("follows", plan_of(replace(FOLLOWS, name="tells")), set()),
        ("stops a base", plan_of(replace(STOPS, name="tells"), FOLLOWS), set()),
        ("is asked for by one that buzzes", plan_of(TELLS, replace(BUZZES, condition=ASKS)), set()),
        ("suppresses one that buzzes", plan_of(TELLS, replace(BUZZES, suppress_when=ASKS)), set()),
        ("is asked for by one that is asked for", plan_of(
            TELLS, replace(TELLS, name="between", condition=ASKS),
            replace(BUZZES, condition=RuleCondition(rule="between"))), set()),
    ],
)  # fmt: skip
def test_what_is_permitted_for_a_rule_goes_by_what_it_could_move(kind, plan, expected):
    assert permitted(plan, "tells") == expected, kind


def test_of_orders_to_every_output_those_are_permitted_that_stop():
    letting = {each for each in OperatorAction if each.is_on_outputs and could_let_act(plan_of(), each)}
    assert letting == {OperatorAction.RELEASE_OUTPUTS, OperatorAction.ARM, OperatorAction.CONFIRM_MOUNTING}


def test_an_order_to_every_rule_names_those_that_it_could_move():
    plan = plan_of(TELLS, BUZZES, FOLLOWS)
    assert could_let_act(plan, OperatorAction.ACKNOWLEDGE) == ("follows",)
    assert could_let_act(plan, OperatorAction.UNSHELVE) == ("buzzes", "follows")


def how_far(commands):
    """Return how far from its safe value each part of each output's command is."""
    return [
        abs(getattr(command, part) - getattr(safe_command(output), part))
        for command, output in zip(commands, OUTPUTS, strict=True)
        for part in ("level", "linear_mps", "angular_radps")
        if hasattr(command, part)
    ]


ORDERS = [
    {"action": action, "key": key, "value": value}
    for action in ON_RULES
    for key, value in ([("", None)] if not action.needs_value else [("", 100.0), ("below", 0.01), ("any.0.below", 9.0)])
]


INHIBITING = [OperatorAction.SHELVE, OperatorAction.TAKE_OUT, OperatorAction.OBSERVE, OperatorAction.SET_THRESHOLD]


@pytest.mark.parametrize("seeds", [range(50), pytest.param(range(50, 500), marks=pytest.mark.long)])
def test_no_permitted_order_of_any_verb_to_any_kind_of_rule_brings_an_output_nearer_to_acting(seeds):
    for seed in seeds:
        no_permitted_order_brings_an_output_nearer(seed)


def no_permitted_order_brings_an_output_nearer(seed):
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    run = random_run(seed)
    plan, seen = run.plan, [replace(each, operator_commands=()) for each in run.observations[:40]]
    rule = rng.choice(["", *(rule.name for rule in plan.rules)])
    earlier = rng.choices(INHIBITING, k=rng.randint(0, 2))
    before = (OperatorCommand(id="before", action=each, rule=rule, value=0.01) for each in earlier)
    seen[0] = replace(seen[0], operator_commands=tuple(before))  # by somebody who may
    at = rng.randrange(len(seen))
    orders = [OperatorCommand(id="order", rule=rule, for_s=0.3, **each) for each in ORDERS]
    orders += [
        OperatorCommand(id="order", action=each) for each in (OperatorAction.STOP_OUTPUTS, OperatorAction.DISARM)
    ]
    state = initial_state(plan)
    for observation in seen[:at]:
        state, _ = decide(state, observation)
    without = list(commands_of(state, seen[at:]))
    for order in orders:
        if could_let_act(plan, order.action, order.rule):
            continue
        given_too = replace(seen[at], operator_commands=(*seen[at].operator_commands, order))
        for expected, found in zip(without, commands_of(state, [given_too, *seen[at + 1 :]]), strict=True):
            assert all(a <= b + 1e-9 for a, b in zip(how_far(found), how_far(expected), strict=True)), order


def commands_of(state, seen):
    for observation in seen:
        state, decision = decide(state, observation)
        yield decision.commands
