"""What the analysis says of conditions is true of every situation: held against the core, which judges them."""

from __future__ import annotations

import random

from stadimeter.config.analysis.logic import Logic, Wanted, week_of
from stadimeter.config.analysis.regions import beginning_of
from stadimeter.core.conditions.compounds import AllOf, judge, leaves
from stadimeter.core.conditions.discrete import ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from support.random_conditions import TARGETS, RandomConditions
from support.random_runs import random_run


def test_what_was_judged_to_hold_is_never_said_to_be_impossible() -> None:
    held = set()
    for seed in range(12):
        run = random_run(seed)
        conditions = RandomConditions(random.Random(seed), is_aimed=False)  # noqa: S311
        judged = [conditions.condition() for _ in range(8)]
        can_be = [Logic(targets=TARGETS).can_be((beginning_of(each), Wanted.TRUE)) for each in judged]
        state = initial_state(run.plan)
        for observation in run.observations:
            state, decision = decide(state, observation)
            inputs = decision.reasons.inputs_of_rules()
            for condition, is_possible in zip(judged, can_be, strict=True):
                if judge(condition, inputs, (), is_active=False).value:
                    assert is_possible, condition
                    held.update(type(leaf).__name__ for leaf in leaves(condition))
    assert len(held) > 5, "conditions of many kinds held"


def test_an_analysis_that_gives_up_says_that_everything_is_possible() -> None:
    impossible = AllOf(
        conditions=(DistanceCondition(below_m=1.0, target="ball"), DistanceCondition(above_m=2.0, target="ball"))
    )
    assert not Logic(targets=TARGETS).can_be((impossible, Wanted.TRUE))
    assert Logic(targets=TARGETS, steps_left=1).can_be((impossible, Wanted.TRUE))


def test_a_night_that_begins_on_sunday_ends_on_monday() -> None:
    night = ScheduleCondition(from_s=22 * 3600.0, to_s=6 * 3600.0, weekdays=(6,))
    assert week_of(night).parts == ((0.0, 6 * 3600.0), (6 * 86400.0 + 22 * 3600.0, 7 * 86400.0))
