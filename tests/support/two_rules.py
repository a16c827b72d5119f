"""A plan of an alarm that is near and a ramp that is far, for tests of what outlives a run or a configuration."""

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.plan import LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, Lost, RampRule
from support.observing import Rehearsal

NEAR = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=1.0),
    off_delay_s=1.95,
    cooldown_s=0.0,
    lost=Lost(grace_s=0.5, fault_after_s=5.0),
)
FAR = RampRule(name="far", target="ball", output="motor", start=2.0, full=4.0)
TRACKING = Tracking(confirm_frames=2, coast_s=0.15, outliers_max=0, acceleration_mps2=20.0, autocorrelation=0.0)


def plan_of(*rules):
    return Plan(
        targets=("ball",),
        rules=rules,
        outputs=(LevelOutput(name="buzzer"), LevelOutput(name="motor")),
        tracking=TRACKING,
        safety=Safety(good_frames=1),
    )


def rehearse(*rules):
    return Rehearsal(plan_of(*rules))
