"""Conditions on what a robot base reports of itself: its bumper, what is below it, and its battery."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct

from stadimeter.core.bounds import MAX_VOLTAGE_V
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, JudgedFigure, Leaf, Rest, RuleInputs, Threshold

# A motor that starts pulls the voltage of its battery down, and lets it go again: some tenths of a volt with small
# motors. Without this an alarm would come and go with each start.
BATTERY_DEADBAND_V = 0.3


class ContactSensorCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A sensor of the base answers yes. Unknown for a base that has none, or is out of order."""

    sensor: Literal["is_bumped", "is_at_cliff"]

    is_by_cycle = True

    @property
    def noun(self) -> str:
        """What the sensor tells of."""
        return "bumper" if self.sensor == "is_bumped" else "cliff"

    @property
    def limits(self) -> tuple[float, float]:
        """Its answer counts as 1 or 0."""
        return 0.5, math.inf

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - it has no hysteresis
        """Return the sensor's answer; see `Leaf.holds`."""
        return None if inputs.base is None else getattr(inputs.base, self.sensor)

    def figures(self) -> tuple[Figure, ...]:
        """Return the answer, 1 or 0."""
        return (Figure(_reported, (self.sensor,)),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is until the answer changes."""
        answer = _reported(inputs, self.sensor)
        return Rest(((self.figures()[0], answer, answer),))


class BatteryCondition(Leaf, Struct, frozen=True, kw_only=True):
    """The voltage of the base's battery is below a threshold."""

    below_v: float

    noun = "battery voltage"
    unit = "V"
    is_by_cycle = True

    @property
    def limits(self) -> tuple[float, float]:
        """In volts; there is no lower one."""
        return -math.inf, self.below_v

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The voltage."""
        return (Threshold("battery_below", "below_v", 0.0, MAX_VOLTAGE_V),)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Return whether it holds; None while the voltage is not known."""
        battery_v = _reported(inputs, "battery_v")
        return None if battery_v == UNKNOWN else battery_v < self._threshold_v(is_on)

    def figures(self) -> tuple[Figure, ...]:
        """Return the voltage."""
        return (Figure(_reported, ("battery_v",)),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:
        """Return that it stays as it is until the voltage crosses the threshold, comes or goes."""
        battery_v, figure, threshold_v = _reported(inputs, "battery_v"), self.figures()[0], self._threshold_v(is_on)
        if battery_v == UNKNOWN:
            return Rest(((figure, UNKNOWN, UNKNOWN),))
        if battery_v < threshold_v:
            return Rest(((figure, math.nextafter(UNKNOWN, 0.0), math.nextafter(threshold_v, UNKNOWN)),))
        return Rest(((figure, threshold_v, math.inf),))

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the voltage and the threshold; None while it is not known."""
        battery_v = _reported(inputs, "battery_v")
        return None if battery_v == UNKNOWN else JudgedFigure(value=battery_v, high=self._threshold_v(is_on))

    def _threshold_v(self, is_on: bool) -> float:
        return self.below_v + (BATTERY_DEADBAND_V if is_on else 0.0)


def _reported(inputs: RuleInputs, field: str) -> float:
    value = None if inputs.base is None else getattr(inputs.base, field)
    return UNKNOWN if value is None else float(value)
