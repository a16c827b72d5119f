"""Says in plain words how strongly a ramp acts where."""

from __future__ import annotations

from stadimeter.config.units import FOOT_M
from stadimeter.core.rule import RampRule


def strength(rule: RampRule) -> str:
    """Say how strongly a ramp acts where.

    Returns:
        Such as ``when `ball` is further than 3.05 m (10.0 ft), full at 6.10 m (20.0 ft)``.
    """
    along = " along the optical axis" if rule.quantity == "depth" else ""
    dead_zone = f", and not at all below {rule.dead_zone:.0%}" if rule.dead_zone else ""
    if rule.points:
        points = ", ".join(f"{_full(level)} at {_length(at_m)}" for at_m, level in rule.points)
        return f"by the distance of `{rule.target}`{along}: {points}{dead_zone}"
    where = "further" if rule.full_m > rule.start_m else "nearer"
    least = f"at least {rule.level_min:.0%}, " if rule.level_min else ""
    return (
        f"when `{rule.target}` is {where} than {_length(rule.start_m)}{along}, "
        f"{least}{_full(rule.level_max)} at {_length(rule.full_m)}{dead_zone}"
    )


def _full(level: float) -> str:
    return {0.0: "off", 1.0: "full"}.get(level, f"{level:.0%}")


def _length(metres: float) -> str:
    return f"{metres:.2f} m ({metres / FOOT_M:.1f} ft)"
