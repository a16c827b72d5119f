"""How fast an output may change, and how far it may go."""

from __future__ import annotations

import math

from stadimeter.core.plan import BaseOutput, LevelOutput


def slewed_level(output: LevelOutput, before: float, wanted: float, step_s: float) -> float:
    """Return the level that an actuator may have now on its way from the one before to the one that is wanted."""
    per_s = output.rise_per_s if wanted > before else output.fall_per_s
    if math.isinf(per_s):
        return wanted
    step = per_s * max(step_s, 0.0)
    return min(max(wanted, before - step), before + step)


def limited_speed(before: float, wanted: float, largest: float, acceleration: float, step_s: float) -> float:
    """Return the speed that a base may have now on its way to the one that is wanted.

    Only speeding up is limited: slowing down always helps. A base that shall go the other way passes through zero.
    """
    wanted = min(max(wanted, -largest), largest)
    start = before if (before > 0) is (wanted > 0) else 0.0
    gain = acceleration * max(step_s, 0.0)
    if wanted > start:
        return min(wanted, start + gain) if wanted > 0 else wanted
    if wanted < start:
        return max(wanted, start - gain) if wanted < 0 else wanted
    return wanted


def limited_twist(
    output: BaseOutput, before: tuple[float, float], wanted: tuple[float, float], step_s: float
) -> tuple[float, float]:
    """Return the speed forwards in m/s and the rate of turn in rad/s that a base may have now."""
    linear_mps = limited_speed(before[0], wanted[0], output.linear_max_mps, output.linear_accel_mps2, step_s)
    angular_radps = limited_speed(before[1], wanted[1], output.angular_max_radps, output.angular_accel_radps2, step_s)
    return linear_mps, angular_radps
