"""The table of a pattern of levels, and how it becomes the core's pattern."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.models import Section, Share
from stadimeter.config.units import Duration
from stadimeter.core import rule

SHORTEST_S = 0.05
"""A level changes with a frame at the earliest: at 30 frames a second a shorter one may be passed over."""


def _long_enough(seconds: float) -> float:
    if seconds < SHORTEST_S:
        raise ValueError(
            f"{seconds * 1000:g} ms is too short for a step of a pattern: levels change with the frames; "
            f"choose at least '{SHORTEST_S * 1000:g} ms'"
        )
    return seconds


StepDuration = Annotated[Duration, AfterValidator(_long_enough)]


class PatternStepTable(Section):
    """One level of a pattern."""

    level: Share
    """The level."""
    for_: Annotated[StepDuration, Field(alias="for")]
    """How long it lasts, in seconds, written ``for``."""


class PatternTable(Section):
    """A level that changes by itself; see `stadimeter.core.rule.Pattern`."""

    on: StepDuration | None = None
    """For how long the output is on, in seconds."""
    off: StepDuration | None = None
    """For how long it is off after that."""
    steps: Annotated[list[PatternStepTable], Field(min_length=1, max_length=100)] | None = None
    """Several levels instead of on and off."""
    times: Annotated[int, Field(ge=0)] = 0
    """How often all of it is gone through; 0 for as long as the alarm stands."""

    @model_validator(mode="after")
    def _one_form_only(self) -> Self:
        has_on_and_off = [key for key in ("on", "off") if getattr(self, key) is not None]
        if self.steps is not None and has_on_and_off:
            raise ValueError(f"a pattern with steps has no '{has_on_and_off[0]}'; leave one of the two out")
        if self.steps is None and len(has_on_and_off) < 2:
            raise ValueError('a pattern has on and off, such as { on = "0.2 s", off = "0.3 s" }, or steps')
        return self

    @property
    def period_s(self) -> float:
        """How long it takes to go through all of it, in seconds."""
        return sum(for_s for _, for_s in self.to_plan(level=1.0).steps)

    def to_plan(self, level: float) -> rule.Pattern:
        """Return the pattern as the core sees it.

        Args:
            level: The level while it is on, where the pattern names none.
        """
        if self.steps is not None:
            return rule.Pattern(steps=tuple((step.level, step.for_) for step in self.steps), times=self.times)
        return rule.Pattern(steps=((level, self.on or 0.0), (0.0, self.off or 0.0)), times=self.times)
