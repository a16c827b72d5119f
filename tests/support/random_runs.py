"""Random rules on random observations, from a seed, and whole runs that may have every kind of everything at once."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from unittest.mock import patch

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms import alarm
from stadimeter.core.alarms.machine import thresholds_of
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Mount
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import Condition
from stadimeter.core.conditions.measured import COMPARISONS, FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition, RememberedFigure, Window
from stadimeter.core.conditions.schedule import DateSpan, ScheduleCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.observation import MonthDay, Observation, WallTime
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import (
    ALWAYS,
    AlarmRule,
    AnyRule,
    EscalationStep,
    FollowRule,
    RampRule,
    ReportRule,
    Send,
    Template,
    gate_of,
)
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.conditions import compared
from support.random_rules import TARGETS, RandomRules
from support.random_scenes import SETTING, RandomScene

# Random rules on random observations, from a seed: for tests that compare two ways to decide on the same run.

LENS = replace(CameraModel.with_focal_length(600.0, 640, 480), focal_relative_sigma=0.01)
OUTPUTS = (
    LevelOutput(name="motor", rise_per_s=2.0, fall_per_s=4.0),
    LevelOutput(name="lamp", safe_level=0.3, combine="max"),
    BaseOutput(name="base", combine="most_restrictive"),
)


class RandomRun(Struct, frozen=True, kw_only=True):
    """Rules, and what they are judged by, cycle by cycle."""

    plan: Plan
    observations: tuple[Observation, ...]


def random_run(seed: int, *, is_aimed: bool = False) -> RandomRun:
    """Return a run at 1 to 60 fps, with σ from 0 to 0.5 m, outliers, gaps, operator commands, and chains of rules.

    Args:
        seed: The same seed gives the same run.
        is_aimed: Aim at alarms that give up (policies ``clear`` and ``assert``) while others depend on them: compounds
            about two targets of which one stands in a deadband while the other is out of sight.
    """
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    rules = RandomRules(rng, is_aimed=is_aimed).some()
    fps = rng.choice((1, 5, 10, 30, 60))
    safety = Safety(max_frame_age_s=max(0.2, 2.5 / fps), good_frames=2)
    names = tuple(rule.name for rule in rules if isinstance(rule, AlarmRule))
    seen = RandomScene(rng, fps, names, is_aimed=is_aimed).observations(60 if is_aimed else 100)
    mount = rng.choice((Mount(), Mount(x_m=0.1, y_m=-0.05, yaw_rad=0.2)))
    viewpoint = Viewpoint(height_m=rng.choice((None, 0.5)), tilt_rad=0.1, lens=LENS, mount=mount)
    plan = Plan(targets=TARGETS, rules=rules, outputs=OUTPUTS, safety=safety, viewpoint=viewpoint)
    return RandomRun(plan=plan, observations=tuple(seen))


def with_settings(run: RandomRun, seed: int) -> RandomRun:
    """Return the same run with operators who move thresholds every few cycles, and let rules be observed only."""
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    keys = {rule.name: [*thresholds_of(rule)] for rule in run.plan.rules if isinstance(rule, AlarmRule)}

    def command() -> OperatorCommand:
        name = rng.choice([*keys])
        key = rng.choice(keys[name] or [""])
        value = rng.choice((rng.uniform(0.3, 3.0), rng.uniform(-0.5, 1.0)))
        return OperatorCommand(id="2", action=rng.choice(SETTING), rule=name, key=key, value=value, by="Zoe")

    observations = (
        replace(each, operator_commands=(*each.operator_commands, command())) if keys and rng.random() < 0.2 else each
        for each in run.observations
    )
    return replace(run, observations=tuple(observations))


def first_difference(run: RandomRun) -> tuple[int, Decision, Decision] | None:
    """Return the first cycle in which evaluating alarms that surely stay as they are would change something.

    Both decisions are given: as they are made, and with every alarm evaluated in full.
    """
    short = full = initial_state(run.plan)
    for cycle, observation in enumerate(run.observations):
        short, decision = decide(short, observation)
        with patch.object(alarm, "_stays", lambda *_: False):
            full, expected = decide(full, observation)
        if decision != expected or dict(decision.reasons) != dict(expected.reasons):
            return cycle, decision, expected
    return None


# Random runs that may have every kind of rule, condition, schedule, memory and command at once.

# When a run begins: at noon, shortly before midnight, or before clocks are put forward or back.
BEGINNINGS_S = (43200.0, DAY_S - 1.5, 7199.0)
DAYS = (MonthDay(12, 30), MonthDay(12, 31), MonthDay(1, 1), MonthDay(1, 2))
FIRST_DAY, FIRST_WEEKDAY = 1, 3


def whole_run(seed: int) -> RandomRun:
    """Return a run of 100 cycles in which any condition may stand anywhere; the same seed gives the same run.

    Its rules are alarms, ramps, rules that follow and messages at times, each but the first with a gate or none. It may
    go over midnight, the new year or a change of clocks. Operators command every rule.
    """
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    began_s = rng.choice(BEGINNINGS_S)
    made = WholeRules(rng, began_s)
    rules = made.some()
    plain = random_run(seed)
    plan = replace(plain.plan, rules=rules, figures=made.figures)
    observations = _with_commands(rng, plan, _with_calendar(rng, began_s, plain.observations))
    return RandomRun(plan=plan, observations=tuple(observations))


class WholeRules(RandomRules):
    """Makes rules of which each may ask for what those made before it do, and did.

    Attributes:
        figures: The remembered figures that conditions may be on.
    """

    def __init__(self, rng: random.Random, began_s: float) -> None:
        super().__init__(rng, is_aimed=False)
        self.began_s = began_s
        self.figures = tuple(self._figure_to_remember(f"figure-{number}") for number in range(2))

    def some(self) -> tuple[AnyRule, ...]:
        """Rules of all kinds, in any order."""
        rules = []
        for number in range(self.rng.randint(4, 9)):
            make = self.rng.choices((self._alarm, self._ramp, self._follow, self._report), (6, 2, 1, 2))[0]
            rule: AnyRule = make(f"rule-{number}")
            rules.append(rule if isinstance(rule, AlarmRule) else replace(rule, gate=self._gate(rule)))
            self.names.append(rule.name)
        self.rng.shuffle(rules)
        return tuple(rules)

    def _follow(self, name: str) -> FollowRule:
        return FollowRule(name=name, target=self._target(), output="base", distance_m=1.0)

    def _report(self, name: str) -> ReportRule:
        at_seconds = ((self.began_s + self.rng.uniform(-30.0, 2.0)) % DAY_S,)
        times = self.rng.choice(({"every_s": self.rng.choice((0.3, 1.0))}, {"at_seconds": at_seconds}))
        return ReportRule(name=name, target=self._target(), **times)

    def _gate(self, rule: RampRule | FollowRule | ReportRule) -> AlarmRule:
        steps = tuple(self._sending() for _ in range(2)) if isinstance(rule, ReportRule) else ()
        return AlarmRule(
            name="",
            target="",
            condition=self.condition(1) if self.rng.random() < 0.7 else ALWAYS,
            suppress_when=self.condition(1) if self.rng.random() < 0.3 else None,
            escalation=steps,
        )

    def _sending(self) -> EscalationStep:
        when = self.condition(1) if self.rng.random() < 0.5 else None
        return EscalationStep(send=Send(template=Template(text="{count} {figure-0}"), topic="report"), when=when)

    def _step(self) -> EscalationStep:
        return replace(super()._step(), when=self.condition(1) if self.rng.random() < 0.5 else None)

    def _leaf(self) -> Condition:
        """A simple condition: half of the time one on time, on memory, on order, or on two targets."""
        kinds = (self._schedule, self._figure_limits, self._comparison, self._sum, self.sequence)
        known = kinds if len(self.names) > 1 else kinds[:3]
        return self.rng.choice(known)() if self.rng.random() < 0.5 else super()._leaf()

    def _figure(self) -> FigureCondition:
        """Limits on a quantity, where targets are."""
        found = super()._figure()
        ahead = {"z": 1.3, "ahead": 1.3, "height": 0.7}.get(found.quantity, 0.0)
        return replace(found, above=(found.above or 0.0) + ahead)

    def _schedule(self) -> ScheduleCondition:
        rng = self.rng
        dates = ((), (), (DateSpan(DAYS[1], DAYS[2]),), (DateSpan(DAYS[2], DAYS[1]),), (DateSpan(DAYS[0], DAYS[1]),))
        weekdays = rng.choice(((), (), (FIRST_WEEKDAY,), (FIRST_WEEKDAY + 1,), (0, FIRST_WEEKDAY - 1)))
        ends = {}
        for end in ("from", "to"):
            sun = rng.choice(("", "", "sunrise", "sunset"))
            around_s = 0.0 if sun else self.began_s
            ends |= {
                f"{end}_sun": sun,
                f"{end}_s": around_s + rng.uniform(-1.5, 2.5) if sun else (around_s + rng.uniform(-1.5, 2.5)) % DAY_S,
            }
        return ScheduleCondition(**ends, weekdays=weekdays, dates=rng.choice(dates))

    def _comparison(self) -> Condition:
        quantity, is_more = self.rng.choice([*COMPARISONS.values()])
        by = self.rng.uniform(-0.2, 0.3)
        limit = {"above": by} if is_more else {"below": -by}
        return compared(quantity, *self.rng.sample(TARGETS, 2), **limit, **self._chances())

    def _window(self) -> Window:
        rng = self.rng
        since = Window(from_second=(self.began_s + rng.choice((-3600.0, 0.5, 1.0))) % DAY_S)
        return rng.choice((Window(for_s=rng.uniform(0.2, 4.0)), Window(for_s=1.0), since, Window(from_second=0.0)))

    def _figure_to_remember(self, name: str) -> RememberedFigure:
        rng = self.rng
        alone = [key for key, each in QUANTITIES.items() if not each.takes_motion and key != "separation"]
        return RememberedFigure(
            name=name,
            target=self._target(),
            quantity=rng.choice(("distance", *alone)),
            statistic=rng.choice(("minimum", "maximum", "mean", "percentile")),
            percentile=rng.choice((0.0, 50.0, 90.0, 100.0)),
            window=self._window(),
        )

    def _figure_limits(self) -> RememberedCondition:
        figure = self.rng.choice(self.figures)
        unit = QUANTITIES[figure.quantity].unit
        limit = (
            self.rng.uniform(0.5, 2.0)
            if figure.quantity in {"distance", "depth", "z", "ahead"}
            else self.rng.uniform(-0.2, 0.3)
        )
        side = self.rng.choice(("above", "below"))
        return RememberedCondition(name=figure.name, unit=unit, deadband=self.rng.choice((0.0, 0.1)), **{side: limit})

    def _sum(self) -> RememberedCondition:
        rules = tuple(self.rng.sample(self.names, 1 + (self.rng.random() < 0.2)))
        unit, above = self.rng.choice((("times", float(self.rng.randint(0, 3))), ("s", self.rng.uniform(0.05, 1.0))))
        return RememberedCondition(rules=rules, unit=unit, above=above, window=self._window())


def _with_calendar(rng: random.Random, began_s: float, observations: tuple[Observation, ...]) -> Iterator[Observation]:
    """Give each observation a local time that is not known at times, and clocks that are changed once, or set right."""
    first_s = observations[0].now_s
    change_s, at = rng.choice((0.0, 3600.0, -3600.0, 0.5)), rng.randrange(len(observations))
    sun_s = began_s + rng.uniform(-2.0, 2.0), began_s + rng.uniform(-2.0, 2.0)
    sun_s = rng.choice((sun_s, sun_s, (math.inf, -math.inf), (-math.inf, math.inf), (None, None)))
    unknown = set(rng.choice(((), range(20), range(40, 60), range(len(observations)))))
    for number, observation in enumerate(observations):
        shown_s = began_s + observation.now_s - first_s + (change_s if number >= at else 0.0)
        later, second_s = int(shown_s // DAY_S), shown_s % DAY_S
        wall = WallTime(
            second_of_day=second_s,
            weekday=FIRST_WEEKDAY + later,
            dates=DAYS[FIRST_DAY - 1 + later : FIRST_DAY + 2 + later],
            sunrise_s=sun_s[0],
            sunset_s=sun_s[1],
        )
        yield replace(observation, wall=None if number in unknown else wall)


def _with_commands(rng: random.Random, plan: Plan, observations: Iterator[Observation]) -> Iterator[Observation]:
    """Let operators say something to any rule every few cycles: shelve and reset it above all, or move a threshold."""
    often = (OperatorAction("shelve"), OperatorAction("unshelve"), OperatorAction("reset"))
    actions = [*often, *often, *(action for action in OperatorAction if not action.is_on_outputs)]

    def command() -> OperatorCommand:
        rule = rng.choice(plan.rules)
        return OperatorCommand(
            id="3",
            action=rng.choice(actions),
            rule=rule.name,
            key=rng.choice([*thresholds_of(gate_of(rule))] or [""]),
            value=rng.choice((rng.uniform(0.3, 3.0), rng.uniform(-0.5, 1.0))),
            for_s=rng.choice((0.2, 0.4, 3.0)),
            one_shot=rng.random() < 0.3,
            by="Eve",
        )

    for each in observations:
        told = (command(),) if rng.random() < 0.2 else ()
        yield replace(each, operator_commands=(*each.operator_commands, *told))
