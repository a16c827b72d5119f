"""What the tables of all kinds of rules share."""

from __future__ import annotations

from typing import Annotated, TypedDict

from pydantic import Discriminator, Field, Tag

from stadimeter.config.models import Section
from stadimeter.config.units import Duration
from stadimeter.core import rule
from stadimeter.core.decision import Severity

_LOST = rule.Lost()

Factor = Annotated[float, Field(gt=0)]


class RuleCommon(TypedDict):
    """What every rule of the core has, whatever its kind; see `stadimeter.core.rule.Rule`."""

    name: str
    target: str
    output: str | None
    priority: int
    severity: Severity
    lost: rule.Lost
    observe: bool


class LostTable(Section):
    """What a rule does without its target; see `stadimeter.core.rule.Lost`."""

    grace: Duration = _LOST.grace_s
    """In seconds."""
    policy: Annotated[rule.LostPolicy, Field(strict=False)] = _LOST.policy
    """What happens after it."""
    fault_after: Duration = _LOST.fault_after_s
    """In seconds."""

    def to_plan(self) -> rule.Lost:
        """Return the table as the core sees it."""
        return rule.Lost(grace_s=self.grace, policy=self.policy, fault_after_s=self.fault_after)


class FramesTable(Section):
    """A delay counted in frames."""

    frames: Annotated[int, Field(ge=1)]
    """In this many frames the condition must hold."""
    of: Annotated[int, Field(ge=1)]
    """Of this many newest frames."""


OnDelay = Annotated[
    Annotated[FramesTable, Tag("in frames")] | Annotated[Duration, Tag("in time")],
    Discriminator(lambda value: "in frames" if isinstance(value, dict | FramesTable) else "in time"),
]
