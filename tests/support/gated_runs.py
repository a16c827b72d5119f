"""Random runs with gates, conditions on steps, schedules by date and sun, and orders of rules."""

from __future__ import annotations

import math
import random

from msgspec.structs import replace

from stadimeter.core.conditions.compounds import Condition
from stadimeter.core.conditions.discrete import DateSpan, ScheduleCondition
from stadimeter.core.observation import MonthDay, Observation
from stadimeter.core.operator import OperatorCommand
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule
from stadimeter.operator_actions import OperatorAction
from support.random_runs import TARGETS, RandomRules, RandomRun


def with_gates(run: RandomRun, seed: int) -> RandomRun:  # noqa: C901 - what it draws is one sequence
    """Return the same run with gates on its ramps and follow rules, conditions on steps, schedules and orders.

    Operators command every rule, and the calendar and the sun are known.
    """
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    made = RandomRules(rng, is_aimed=False)
    names = [rule.name for rule in run.plan.rules]

    def condition(name: str) -> Condition:
        made.names = sorted(names)[: sorted(names).index(name)]  # rules ask for those made before them
        kind = rng.random()
        if kind < 0.2:
            return ScheduleCondition(
                from_s=rng.choice((-2.0, 0.0, 1.0)),
                to_s=rng.choice((0.0, 3.0)),
                from_sun=rng.choice(("sunset", "sunrise")),
                to_sun=rng.choice(("sunset", "sunrise")),
                dates=rng.choice(
                    ((), (DateSpan(MonthDay(11, 26), MonthDay(1, 6)),), (DateSpan(MonthDay(8, 1), MonthDay(8, 2)),))
                ),
            )
        if kind < 0.4 and len(made.names) > 1:
            return made.sequence()
        return made.condition(1)

    def gated(rule: AnyRule) -> AnyRule:
        if isinstance(rule, AlarmRule):
            steps = (
                replace(step, when=condition(rule.name)) if rng.random() < 0.6 else step for step in rule.escalation
            )
            return replace(rule, escalation=tuple(steps))
        gate = AlarmRule(
            name="",
            target="",
            condition=condition(rule.name) if rng.random() < 0.8 else ALWAYS,
            suppress_when=condition(rule.name) if rng.random() < 0.4 else None,
        )
        return replace(rule, gate=gate)

    made.names = names
    orders = [
        AlarmRule(name=f"z-order-{number}", target=TARGETS[0], condition=made.sequence(), off_delay_s=0.0)
        for number in range(2 if len(names) > 1 else 0)
    ]
    rules = (*(gated(rule) for rule in run.plan.rules), *orders)

    def seen(observation: Observation) -> Observation:
        wall = observation.wall
        if wall is not None:
            sun = (43204.0, 43202.0) if seed % 3 else rng.choice(((math.inf, -math.inf), (-math.inf, math.inf)))
            wall = replace(
                wall, dates=(MonthDay(11, 25), MonthDay(11, 26), MonthDay(11, 27)), sunrise_s=sun[0], sunset_s=sun[1]
            )
        commands = observation.operator_commands
        if rng.random() < 0.1:
            action = rng.choice([action for action in OperatorAction if not action.is_on_outputs])
            commands = (*commands, OperatorCommand(id="3", action=action, rule=rng.choice(names), for_s=0.4, by="Eve"))
        return replace(observation, wall=wall, operator_commands=commands)

    return RandomRun(
        plan=replace(run.plan, rules=rules), observations=tuple(seen(observation) for observation in run.observations)
    )
