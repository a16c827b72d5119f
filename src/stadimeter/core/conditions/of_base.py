"""Conditions on what a robot base reports of itself: its bumper, what is below it, and its battery."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct

from stadimeter.core.bounds import MAX_VOLTAGE_V
from stadimeter.core.conditions.figures import Uncertain
from stadimeter.core.conditions.leaf import ANSWERS, Leaf, RuleInputs, Threshold
from stadimeter.core.conditions.limits import LimitsCondition

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
