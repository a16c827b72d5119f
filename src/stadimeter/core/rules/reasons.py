"""Why each rule does what it does, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from stadimeter.core.alarms import actions
from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule
from stadimeter.core.rules import follow, ramp
from stadimeter.core.rules.scheduler import EvaluatedRules, RuleStep


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reasons(Mapping[str, str]):
    """The reason of each rule, by its name. Put into words when it is read: a hundred at every frame cost too much."""

    plan: Plan
    judged: EvaluatedRules
    inputs: RuleInputs

    def __getitem__(self, name: str) -> str:
        rule, step = self.step(name)
        match rule, step:
            case AlarmRule(), AlarmStep():
                return actions.why(rule, step.state, self.inputs_of_rules())
            case RampRule(), _:
                return ramp.why(rule, self.inputs.tracks[rule.target])
            case FollowRule(), _:
                return follow.why(rule, self.inputs.tracks[rule.target])
            case _:
                raise TypeError(f"rule {rule.name} remembers a {type(step).__name__}")

    def __iter__(self) -> Iterator[str]:
        return (rule.name for rule in self.plan.rules)

    def __len__(self) -> int:
        return len(self.plan.rules)

    def step(self, name: str) -> tuple[AnyRule, RuleStep]:
        """Return a rule and what it does.

        Raises:
            KeyError: There is no such rule.
        """
        position = self.judged.layout.positions[name]
        return self.plan.rules[position], self.judged.steps[position]

    def inputs_of_rules(self) -> RuleInputs:
        """Return all that the rules were judged by, with which of them are active."""
        return replace(self.inputs, active=self.judged.active)
