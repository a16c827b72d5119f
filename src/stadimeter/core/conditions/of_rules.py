"""Conditions on other rules: that one is active, that several were raised in an order, that an alarm is undelivered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Literal

from msgspec import Struct

from stadimeter.core.bounds import MAX_VOLTAGE_V
from stadimeter.core.conditions.leaf import ANSWERS, JudgedFigure, Leaf, RuleInputs, Threshold
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.quantities import Uncertain
from stadimeter.core.words import duration

# Conditions on what a robot base reports of itself: its bumper, what is below it, and its battery ---------------------

# A motor that starts pulls the voltage of its battery down, and lets it go again: some tenths of a volt with small
# motors. Without this an alarm would come and go with each start.
BATTERY_DEADBAND_V = 0.3


class ContactSensorCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A sensor of the base answers yes. Unknown for a base that has none, or is out of order."""

    sensor: Literal["is_bumped", "is_at_cliff"]

    is_by_cycle = True
    has_noise = False

    @property
    def noun(self) -> str:
        """The thing the sensor tells of."""
        return "bumper" if self.sensor == "is_bumped" else "cliff"

    @property
    def limits(self) -> tuple[float, float]:
        """Its answer counts as 1 or 0."""
        return 0.5, math.inf

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - it has no hysteresis
        """Return the sensor's answer; see `Leaf.holds`."""
        return None if inputs.base is None else getattr(inputs.base, self.sensor)

    @property
    def begins(self) -> str:
        """A clause on what the sensor tells."""
        is_bumper = self.sensor == "is_bumped"
        return "the bumper of the base is pressed" if is_bumper else "there is no floor below the base"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the sensor's answer; see `Leaf.verdict`."""
        return f"{self.begins}: {ANSWERS[self.holds(inputs, is_on)]}"


class BatteryCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """The voltage of the base's battery is below a threshold, in volts. Unknown for a base that does not report it."""

    below: float

    above = None
    deadband = BATTERY_DEADBAND_V
    noun = "battery voltage"
    unit = "V"
    is_by_cycle = True
    has_figures = False
    section = "base"
    targets_named = ()

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The voltage."""
        return (Threshold("base.battery_below", "below", 0.0, MAX_VOLTAGE_V),)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the voltage, its standard deviation, which is not known, as 0; see `LimitsCondition.uncertain`."""
        battery_v = None if inputs.base is None else inputs.base.battery_v
        return None if battery_v is None else (battery_v, 0.0, 0.0)


# What is in time is in time, however a difference of times was rounded.
_ROUNDING_S = 1e-6

_RULE_STATES = {True: "is active", False: "is not active", None: "has nothing to judge by"}


class RuleCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition that another rule is active. Unknown while that rule has nothing to judge by."""

    rule: str

    noun = "rule"
    is_by_cycle = True
    has_noise = False

    @property
    def rules_named(self) -> tuple[str, ...]:
        """That rule."""
        return (self.rule,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`."""
        return inputs.active.get(self.rule)

    @property
    def begins(self) -> str:
        """The rule."""
        return f"`{self.rule}` is active"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the state of the rule; see `Leaf.verdict`."""
        return f"the rule {self.rule} {_RULE_STATES[inputs.active.get(self.rule)]}"


class SequenceCondition(Leaf, Struct, frozen=True, kw_only=True):
    """Rules were raised in this order, each after the one before, from the first to the last within a time.

    What counts of each is when it was raised last. It is noted once, when the last is raised: what the others do later
    changes nothing.

    Attributes:
        rules: Two or more.
        for_s: It holds for this long since the last was raised; None for as long as that rule is active.
    """

    rules: tuple[str, ...]
    within_s: float
    for_s: float | None = None

    noun = "order of rules"
    is_by_cycle = is_always_known = True
    has_noise = False

    @property
    def rules_named(self) -> tuple[str, ...]:
        """The rules, in their order."""
        return self.rules

    @property
    def key(self) -> str:
        """The key that its completion is remembered by."""
        return f"{' then '.join(self.rules)} within {self.within_s!r} s"

    def is_complete(self, raised_at_s: Mapping[str, float]) -> bool:
        """Check whether the rules were raised in their order, in time."""
        times = [raised_at_s.get(rule, math.nan) for rule in self.rules]
        in_order = all(before < after for before, after in pairwise(times))
        return in_order and times[-1] - times[0] <= self.within_s + _ROUNDING_S

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; None while its last rule, a ramp or one that follows, has nothing to judge by."""
        at_s, last = inputs.raised_at_s.get(self.key), self.rules[-1]
        if at_s is None:
            return False
        if self.for_s is not None:
            return inputs.now_s < at_s + self.for_s
        return at_s == inputs.raised_at_s.get(last) and inputs.active.get(last)

    @property
    def begins(self) -> str:
        """The rules, in their order, and the time."""
        names = " and then ".join(f"`{rule}`" for rule in self.rules)
        lasts = "" if self.for_s is None else f", for {duration(self.for_s)} from then on"
        return f"{names} are raised within {duration(self.within_s)}{lasts}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the times at which the rules were raised last; see `Leaf.verdict`."""
        ago = [
            f"{rule} was raised {inputs.now_s - at_s:.1f} s ago" if at_s is not None else f"{rule} was not raised"
            for rule, at_s in ((rule, inputs.raised_at_s.get(rule)) for rule in self.rules)
        ]
        return f"{', '.join(ago)}; in this order within {duration(self.within_s)}"


class UndeliveredCondition(Leaf, Struct, frozen=True, kw_only=True):
    """An alarm's message or notification has waited for this long, and neither broker nor service has taken it.

    It is never unknown: a run without a messenger has nothing to deliver.
    """

    for_s: float

    noun = "undelivered alarm"
    unit = "s"
    is_by_cycle = is_always_known = True
    has_noise = False

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds."""
        return self.for_s, math.inf

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; see `Leaf.holds`."""
        since_s = inputs.undelivered_since_s
        return since_s is not None and inputs.now_s >= since_s + self.for_s

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds the oldest alarm waits; None for none."""
        since_s = inputs.undelivered_since_s
        return None if since_s is None else JudgedFigure(value=inputs.now_s - since_s, low=self.for_s)

    @property
    def begins(self) -> str:
        """The time."""
        return f"an alarm is undelivered for {duration(self.for_s)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return for how long the oldest alarm waits; see `Leaf.verdict`."""
        reading = self.reading(inputs, is_on)
        if reading is None:
            return "no alarm is undelivered"
        return f"an alarm is undelivered for {reading.value:.1f} s of {self.for_s:g} s"
