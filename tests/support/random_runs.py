"""Random rules on random observations, from a seed: for tests that compare two ways to decide on the same run."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms.settings import thresholds_of
from stadimeter.core.base_report import BaseReport
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import (
    CountCondition,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
)
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_base import BatteryCondition, ContactSensorCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.conditions.summary import RememberedFigure, Window
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.decide import State
from stadimeter.core.decision import Severity
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.operator import OperatorCommand
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import (
    ALWAYS,
    AlarmRule,
    AnyRule,
    EscalationStep,
    FollowRule,
    Lost,
    LostPolicy,
    OnDelay,
    Pattern,
    RampRule,
    ReportRule,
    Send,
    Template,
)
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.operator_actions import OperatorAction
from support.conditions import closing, compared, direction, separation, still
from support.observing import measured, missed

TARGETS = ("ball", "tag")
LIMIT_M = 1.5
"""The limit of every distance in an aimed run."""
LENS = replace(CameraModel.with_focal_length(600.0, 640, 480), focal_relative_sigma=0.01)
OTHER_QUANTITIES = (
    "bearing",
    "x",
    "y",
    "z",
    "height",
    "height_above_camera",
    "sideways_speed",
    "speed",
    "closing_speed",
    "size",
)
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
    seen = _Scene(rng, fps, names, is_aimed=is_aimed).observations(60 if is_aimed else 100)
    viewpoint = Viewpoint(height_m=rng.choice((None, 0.5)), tilt_rad=0.1, lens=LENS)
    plan = Plan(targets=TARGETS, rules=rules, outputs=OUTPUTS, safety=safety, viewpoint=viewpoint)
    return RandomRun(plan=plan, observations=tuple(seen))


# What an operator sets of a rule. The other actions are those of `random_run`, whose seeds stay what they are.
SETTING = tuple(
    OperatorAction(name) for name in ("set-threshold", "set-threshold", "withdraw-threshold", "observe", "act")
)


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


def with_memory(run: RandomRun, seed: int) -> RandomRun:
    """Return the same run with rules that count and sum what the others did, remembered figures, messages at times.

    Operators reset those that count. The time of day is that of `random_run`: 12:00 at its beginning.
    """
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    figures = tuple(
        RememberedFigure(
            name=f"figure-{number}",
            target=rng.choice(TARGETS),
            quantity=rng.choice(("distance", "distance", "closing_speed", "bearing")),
            statistic=rng.choice(("minimum", "maximum", "mean", "percentile")),
            percentile=rng.choice((0.0, 50.0, 90.0, 100.0)),
            window=_window(rng),
        )
        for number in range(2)
    )
    known = RandomRules(rng, is_aimed=False)
    known.names = [rule.name for rule in run.plan.rules]
    made = []
    for number in range(rng.randint(1, 4)):
        rule = known._alarm(f"memory-{number}")
        parts = tuple(_remembering(rng, known.names, figures) for _ in range(rng.randint(1, 2)))
        whole = rng.choice((parts[0], AllOf(conditions=parts), AnyOf(conditions=(*parts, rule.condition))))
        made.append(replace(rule, condition=rng.choice((whole, whole, Not(condition=whole)))))
        known.names.append(rule.name)
    send = EscalationStep(send=Send(template=Template(text="{figure-0}"), topic="report"))
    sends = AlarmRule(name="", target="", condition=ALWAYS, escalation=(send, replace(send, when=known.condition())))
    gate = replace(sends, condition=known.condition(), suppress_when=rng.choice((None, known.condition())))
    reports = (
        ReportRule(name="every", target="ball", every_s=rng.choice((0.3, 1.0)), gate=rng.choice((gate, sends))),
        ReportRule(name="at", target="tag", at_seconds=(43201.0,), gate=rng.choice((gate, sends))),
    )
    rules = [*run.plan.rules, *made, *reports]
    rng.shuffle(rules)
    reset = OperatorAction("reset")
    observations = tuple(
        replace(each, operator_commands=(OperatorCommand(id="3", action=reset, rule=rng.choice(made).name, by="Ida"),))
        if not each.operator_commands and rng.random() < 0.05
        else each
        for each in run.observations
    )
    return RandomRun(plan=replace(run.plan, rules=tuple(rules), figures=figures), observations=observations)


def _window(rng: random.Random) -> Window:
    return rng.choice((Window(for_s=rng.uniform(0.2, 4.0)), Window(for_s=1.0), Window(from_second=43200.5), Window()))


def _remembering(rng: random.Random, names: list[str], figures: tuple[RememberedFigure, ...]) -> Condition:
    rules, figure = tuple(rng.sample(names, 1 + (rng.random() < 0.2))), rng.choice(figures)
    return rng.choice(
        (
            RememberedCondition(rules=rules, unit="times", above=float(rng.randint(0, 3)), window=_window(rng)),
            RememberedCondition(rules=rules, unit="s", above=rng.uniform(0.1, 1.5), window=_window(rng)),
            RememberedCondition(
                name=figure.name,
                unit=(unit := QUANTITIES[figure.quantity].unit),
                below=rng.uniform(0.5, 2.0) if unit == "m" else rng.uniform(-0.2, 0.4),
                deadband=rng.choice((0.0, 0.1)),
            ),
        )
    )


def with_all_active(state: State) -> State:
    """Return a state in which no rule is quiescent: every rule is judged in the next cycle."""
    return replace(state, rules=replace(state.rules, quiescence=state.rules.quiescence.with_all_active()))


class RandomRules:
    """Makes rules."""

    def __init__(self, rng: random.Random, *, is_aimed: bool) -> None:
        self.rng = rng
        self.is_aimed = is_aimed
        self.names: list[str] = []

    def some(self) -> tuple[AnyRule, ...]:
        """Rules of all kinds, in any order; alarms ask only for those made before them, so there is no circle."""
        rules: list[AnyRule] = []
        for number in range(self.rng.randint(2, 7)):
            kind = self.rng.random()
            if self.is_aimed or kind < 0.75:
                rules.append(self._alarm(f"rule-{number}"))
            elif kind < 0.92:
                rules.append(self._ramp(f"rule-{number}"))
            else:
                rules.append(FollowRule(name=f"rule-{number}", target=self._target(), output="base", distance_m=1.0))
            self.names.append(f"rule-{number}")
        self.rng.shuffle(rules)
        return tuple(rules)

    def _target(self) -> str:
        return self.rng.choice(TARGETS)

    def _chances(self) -> dict[str, float | None]:
        on = self.rng.choice((None, 0.1, 0.5, 0.7, 0.7, 0.7, 0.95))
        return {
            "probability_on": on,
            "probability_off": self.rng.choice((0.2, 0.5, 0.5, 0.9)),
            "deadband_sigmas": self.rng.choice((0.0, 3.0, 3.0)),
        }

    def _distance(self) -> Condition:
        low, high = sorted(self.rng.uniform(0.6, 2.6) for _ in range(2))
        above, below = self.rng.choice(((None, high), (None, high), (low, None), (low, high + 0.01)))
        return DistanceCondition(
            above_m=above,
            below_m=below,
            deadband_m=self.rng.choice((0.0, 0.2)),
            quantity=self.rng.choice(("distance", "depth")),
            target=self._target(),
            **self._chances(),  # type: ignore[arg-type]
        )

    def _figure(self) -> Condition:
        """Limits on one of the quantities that have no kind of their own."""
        return FigureCondition(
            quantity=self.rng.choice(OTHER_QUANTITIES),
            above=self.rng.uniform(-0.3, 0.5),
            deadband=self.rng.choice((0.0, 0.1)),
            target=self._target(),
            **self._chances(),  # type: ignore[arg-type]
        )

    def _leaf(self) -> Condition:
        rng = self.rng
        kinds: tuple[Callable[[], Condition], ...] = (
            self._distance,
            self._distance,
            lambda: direction(
                quantity=rng.choice(("bearing", "elevation")), above=rng.uniform(-0.3, 0.3), target=self._target()
            ),
            lambda: closing(above=rng.uniform(-1, 1), target=self._target(), **self._chances()),  # type: ignore[arg-type]
            lambda: TimeToContactCondition(
                below_s=rng.uniform(0.3, 5),
                contact_m=rng.choice((0.0, 0.3)),
                target=self._target(),
                **self._chances(),  # type: ignore[arg-type]
            ),
            self._figure,
            lambda: compared(
                rng.choice(("distance", "bearing", "height_above_camera")),
                *TARGETS,
                above=rng.uniform(-0.3, 0.3),
                **self._chances(),  # type: ignore[arg-type]
            ),
            lambda: still(rng.choice((0.3, 1.0)), within_m=rng.choice((0.0, 0.1)), target=self._target()),
            lambda: separation(targets=TARGETS, below=rng.uniform(0.2, 2), **self._chances()),  # type: ignore[arg-type]
            lambda: PresenceCondition(
                seen=rng.random() < 0.4, for_s=rng.choice((0.0, 0.5, 3.0)), target=self._target()
            ),
            lambda: CountCondition(at_least=rng.choice((None, 1, 2)), at_most=rng.choice((0, 1))),
            lambda: ContactSensorCondition(sensor=rng.choice(("is_bumped", "is_at_cliff"))),
            lambda: BatteryCondition(below_v=rng.choice((10.8, 11.4))),
            lambda: UndeliveredCondition(for_s=rng.choice((0.2, 1.0))),
            lambda: ScheduleCondition(from_s=43200.0, to_s=rng.choice((43203.0, 80000.0))),
        )
        if self.names and rng.random() < (0.35 if self.is_aimed else 0.2):
            return RuleCondition(rule=rng.choice(self.names))
        return rng.choice(kinds[:2] if self.is_aimed and rng.random() < 0.6 else kinds)()

    def _of_both(self) -> Condition:
        """A compound about both targets, with deadbands in which one may stand while the other is out of sight."""
        parts = tuple(
            DistanceCondition(
                below_m=LIMIT_M, deadband_m=0.3, target=target, probability_on=self.rng.choice((0.7, None))
            )
            for target in self.rng.sample(TARGETS, 2)
        )
        whole = self.rng.choice((AllOf(conditions=parts), AnyOf(conditions=parts)))
        return self.rng.choice((whole, whole, Not(condition=whole)))

    def condition(self, depth: int = 0) -> Condition:
        """A condition of any kind."""
        if self.is_aimed and depth == 0 and self.rng.random() < 0.6:
            return self._of_both()
        if depth == 2 or self.rng.random() < (0.25 if self.is_aimed and depth == 0 else 0.6):
            return self._leaf()
        parts = tuple(self.condition(depth + 1) for _ in range(self.rng.randint(2, 3)))
        return self.rng.choice((AllOf(conditions=parts), AnyOf(conditions=parts), Not(condition=parts[0])))

    def _alarm(self, name: str) -> AlarmRule:
        rng = self.rng
        policies = (LostPolicy.CLEAR, LostPolicy.CLEAR, LostPolicy.ASSERT) if self.is_aimed else tuple(LostPolicy)
        pattern = rng.choice((None, None, None, Pattern(steps=((1.0, 0.2), (0.0, 0.1)), times=rng.choice((0, 3)))))
        return AlarmRule(
            name=name,
            target=self._target(),
            output=rng.choice((None, "motor", "lamp", "base")),
            priority=rng.randint(0, 3),
            severity=rng.choice((Severity.WARNING, Severity.WARNING, Severity.SAFETY)),
            observe=rng.random() < 0.1,
            condition=self.condition(),
            lost=Lost(
                grace_s=rng.choice((0.0, 0.3, 1.0)), policy=rng.choice(policies), fault_after_s=rng.choice((0.6, 2.0))
            ),
            on_delay=rng.choice((OnDelay(), OnDelay(), OnDelay(hold_s=0.5), OnDelay(frames=3, of_frames=5))),
            off_delay_s=rng.choice((0.0, 0.0, 0.5)),
            at_start="act" if rng.random() < 0.7 else "announce",
            pattern=pattern,
            latch=rng.random() < 0.2,
            ack="required" if rng.random() < 0.25 else "none",
            realarm_s=rng.choice((None, None, 1.5)),
            cooldown_s=rng.choice((0.0, 1.0, 10.0)),
            group=rng.choice(("", "", "door")),
            suppress_when=self.condition(1) if rng.random() < 0.25 else None,
            escalation=tuple(self._step() for _ in range(rng.choice((0, 0, 1, 2)))),
        )

    def sequence(self) -> SequenceCondition:
        """An order of two or three of the rules that were made before."""
        return SequenceCondition(
            rules=tuple(self.rng.sample(self.names, min(len(self.names), self.rng.choice((2, 2, 3))))),
            within_s=self.rng.choice((0.5, 2.0, 30.0)),
            for_s=self.rng.choice((None, None, 0.3)),
        )

    def _step(self) -> EscalationStep:
        rng = self.rng
        return EscalationStep(
            on=rng.choice(("raised", "cleared")),
            after_s=rng.choice((0.0, 0.4, 1.0)),
            only_unacknowledged=rng.random() < 0.3,
            output=rng.choice((None, "lamp", "base")),
            level=0.6,
            for_s=rng.choice((0.5, float("inf"))),
            send=rng.choice((None, Send(template=Template(text="{rule}"), topic="alert"))),
        )

    def _ramp(self, name: str) -> RampRule:
        start_m = self.rng.uniform(0.6, 2.0)
        quantity = self.rng.choice(("distance", "distance", "depth", *OTHER_QUANTITIES))
        points = ((0.5, 1.0), (1.0, 0.4), (1.5, 0.4), (2.0, 0.0)) if self.rng.random() < 0.3 else ()
        return RampRule(
            name=name,
            target=self._target(),
            output=self.rng.choice(("motor", "lamp")),
            priority=self.rng.randint(0, 3),
            start=start_m,
            full=start_m + self.rng.choice((-0.4, 0.8)),
            quantity=quantity,
            level_min=self.rng.choice((0.0, 0.3)),
            dead_zone=self.rng.choice((0.0, 0.2)),
            bias=self.rng.choice(("neutral", "neutral", "cautious", "quiet")),
            points=points,
        )


class _Scene:
    def __init__(self, rng: random.Random, fps: int, names: tuple[str, ...], *, is_aimed: bool) -> None:
        self.rng = rng
        self.step_s = 1 / fps
        self.names = names
        self.is_aimed = is_aimed
        self.at_m = dict.fromkeys(TARGETS, 1.5)
        self.speed_mps = dict.fromkeys(TARGETS, 0.0)
        self.gone = dict.fromkeys(TARGETS, 0)
        self.sigma_m = rng.choice((0.0, 0.002) if is_aimed else (0.0, 0.002, 0.03, 0.1, 0.5))
        self.has_wall = rng.random() < 0.7
        self.undelivered_since_s: float | None = None

    def observations(self, cycles: int) -> Iterator[Observation]:
        """Cycles with a frame each, or a camera that says nothing, or a program that stood still."""
        now_s, sequence = 100.0, 0
        for _ in range(cycles):
            chance = self.rng.random()
            now_s += self.rng.uniform(1.0, 8.0) if chance < 0.01 else self.step_s
            wall = WallTime(second_of_day=43100 + now_s, weekday=2) if self.has_wall else None
            commands = (self._command(),) if self.names and self.rng.random() < 0.06 else ()
            if self.rng.random() < 0.05:
                self.undelivered_since_s = self.rng.choice((None, now_s, now_s - 0.3))
            if 0.01 < chance < 0.05:
                yield Observation(
                    now_s=now_s,
                    camera_fault="no frame in time",
                    wall=wall,
                    base=self._base(now_s),
                    operator_commands=commands,
                    undelivered_since_s=self.undelivered_since_s,
                )
                continue
            sequence += 1
            at_s = now_s - 0.01
            yield Observation(
                now_s=now_s,
                frame=FrameStamp(sequence=sequence, captured_at_s=at_s),
                measurements=tuple(self._look(target, at_s) for target in TARGETS),
                wall=wall,
                base=self._base(now_s),
                operator_commands=commands,
                undelivered_since_s=self.undelivered_since_s,
            )

    def _base(self, now_s: float) -> BaseReport | None:
        """A base that loses its link at times; bumps, and a battery that sags around the thresholds."""
        rng = self.rng
        if rng.random() < 0.05:
            return None
        return BaseReport(
            at_s=now_s,
            battery_v=rng.choice((None, 10.7, 10.8, 11.0, 11.1, 11.6)),
            is_bumped=rng.choice((None, False, False, True)),
            is_at_cliff=rng.random() < 0.1,
        )

    def _look(self, target: str, at_s: float) -> Measurement:
        rng = self.rng
        if self.is_aimed and rng.random() < 0.1:
            self.at_m[target] = LIMIT_M + rng.choice((-0.3, 0.15, 0.8))
        elif rng.random() < 0.1:
            self.speed_mps[target] = rng.choice((0.0, 0.0, rng.gauss(0, 1.0)))
        self.at_m[target] = min(max(self.at_m[target] + self.speed_mps[target] * self.step_s, 0.3), 4.0)
        self.gone[target] = self.gone[target] - 1 if self.gone[target] else 0
        if not self.gone[target] and rng.random() < 0.05:
            self.gone[target] = rng.choice((1, 5, 40))
        if self.gone[target]:
            return missed(target, at_s)
        distance_m = max(0.05, rng.gauss(self.at_m[target], self.sigma_m))
        if rng.random() < 0.04:
            distance_m += rng.choice((0.8, 3.0))  # an outlier
        found = measured(target, at_s, distance_m, self.sigma_m, rng.gauss(0.0, 0.1))
        elevation_rad, size_share = rng.gauss(0.0, 0.05), rng.choice((None, 0.2 / distance_m))
        noise_m = self.sigma_m * rng.choice((1.0, 1.0, 0.3))
        return replace(found, noise_m=noise_m, elevation_rad=elevation_rad, size_share=size_share)

    def _command(self) -> OperatorCommand:
        rng = self.rng
        return OperatorCommand(
            id="1",
            action=rng.choice([action for action in OperatorAction if action not in SETTING]),
            rule=rng.choice(("", *self.names)),
            for_s=rng.choice((None, 0.5, 3.0)),
            one_shot=rng.random() < 0.5,
            by="Ada",
        )
