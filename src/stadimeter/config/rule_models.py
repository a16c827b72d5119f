"""The tables of rules, and how they become the core's rules. Their defaults are those of `stadimeter.core.plan`."""

from __future__ import annotations

from typing import Annotated, Literal, TypedDict

from pydantic import BeforeValidator, Discriminator, Field, Tag

from stadimeter.config.models import Section, Share
from stadimeter.config.units import Angle, Duration, Length, LengthOrZero, Speed, TurnRate
from stadimeter.core import plan
from stadimeter.core.decision import Severity

_RULE = plan.Rule(name="", target="")
_DISTANCE = plan.DistanceCondition()
_ALARM = plan.AlarmRule(name="", target="", condition=_DISTANCE)
_RAMP = plan.RampRule(name="", target="", start_m=1.0, full_m=2.0)
_FOLLOW = plan.FollowRule(name="", target="", distance_m=1.0)
_LOST = plan.Lost()

PROBABILITY_FOR_SAFETY = 0.5
"""A safety rule acts as soon as danger is as likely as not."""
FRAMES_TO_RAISE = plan.OnDelay(frames=3, of_frames=5)
"""One wrong frame raises nothing, and one missing frame delays nothing. A safety rule does not wait."""

KINDS = ("when", "ramp", "follow")
"""What a rule can be: exactly one of these keys is in its table."""


def _parse_probability(value: object) -> float | None:
    if value == "none":
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise ValueError(f"{value!r} is not a probability between 0 and 1, such as 0.8, and not 'none'")
    return float(value)


def _only_true(value: object) -> bool:
    if value is not True:
        raise ValueError("only true can be written here; the opposite of 'seen = true' is 'lost = true'")
    return value


Flag = Annotated[bool, BeforeValidator(_only_true)]
Quantity = plan.Quantity
Factor = Annotated[float, Field(gt=0)]


class _Common(TypedDict):
    name: str
    target: str
    output: str | None
    priority: int
    severity: Severity
    lost: plan.Lost


class LostTable(Section):
    """What a rule does without its target; see `stadimeter.core.plan.Lost`.

    Attributes:
        grace: In seconds.
        policy: What happens after it.
        fault_after: In seconds.
    """

    grace: Duration = _LOST.grace_s
    policy: Annotated[plan.LostPolicy, Field(strict=False)] = _LOST.policy
    fault_after: Duration = _LOST.fault_after_s

    def to_plan(self) -> plan.Lost:
        """Return the table as the core sees it.

        Returns:
            What the rule does.
        """
        return plan.Lost(grace_s=self.grace, policy=self.policy, fault_after_s=self.fault_after)


class FramesTable(Section):
    """A delay counted in frames.

    Attributes:
        frames: In this many frames the condition must hold.
        of: Of this many newest frames.
    """

    frames: Annotated[int, Field(ge=1)]
    of: Annotated[int, Field(ge=1)]


OnDelay = Annotated[
    Annotated[FramesTable, Tag("in frames")] | Annotated[Duration, Tag("in time")],
    Discriminator(lambda value: "in frames" if isinstance(value, dict | FramesTable) else "in time"),
]


class WhenTable(Section):
    """A condition: on the distance, or on whether the target is in sight.

    Attributes:
        above: In metres; holds when the target is further.
        below: In metres; holds when it is nearer.
        between: In metres, the lower end first.
        seen: Holds while the target is tracked.
        lost: Holds while it is not.
        of: Whether the limits are on the distance or on the depth along the optical axis.
        deadband: In metres; how far the target must come back.
        deadband_sigmas: The same in standard deviations.
        probability: How likely the condition must be to begin; None compares the figures alone.
        probability_off: How likely it may be at most to end.
    """

    above: Length | None = None
    below: Length | None = None
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    seen: Flag | None = None
    lost: Flag | None = None
    of: Quantity = _DISTANCE.quantity
    deadband: LengthOrZero = _DISTANCE.deadband_m
    deadband_sigmas: Annotated[float, Field(ge=0)] = _DISTANCE.deadband_sigmas
    probability: Annotated[float | None, BeforeValidator(_parse_probability)] = _DISTANCE.probability_on
    probability_off: Annotated[float, Field(gt=0, lt=1)] = _DISTANCE.probability_off

    @property
    def limits_m(self) -> tuple[float | None, float | None]:
        """What the distance must be above and below, in metres; None for no such limit."""
        if self.between is not None:
            return self.between[0], self.between[1]
        return self.above, self.below

    def probability_for(self, severity: Severity) -> float | None:
        """Return how likely the condition must be to begin, where that may depend on how much the rule matters.

        Args:
            severity: The rule's severity.

        Returns:
            The probability, or None to compare the figures alone.
        """
        if severity is Severity.SAFETY and "probability" not in self.model_fields_set:
            return PROBABILITY_FOR_SAFETY
        return self.probability

    def to_plan(self, severity: Severity) -> plan.Condition:
        """Return the condition as the core sees it.

        Args:
            severity: The rule's severity, on which a default depends.

        Returns:
            The condition.
        """
        if self.seen or self.lost:
            return plan.PresenceCondition(seen=bool(self.seen))
        above_m, below_m = self.limits_m
        return plan.DistanceCondition(
            above_m=above_m,
            below_m=below_m,
            quantity=self.of,
            deadband_m=self.deadband,
            deadband_sigmas=self.deadband_sigmas,
            probability_on=self.probability_for(severity),
            probability_off=self.probability_off,
        )


class RampTable(Section):
    """An output that grows with distance or with nearness; see `stadimeter.core.plan.RampRule`.

    Attributes:
        start: In metres, written ``from``; where the output begins.
        full: In metres, written ``to``; where it is full.
        of: Whether these are distances or depths along the optical axis.
        min: The level right after the start.
        max: The level at the full end and beyond.
        gamma: Exponent of the curve.
        bias: Which way to err within the standard deviation.
    """

    start: Annotated[LengthOrZero, Field(alias="from")]
    full: Annotated[LengthOrZero, Field(alias="to")]
    of: Quantity = _RAMP.quantity
    min: Share = _RAMP.level_min
    max: Share = _RAMP.level_max
    gamma: Factor = _RAMP.gamma
    bias: plan.Bias = _RAMP.bias

    def to_plan(self, common: _Common) -> plan.RampRule:
        """Return the rule as the core sees it.

        Args:
            common: What every rule has.

        Returns:
            The rule.
        """
        return plan.RampRule(
            **common,
            start_m=self.start,
            full_m=self.full,
            quantity=self.of,
            level_min=self.min,
            level_max=self.max,
            gamma=self.gamma,
            bias=self.bias,
        )


class FollowTable(Section):
    """A base that keeps its distance; see `stadimeter.core.plan.FollowRule`.

    Attributes:
        distance: In metres.
        gain: Forward speed for each metre of distance error, in 1/s.
        turn_gain: Rate of turn for each radian of bearing, in 1/s.
        max_speed: In m/s, forwards.
        max_reverse_speed: In m/s, backwards; 0 never reverses.
        max_turn_rate: In rad/s.
        deadband: In metres.
        turn_deadband: In radians.
    """

    distance: Length
    gain: Factor = _FOLLOW.gain_per_s
    turn_gain: Factor = _FOLLOW.turn_gain_per_s
    max_speed: Speed = _FOLLOW.linear_max_mps
    max_reverse_speed: Speed = _FOLLOW.reverse_max_mps
    max_turn_rate: TurnRate = _FOLLOW.angular_max_radps
    deadband: LengthOrZero = _FOLLOW.deadband_m
    turn_deadband: Angle = _FOLLOW.deadband_rad

    def to_plan(self, common: _Common) -> plan.FollowRule:
        """Return the rule as the core sees it.

        Args:
            common: What every rule has.

        Returns:
            The rule.
        """
        return plan.FollowRule(
            **common,
            distance_m=self.distance,
            gain_per_s=self.gain,
            turn_gain_per_s=self.turn_gain,
            linear_max_mps=self.max_speed,
            reverse_max_mps=self.max_reverse_speed,
            angular_max_radps=self.max_turn_rate,
            deadband_m=self.deadband,
            deadband_rad=self.turn_deadband,
        )


class RuleTable(Section):
    """One rule.

    Attributes:
        target: The target that it watches; may be left out where there is only one.
        actuator: The actuator that it drives, or ``base``; None for an alert only.
        priority: Of several rules that ask something of one output, the highest wins.
        severity: How much its events matter.
        lost: What it does without its target.
        when: A condition to act on.
        ramp: An output that follows the distance.
        follow: A distance that a base keeps.
        on_delay: How long a condition must hold first; in seconds or in frames. None for the default.
        off_delay: How long it must no longer hold; in seconds.
        level: The level of an actuator while the condition holds.
        at_start: Whether an alarm that is raised by the very first sight of the target moves its output.
    """

    target: str | None = None
    actuator: str | None = None
    priority: int = _RULE.priority
    severity: Annotated[Severity, Field(strict=False)] = _RULE.severity
    lost: LostTable = LostTable()
    when: WhenTable | None = None
    ramp: RampTable | None = None
    follow: FollowTable | None = None
    on_delay: OnDelay | None = None
    off_delay: Duration = _ALARM.off_delay_s
    level: Share = _ALARM.level
    at_start: Literal["act", "announce"] = "act" if _ALARM.act_at_start else "announce"

    def to_plan(self, name: str, target: str) -> plan.AnyRule:
        """Return the rule as the core sees it.

        Args:
            name: The rule's name.
            target: The target that it watches, also where the table does not name it.

        Returns:
            The rule.

        Raises:
            ValueError: It is of no kind; the cross-checks find that first.
        """
        common = _Common(
            name=name,
            target=target,
            output=self.actuator,
            priority=self.priority,
            severity=self.severity,
            lost=self.lost.to_plan(),
        )
        if self.when is not None:
            return self._alarm(common, self.when)
        if self.ramp is not None:
            return self.ramp.to_plan(common)
        if self.follow is not None:
            return self.follow.to_plan(common)
        raise ValueError(f"the rule '{name}' has none of: {', '.join(KINDS)}")

    def delay(self) -> plan.OnDelay:
        """Return how long a condition must hold before the alarm is raised.

        Returns:
            The delay; without a word about it three of five frames, and none at all for safety.
        """
        if isinstance(self.on_delay, FramesTable):
            return plan.OnDelay(frames=self.on_delay.frames, of_frames=self.on_delay.of)
        if self.on_delay is not None:
            return plan.OnDelay(hold_s=self.on_delay)
        return plan.OnDelay() if self.severity is Severity.SAFETY else FRAMES_TO_RAISE

    def _alarm(self, common: _Common, when: WhenTable) -> plan.AlarmRule:
        return plan.AlarmRule(
            **common,
            condition=when.to_plan(self.severity),
            on_delay=self.delay(),
            off_delay_s=self.off_delay,
            level=self.level,
            act_at_start=self.at_start == "act",
        )
