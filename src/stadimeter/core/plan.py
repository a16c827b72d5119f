"""What the configuration declares, as the core sees it: in SI units, checked, and fixed for a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from stadimeter.core.decision import Severity


class LostPolicy(StrEnum):
    """What an alarm does when its target has been out of sight for longer than the grace."""

    HOLD = "hold"
    """Stay as it was."""
    CLEAR = "clear"
    """Count as not holding."""
    ASSERT = "assert"
    """Count as holding: "cannot see" means danger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lost:
    """What a rule does without its target.

    Attributes:
        grace_s: For this long nothing changes, and timers stand still.
        policy: What happens then. Ramps and follow rules ignore it: they always go to the safe value.
        fault_after_s: After this long the output goes to its safe value and ``measurement_lost`` is reported.
    """

    grace_s: float = 0.5
    policy: LostPolicy = LostPolicy.HOLD
    fault_after_s: float = 5.0


Quantity = Literal["distance", "depth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceCondition:
    """Whether the target is nearer or further than a limit, judged with the track's standard deviation.

    Attributes:
        above_m: Holds when further than this; None for no such limit.
        below_m: Holds when nearer than this; None for no such limit. With both, it holds between them.
        quantity: Whether the limits are on the straight-line distance or on the depth along the optical axis.
        deadband_m: How far the target must come back before the condition ends.
        deadband_sigmas: The same in standard deviations; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
    """

    above_m: float | None = None
    below_m: float | None = None
    quantity: Quantity = "distance"
    deadband_m: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.8
    probability_off: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PresenceCondition:
    """Whether the target is in sight.

    Attributes:
        seen: True: holds while the target is tracked. False: holds while it is lost or was never seen.
    """

    seen: bool


Condition = DistanceCondition | PresenceCondition


@dataclass(frozen=True, slots=True, kw_only=True)
class OnDelay:
    """How long a condition must hold before the alarm is raised.

    Attributes:
        hold_s: For this long. A frame to the contrary sets the timer back by its own time, not to zero.
        frames: In this many of the newest `of_frames` frames; 0 to judge by time alone.
        of_frames: How many frames are looked at.
    """

    hold_s: float = 0.0
    frames: int = 0
    of_frames: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """What every rule has.

    Attributes:
        name: Its name in the configuration.
        target: The target that it watches.
        output: The output that it drives; None for an alert only.
        priority: Of several rules that ask something of one output, the highest wins.
        severity: How much its events matter.
        lost: What it does without its target.
    """

    name: str
    target: str
    output: str | None = None
    priority: int = 100
    severity: Severity = Severity.WARNING
    lost: Lost = field(default_factory=Lost)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRule(Rule):
    """Act while a condition holds.

    Attributes:
        condition: The condition.
        on_delay: How long it must hold first.
        off_delay_s: How long it must no longer hold before the alarm clears.
        level: The level that an actuator gets while the alarm is active. A base gets a stop.
        act_at_start: Whether an alarm that is raised by the very first sight of the target moves its output.
    """

    condition: Condition
    on_delay: OnDelay = field(default_factory=OnDelay)
    off_delay_s: float = 1.0
    level: float = 1.0
    act_at_start: bool = True


Bias = Literal["neutral", "cautious", "quiet"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RampRule(Rule):
    """Act the more strongly the further, or the nearer, the target is.

    Attributes:
        start_m: Where the output begins. On the other side of it the output is 0.
        full_m: Where the output is full. Larger than `start_m`: grows with distance; smaller: grows with nearness.
        quantity: Whether these are straight-line distances or depths along the optical axis.
        level_min: The level right after the start; a vibration motor does not turn below some level.
        level_max: The level at and beyond `full_m`.
        gamma: Exponent of the curve; 1 is a straight line.
        bias: Which way to err within the standard deviation: ``cautious`` gives the stronger output, ``quiet`` the
            weaker.
    """

    start_m: float
    full_m: float
    quantity: Quantity = "distance"
    level_min: float = 0.0
    level_max: float = 1.0
    gamma: float = 1.0
    bias: Bias = "neutral"


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowRule(Rule):
    """Keep a base at a distance from the target, and pointed at it.

    Attributes:
        distance_m: The distance to keep.
        gain_per_s: Forward speed for each metre of distance error.
        turn_gain_per_s: Rate of turn for each radian of bearing.
        linear_max_mps: Largest speed forwards.
        reverse_max_mps: Largest speed backwards; 0 never reverses.
        angular_max_radps: Largest rate of turn.
        deadband_m: Distance errors below this do not move the base.
        deadband_rad: Bearings below this do not turn it.
    """

    distance_m: float
    gain_per_s: float = 1.0
    turn_gain_per_s: float = 1.5
    linear_max_mps: float = 0.3
    reverse_max_mps: float = 0.0
    angular_max_radps: float = 1.0
    deadband_m: float = 0.03
    deadband_rad: float = 0.03


AnyRule = AlarmRule | RampRule | FollowRule


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelOutput:
    """An actuator, as the core sees it.

    Attributes:
        name: Its name in the configuration.
        safe_level: The level when nothing asks for another, or nothing may.
        rise_per_s: Largest change of the level upwards in a second; infinite for none.
        fall_per_s: Largest change downwards.
    """

    name: str
    safe_level: float = 0.0
    rise_per_s: float = float("inf")
    fall_per_s: float = float("inf")


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseOutput:
    """A base, as the core sees it. Its safe value is to stand still.

    Attributes:
        name: Its name in the configuration.
        linear_max_mps: Largest speed, either way.
        angular_max_radps: Largest rate of turn.
        linear_accel_mps2: Largest change of speed. Slowing down for safety is not limited.
        angular_accel_radps2: Largest change of the rate of turn.
    """

    name: str
    linear_max_mps: float = 0.5
    angular_max_radps: float = 1.5
    linear_accel_mps2: float = 0.5
    angular_accel_radps2: float = 4.0


Output = LevelOutput | BaseOutput


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """How targets are tracked.

    Attributes:
        acceleration_mps2: Standard deviation of the target's acceleration that the filter expects.
        correlation: Correlation of the measurement noise from one frame to the next, 0 to below 1.
        gate_sigmas: A measurement further than this from the prediction is an outlier.
        outliers_max: After this many outliers in a row the target is taken to have jumped, and the track starts anew.
        confirm_frames: How many frames a new target must be measured in before it counts.
        coast_s: For how long a prediction stands in for measurements.
    """

    acceleration_mps2: float = 2.0
    correlation: float = 0.6
    gate_sigmas: float = 4.0
    outliers_max: int = 5
    confirm_frames: int = 2
    coast_s: float = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Safety:
    """When outputs may act.

    Attributes:
        max_frame_age_s: A frame older than this moves nothing.
        good_frames: How many fresh frames in a row are needed at the start, and after frames were stale.
    """

    max_frame_age_s: float = 0.2
    good_frames: int = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Everything that is fixed for a run.

    Attributes:
        targets: The names of the targets.
        rules: The rules, in the order of the configuration.
        outputs: The outputs, in the order of the configuration.
        tracking: How targets are tracked.
        safety: When outputs may act.
    """

    targets: tuple[str, ...]
    rules: tuple[AnyRule, ...] = ()
    outputs: tuple[Output, ...] = ()
    tracking: Tracking = field(default_factory=Tracking)
    safety: Safety = field(default_factory=Safety)
