"""Random rules, from a seed."""

from __future__ import annotations

from stadimeter.core.conditions.of_rules import SequenceCondition
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
from support.random_conditions import OTHER_QUANTITIES, RandomConditions


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
