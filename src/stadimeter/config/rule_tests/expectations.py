"""What a test of rules expects of a rule or of an output."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from stadimeter.config.models import Section, Share
from stadimeter.config.rule_tests.motions import SpanTable
from stadimeter.config.units import Duration, Speed
from stadimeter.core.decision import RuleStatus

TOLERANCE = 0.05
"""How far a level may be from the expected one, unless the test says otherwise."""


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


Moment = Annotated[
    Annotated[SpanTable, Tag("throughout")] | Annotated[Duration, Tag("at")],
    Discriminator(lambda value: "throughout" if isinstance(value, dict | SpanTable) else "at"),
]
Moments = Annotated[list[Moment], BeforeValidator(_as_list), Field(min_length=1)]
"""Moments such as ``"3 s"``, stretches of time such as ``{ from = "3 s", for = "2 s" }``, or a list of both."""
Count = Annotated[int, Field(ge=0)]


class LevelAtTable(Section):
    """The level of an actuator at some time.

    Attributes:
        at: In seconds from the start of the test.
        level: What it is, or nearly.
        tolerance: How nearly.
        min: What it is at least.
        max: What it is at most.
    """

    at: Duration
    level: Share | None = None
    tolerance: Share = TOLERANCE
    min: Share | None = None
    max: Share | None = None

    @model_validator(mode="after")
    def _check_level(self) -> LevelAtTable:
        if self.level is None and self.min is None and self.max is None:
            raise ValueError("which level? Add level, or min and max")
        if self.limits[0] > self.limits[1]:
            raise ValueError(f"no level is from {self.limits[0]:g} to {self.limits[1]:g}")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest level that will do."""
        if self.level is not None:
            return self.level - self.tolerance, self.level + self.tolerance
        return 0.0 if self.min is None else self.min, 1.0 if self.max is None else self.max


class ExpectTable(Section):
    """What is expected of a rule or of an output. Times are in seconds from the start of the test.

    Attributes:
        raised: How often the rule is raised, exactly.
        cleared: How often it is cleared, exactly.
        transitions_max: How often it is raised or cleared, at most.
        transitions_per_min_max: The same for each minute of the test.
        raised_by: When it is raised for the first time, at the latest.
        raised_after: When it is raised for the first time, at the earliest.
        raised_within: How soon it is raised after the target truly crosses the rule's limit, at the latest.
        cleared_by: When it is cleared for the first time, at the latest.
        cleared_after: When it is cleared for the first time, at the earliest.
        cleared_within: How soon it is cleared after the target truly leaves the rule's limits, at the latest.
        active_at: When it is active.
        inactive_at: When it is not.
        status: What it is doing at the end.
        acknowledged: Whether, at the end, nobody needs to acknowledge it any more.
        notified: How many of its events people are told of.
        sent: How many messages and notifications it sends.
        level_at: What the level of an actuator is at certain times.
        level_max: What its level never exceeds.
        level_reaches: What its level reaches at some time.
        speed_max: What a base's speed never exceeds, either way, in m/s.
        speed_reaches: What a base's speed reaches at some time, either way, in m/s.
        stopped_at: When the output is at its safe value; for a base that is standing still.
        acts_at: When it is not.
    """

    raised: Count | None = None
    cleared: Count | None = None
    transitions_max: Count | None = None
    transitions_per_min_max: Annotated[float, Field(ge=0)] | None = None
    raised_by: Duration | None = None
    raised_after: Duration | None = None
    raised_within: Duration | None = None
    cleared_by: Duration | None = None
    cleared_after: Duration | None = None
    cleared_within: Duration | None = None
    active_at: Moments | None = None
    inactive_at: Moments | None = None
    status: Annotated[RuleStatus, Field(strict=False)] | None = None
    acknowledged: bool | None = None
    notified: Count | None = None
    sent: Count | None = None
    level_at: Annotated[list[LevelAtTable], BeforeValidator(_as_list), Field(min_length=1)] | None = None
    level_max: Share | None = None
    level_reaches: Share | None = None
    speed_max: Speed | None = None
    speed_reaches: Speed | None = None
    stopped_at: Moments | None = None
    acts_at: Moments | None = None

    def moments(self) -> dict[str, list[float]]:
        """Return every time that is named.

        Returns:
            The times in seconds, by key; of a stretch its end.
        """
        named: dict[str, list[float]] = {}
        for key in ("raised_by", "raised_after", "cleared_by", "cleared_after"):
            if (at_s := getattr(self, key)) is not None:
                named[key] = [at_s]
        for key in ("active_at", "inactive_at", "stopped_at", "acts_at"):
            named[key] = [each.end_s if isinstance(each, SpanTable) else each for each in getattr(self, key) or ()]
        named["level_at"] = [each.at for each in self.level_at or ()]
        return named


OF_ACTUATORS = ("level_at", "level_max", "level_reaches")
OF_BASES = ("speed_max", "speed_reaches")
OF_OUTPUTS = ("stopped_at", "acts_at")
OF_RULES = tuple(key for key in ExpectTable.model_fields if key not in {*OF_ACTUATORS, *OF_BASES, *OF_OUTPUTS})
"""Which keys of the table make sense for what."""
