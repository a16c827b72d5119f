"""Conditions on what is remembered over a window of time: figures with a name, and what other rules did."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_SPEED_MPS
from stadimeter.core.conditions.figures import Uncertain
from stadimeter.core.conditions.leaf import Leaf, RuleInputs, Threshold, back_words
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.summary import RememberedFigure, Window
from stadimeter.core.words import figure_in_words


class RememberedCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A remembered figure is within thresholds, as it was after the cycle before.

    Attributes:
        name: Its name; empty for what other rules did.
        rules: Those rules: any of them. In times, how often they were raised; in seconds, how long they were active.
        window: Within which they did it.
        owner: The rule whose condition it is.
        unit: The SI unit of the thresholds, which is that of the figure.
        quantity: What the figure with a name is of.
        above: Holds above this; None for no such threshold.
        below: Holds below this.
        deadband: How far it must come back before the condition ends.
    """

    name: str = ""
    rules: tuple[str, ...] = ()
    window: Window = Window()
    owner: str = ""
    unit: str = "m"
    quantity: str = "distance"
    above: float | None = None
    below: float | None = None
    deadband: float = 0.0

    is_by_cycle = True
    has_figures = has_noise = False
    section = "figure"
    probability_on = None  # how sure a remembered figure is, is not known
    bounds = (-MAX_SPEED_MPS, MAX_SPEED_MPS)

    @property
    def noun(self) -> str:
        """Its name, or what other rules did, such as ``raises of near within 1 min``."""
        did = "raises" if self.unit == "times" else "active time"
        return f"{did} of {' or '.join(self.rules)} {self.window}" if self.rules else f"figure {self.name}"

    @property
    def is_signed(self) -> bool:
        """True if the figure may be below zero; what others did counts as such, so that it ends at zero."""
        return bool(self.rules) or QUANTITIES[self.quantity].is_signed

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """Those of a figure with a name."""
        return () if self.rules else LimitsCondition.thresholds.__get__(self)

    @property
    def targets_named(self) -> tuple[str, ...]:
        """None: it is known though its target is out of sight."""
        return ()

    @property
    def rules_named(self) -> tuple[str, ...]:
        """Those whose deeds it sums up."""
        return self.rules

    @property
    def key(self) -> str:
        """The name of the figure."""
        return self.name or f"{self.owner}: {self.noun}"

    @property
    def remembered(self) -> RememberedFigure:
        """The sum of what other rules did."""
        return RememberedFigure(
            name=self.key, rules=self.rules, owner=self.owner, quantity=self.unit, statistic="sum", window=self.window
        )

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure, its standard deviation, which is not known, as 0; see `LimitsCondition.uncertain`."""
        value = inputs.figures.get(self.key)
        return None if value is None else (value, 0.0, 0.0)

    @property
    def subject(self) -> str:
        """The figure, or what others did."""
        return f"`{self.noun}` is"

    @property
    def within(self) -> str:
        """The thresholds; of a count, which is above n - 1, the number n itself."""
        low, _ = self.limits
        if self.unit == "times" and math.isfinite(low):
            return f"at least {figure_in_words(low + 1, self.unit)}"
        return Leaf.within.fget(self)  # type: ignore[attr-defined, no-any-return]

    @property
    def ends(self) -> str:
        """A clause on the figures that it must come back to."""
        return f"{self.subject} {back_words(self, self.deadband, self.deadband_sigmas)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:
        """Return the figure and the thresholds; of a count, how many of how many. See `Leaf.verdict`."""
        reading = self.reading(inputs, is_on)
        if reading is not None and self.unit == "times" and math.isfinite(reading.low):
            return f"{' or '.join(self.rules)} raised {reading.value:g} of {reading.low + 1:g} times {self.window}"
        return Leaf.verdict(self, inputs, is_on, names_target=names_target, with_probability=with_probability)

    def unread(self, inputs: RuleInputs, named: str) -> str:  # noqa: ARG002 - it is about no target
        """Return that it is not known."""
        return f"{self.noun} is not known"
