"""Random rules with conditions of every kind, from a seed."""

from __future__ import annotations

import random
from collections.abc import Callable

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_rules import (
    BatteryCondition,
    ContactSensorCondition,
    RuleCondition,
    SequenceCondition,
    UndeliveredCondition,
)
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.decision import Severity
from stadimeter.core.rule import (
    AlarmRule,
    AnyRule,
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
from support.conditions import closing, compared, direction, separation, still

# Random conditions of every kind that is about the targets, the base or the time, from a seed.

TARGETS = ("ball", "tag")
LIMIT_M = 1.5
"""The limit of every distance in an aimed run."""
OTHER_QUANTITIES = (
    "bearing",
    "x",
    "y",
    "z",
    "ahead",
    "left",
    "height",
    "height_above_camera",
    "sideways_speed",
    "speed",
    "closing_speed",
    "size",
)


class RandomConditions:
    """Makes conditions.

    Attributes:
        names: The rules that they may ask for.
    """

    def __init__(self, rng: random.Random, *, is_aimed: bool) -> None:
        self.rng = rng
        self.is_aimed = is_aimed
        self.names: list[str] = []

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
            above=above,
            below=below,
            deadband=self.rng.choice((0.0, 0.2)),
            quantity=self.rng.choice(("distance", "depth")),
            target=self._target(),
            **self._chances(),  # type: ignore[arg-type]
        )

    def _figure(self) -> FigureCondition:
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
            lambda: BatteryCondition(below=rng.choice((10.8, 11.4))),
            lambda: UndeliveredCondition(for_s=rng.choice((0.2, 1.0))),
            lambda: ScheduleCondition(from_s=43200.0, to_s=rng.choice((43203.0, 80000.0))),
        )
        if self.names and rng.random() < (0.35 if self.is_aimed else 0.2):
            return RuleCondition(rule=rng.choice(self.names))
        return rng.choice(kinds[:2] if self.is_aimed and rng.random() < 0.6 else kinds)()

    def _of_both(self) -> Condition:
        """A compound about both targets, with deadbands in which one may stand while the other is out of sight."""
        parts = tuple(
            DistanceCondition(below=LIMIT_M, deadband=0.3, target=target, probability_on=self.rng.choice((0.7, None)))
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


# Random rules, from a seed.


class RandomRules(RandomConditions):
    """Makes rules."""

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
