"""Expectations of a rule test: of a rule or of an output."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from stadimeter.config.models import DurationAboveZero, Section, Share
from stadimeter.config.units import Duration, Speed
from stadimeter.core.decision import RuleStatus

TOLERANCE = 0.05
"""How far a level may be from the expected one, unless the test says otherwise."""


class SpanTable(Section):
    """A stretch of time."""

    start: Annotated[Duration, Field(alias="from")]
    """When it begins, written ``from``; in seconds from the start of the test."""
    duration: Annotated[DurationAboveZero, Field(alias="for")]
    """How long it is, written ``for``; in seconds."""

    @property
    def end_s(self) -> float:
        """When it ends, in seconds from the start of the test."""
        return self.start + self.duration

    def holds(self, at_s: float) -> bool:
        """Return whether a moment lies in it.

        Args:
            at_s: The moment, in seconds from the start of the test.

        Returns:
            Whether it does; the end itself does not.
        """
        return self.start <= at_s < self.end_s


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
    """The level of an actuator at some time."""

    at: Duration
    """In seconds from the start of the test."""
    level: Share | None = None
    """What it is, or nearly."""
    tolerance: Share = TOLERANCE
    """How nearly."""
    min: Share | None = None
    """What it is at least."""
    max: Share | None = None
    """What it is at most."""

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
    """What is expected of a rule or of an output. Times are in seconds from the start of the test."""

    raised: Count | None = None
    """How often the rule is raised, exactly."""
    cleared: Count | None = None
    """How often it is cleared, exactly."""
    transitions_max: Count | None = None
    """How often it is raised or cleared, at most."""
    transitions_per_min_max: Annotated[float, Field(ge=0)] | None = None
    """The same for each minute of the test."""
    raised_by: Duration | None = None
    """When it is raised for the first time, at the latest."""
    raised_after: Duration | None = None
    """When it is raised for the first time, at the earliest."""
    raised_within: Duration | None = None
    """How soon it is raised after the target truly crosses the rule's limit, at the latest."""
    cleared_by: Duration | None = None
    """When it is cleared for the first time, at the latest."""
    cleared_after: Duration | None = None
    """When it is cleared for the first time, at the earliest."""
    cleared_within: Duration | None = None
    """How soon it is cleared after the target truly leaves the rule's limits, at the latest."""
    active_at: Moments | None = None
    """When it is active."""
    inactive_at: Moments | None = None
    """When it is not."""
    status: Annotated[RuleStatus, Field(strict=False)] | None = None
    """What it is doing at the end."""
    acknowledged: bool | None = None
    """Whether, at the end, nobody needs to acknowledge it any more."""
    notified: Count | None = None
    """How many of its events people are told of."""
    sent: Count | None = None
    """How many messages and notifications it sends."""
    level_at: Annotated[list[LevelAtTable], BeforeValidator(_as_list), Field(min_length=1)] | None = None
    """What the level of an actuator is at certain times."""
    level_max: Share | None = None
    """What its level never exceeds."""
    level_reaches: Share | None = None
    """What its level reaches at some time."""
    speed_max: Speed | None = None
    """What a base's speed never exceeds, either way, in m/s."""
    speed_reaches: Speed | None = None
    """What a base's speed reaches at some time, either way, in m/s."""
    stopped_at: Moments | None = None
    """When the output is at its safe value; for a base that is standing still."""
    acts_at: Moments | None = None
    """When it is not."""

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
"""Keys of the table, by what they can be expected of."""
