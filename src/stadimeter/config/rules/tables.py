"""The table of a rule, and how it becomes the core's rules. Its defaults are those of `stadimeter.core.rule`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from stadimeter.config.models import DurationAboveZero, Section, Share
from stadimeter.config.rules.common import FramesTable, LostTable, OnDelay, RuleCommon
from stadimeter.config.rules.condition_tables import WhenTable
from stadimeter.config.rules.follow_tables import FollowTable
from stadimeter.config.rules.pattern_tables import PatternTable
from stadimeter.config.rules.ramp_tables import RampTable
from stadimeter.config.rules.sequence_tables import StepTable
from stadimeter.config.units import Duration
from stadimeter.core import condition, rule
from stadimeter.core.decision import Severity

__all__ = ["KINDS", "FramesTable", "RuleTable", "WhenTable"]

_RULE = rule.Rule(name="", target="")
_DISTANCE = condition.DistanceCondition()
_ALARM = rule.AlarmRule(name="", target="", condition=_DISTANCE)

FRAMES_TO_RAISE = rule.OnDelay(frames=3, of_frames=5)
"""One wrong frame raises nothing, and one missing frame delays nothing."""

KINDS = ("when", "ramp", "follow")
"""What a rule can be: exactly one of these keys is in its table."""


class RuleTable(Section):
    """One rule.

    Attributes:
        target: The target that it watches; may be left out where there is only one.
        targets: Several targets instead: one alarm for each, named after the rule and the target.
        actuator: The actuator that it drives, or ``base``; None for an alert only.
        priority: Of several rules that ask something of one output, the highest wins.
        severity: How much its events matter.
        lost: What it does without its target.
        observe: It is judged, recorded and explained like any other, but drives nothing and sends nothing.
        when: A condition to act on.
        ramp: An output that follows the distance.
        follow: A distance that a base keeps.
        on_delay: How long a condition must hold first; in seconds or in frames. None for the default.
        off_delay: How long it must no longer hold; in seconds.
        level: The level of an actuator while the condition holds.
        pattern: How that level changes while the condition holds.
        at_start: Whether an alarm that is raised by the very first sight of the target moves its output.
        latch: Whether it stays active until somebody resets it.
        ack: Whether somebody must acknowledge it.
        realarm: After being active for this long, in seconds, it is reported again; None for never.
        cooldown: The least time between two notifications, in seconds. None for the default.
        shelve_max: The longest time that it can be shelved for, in seconds; 0 forbids it. None for the default.
        group: Of the alarms of one group, the first one is marked; empty for none.
        suppress_when: While this holds, it drives nothing and notifies nobody.
        then: What else it does, and when.
    """

    target: str | None = None
    targets: Annotated[list[str], Field(min_length=1)] | None = None
    actuator: str | None = None
    priority: int = _RULE.priority
    severity: Annotated[Severity, Field(strict=False)] = _RULE.severity
    lost: LostTable = LostTable()
    observe: bool = _RULE.observe
    when: WhenTable | None = None
    ramp: RampTable | None = None
    follow: FollowTable | None = None
    on_delay: OnDelay | None = None
    off_delay: Duration = _ALARM.off_delay_s
    level: Share = _ALARM.level
    pattern: PatternTable | None = None
    at_start: Literal["act", "announce"] = "act" if _ALARM.act_at_start else "announce"
    latch: bool = _ALARM.latch
    ack: Literal["required", "none"] = "required" if _ALARM.needs_ack else "none"
    realarm: DurationAboveZero | None = None
    cooldown: Duration | None = None
    shelve_max: Duration | None = None
    group: str = _ALARM.group
    suppress_when: WhenTable | None = None
    then: list[StepTable] = Field(default_factory=list)

    def names(self, name: str) -> tuple[str, ...]:
        """Return the names of the rules that the table stands for.

        Args:
            name: The table's name.

        Returns:
            The name itself; with several targets one for each, such as ``near:ball``.
        """
        return (name,) if self.targets is None else tuple(f"{name}:{target}" for target in self.targets)

    def names_every_target(self) -> bool:
        """Return whether every part of its conditions says what it is about, so that the rule itself need not.

        Returns:
            Whether they do; never for a ramp or a follow rule.
        """
        whens = [when.to_plan(self.severity) for when in (self.when, self.suppress_when) if when is not None]
        return self.when is not None and not any("" in condition.targets_of(part) for part in whens)

    def default_target(self, targets: Sequence[str]) -> str:
        """Return the target of a rule that names none: one that its condition is about, or else the first.

        Args:
            targets: Every target, in the order of the file.

        Returns:
            Its name.
        """
        about = condition.targets_of(self.when.to_plan(self.severity)) if self.when is not None else frozenset()
        return next((target for target in targets if target in about), targets[0])

    def to_plans(self, name: str, target: str) -> tuple[rule.AnyRule, ...]:
        """Return every rule that the table stands for, as the core sees them.

        Args:
            name: The table's name.
            target: The target where the table names none.

        Returns:
            One rule; with several targets one for each.

        Raises:
            ValueError: It is of no kind; the cross-checks find that first.
        """
        targets = self.targets or (self.target or target,)
        return tuple(self.to_plan(each, watched) for each, watched in zip(self.names(name), targets, strict=True))

    def to_plan(self, name: str, target: str) -> rule.AnyRule:
        """Return the rule as the core sees it.

        Args:
            name: The rule's name.
            target: The target that it watches, also where the table does not name it.

        Returns:
            The rule.

        Raises:
            ValueError: It is of no kind; the cross-checks find that first.
        """
        common = RuleCommon(
            name=name,
            target=target,
            output=self.actuator,
            priority=self.priority,
            severity=self.severity,
            lost=self.lost.to_plan(),
            observe=self.observe,
        )
        if self.when is not None:
            return self._alarm(common, self.when)
        if self.ramp is not None:
            return self.ramp.to_plan(common)
        if self.follow is not None:
            return self.follow.to_plan(common)
        raise ValueError(f"the rule '{name}' has none of: {', '.join(KINDS)}")

    def delay(self, judged: condition.Condition) -> rule.OnDelay:
        """Return how long a condition must hold before the alarm is raised.

        Args:
            judged: The condition.

        Returns:
            The delay. Without a word about it there is none for safety, nor for what is judged with a probability: that
            has weighed the noise already. Figures that are compared as they are must hold in three of five frames.
        """
        if isinstance(self.on_delay, FramesTable):
            return rule.OnDelay(frames=self.on_delay.frames, of_frames=self.on_delay.of)
        if self.on_delay is not None:
            return rule.OnDelay(hold_s=self.on_delay)
        is_sure = all(leaf.is_sure for leaf in condition.leaves(judged))
        return rule.OnDelay() if is_sure or self.severity is Severity.SAFETY else FRAMES_TO_RAISE

    @property
    def cooldown_s(self) -> float:
        """The least time between two notifications; without a word about it none at all for safety."""
        return self._unless_safety(self.cooldown, _ALARM.cooldown_s)

    @property
    def shelve_max_s(self) -> float:
        """The longest time that it can be shelved for; a safety rule cannot be."""
        return self._unless_safety(self.shelve_max, _ALARM.shelve_max_s)

    def _unless_safety(self, written_s: float | None, default_s: float) -> float:
        if written_s is not None:
            return written_s
        return 0.0 if self.severity is Severity.SAFETY else default_s

    def _alarm(self, common: RuleCommon, when: WhenTable) -> rule.AlarmRule:
        judged = when.to_plan(self.severity)
        return rule.AlarmRule(
            **common,
            condition=judged,
            on_delay=self.delay(judged),
            off_delay_s=self.off_delay,
            level=self.level,
            act_at_start=self.at_start == "act",
            pattern=self.pattern.to_plan(self.level) if self.pattern else None,
            latch=self.latch,
            needs_ack=self.ack == "required",
            realarm_s=self.realarm,
            cooldown_s=self.cooldown_s,
            shelve_max_s=self.shelve_max_s,
            group=self.group,
            suppress_when=self.suppress_when.to_plan(self.severity) if self.suppress_when else None,
            sequence=tuple(step.to_plan() for step in self.then),
        )
