"""Why each rule does what it does, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from stadimeter.core.plan import AlarmRule, AnyRule, FollowRule, RampRule
from stadimeter.core.rules import alarm, follow, ramp
from stadimeter.core.rules.alarm import AlarmStep
from stadimeter.core.rules.judging import RuleStep
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reasons(Mapping[str, str]):
    """The reason of each rule, by its name. Put into words when it is read: a hundred at every frame cost too much.

    Attributes:
        rules: The rules.
        steps: What each of them does.
        tracks: The targets, by name.
        now_s: The run's monotonic clock.
    """

    rules: tuple[AnyRule, ...]
    steps: tuple[RuleStep, ...]
    tracks: Mapping[str, Track]
    now_s: float

    def __getitem__(self, name: str) -> str:
        for rule, step in zip(self.rules, self.steps, strict=True):
            if rule.name == name:
                return self._why(rule, step)
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return (rule.name for rule in self.rules)

    def __len__(self) -> int:
        return len(self.rules)

    def _why(self, rule: AnyRule, step: RuleStep) -> str:
        track = self.tracks[rule.target]
        match rule, step:
            case AlarmRule(), AlarmStep():
                return alarm.why(rule, step.state, track, self.now_s)
            case RampRule(), _:
                return ramp.why(rule, track)
            case FollowRule(), _:
                return follow.why(rule, track)
            case _:
                raise TypeError(f"rule {rule.name} remembers a {type(step).__name__}")
