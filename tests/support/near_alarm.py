"""A plain alarm on a ball that is near, and a plan around it in which filters do not blur what a test shows."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.plan import BaseOutput, LevelOutput, Output, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, AnyRule
from support.observing import Rehearsal

NEAR = AlarmRule(
    name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0), off_delay_s=0.2, cooldown_s=0
)
FAR, CLOSE = (3.0,) * 5, (0.5,) * 3
OUTPUTS: tuple[Output, ...] = (LevelOutput(name="buzzer"), LevelOutput(name="lamp"), BaseOutput(name="base"))


def rehearse(
    *rules: AnyRule, outliers_max: int = 0, outputs: tuple[Output, ...] = OUTPUTS, frame_s: float = 0.1, **fields: Any
) -> Rehearsal:
    """Return a rehearsal of some rules, or of the alarm above, with other values in fields of theirs."""
    plan = Plan(
        targets=("ball",),
        rules=tuple(replace(rule, **fields) for rule in rules or (NEAR,)),
        outputs=outputs,
        tracking=Tracking(
            confirm_frames=1, coast_s=0.15, outliers_max=outliers_max, acceleration_mps2=20.0, autocorrelation=0.0
        ),
        safety=Safety(good_frames=1),
    )
    return Rehearsal(plan, frame_s)
