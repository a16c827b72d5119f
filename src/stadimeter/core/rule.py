"""The declarations of a rule, as the core sees them: in SI units, checked, and fixed for a run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import force_setattr, replace

from stadimeter.core.conditions.compounds import AllOf, Condition, about
from stadimeter.core.conditions.quantities import QuantityName
from stadimeter.core.decision import RuleStatus, RuleTrace, Severity

# What is due this soon is due, however a sum of times was rounded.
ROUNDING_S = 1e-6


class LostPolicy(StrEnum):
    """Behaviour of an alarm when its target has been out of sight for longer than the grace."""

    HOLD = "hold"
    """Stay as it was."""
    CLEAR = "clear"
    """Count as not holding."""
    ASSERT = "assert"
    """Count as holding: "cannot see" means danger."""


class Lost(Struct, frozen=True, kw_only=True):
    """Behaviour of a rule without its target.

    Attributes:
        grace_s: For this long nothing changes, and timers stand still.
        policy: What happens then. Ramps and follow rules ignore it: they always go to the safe value.
        fault_after_s: After this long the output goes to its safe value and ``measurement_lost`` is reported.
    """

    grace_s: float = 0.5
    policy: LostPolicy = LostPolicy.HOLD
    fault_after_s: float = 5.0


class OnDelay(Struct, frozen=True, kw_only=True):
    """Time for which a condition must hold before the alarm is raised.

    Attributes:
        hold_s: Throughout this time, apart from noise; see `DelayTolerance`.
        frames: In this many of the newest `of_frames` frames; 0 to judge by time alone.
        of_frames: How many frames are looked at.
    """

    hold_s: float = 0.0
    frames: int = 0
    of_frames: int = 0


class DelayTolerance(Struct, frozen=True, kw_only=True):
    """Samples to the contrary that are forgiven as noise while a delay runs: this many in a row, or for this long.

    Attributes:
        samples: This many in a row, however far they are apart.
        for_s: Any number, if the newest comes this soon after the last sample that was not to the contrary; 0: none.
    """

    samples: int = 1
    for_s: float = 0.15

    def forgives(self, samples: int, for_s: float) -> bool:
        """Check whether samples in a row are forgiven."""
        return samples <= self.samples or (self.for_s > 0 and for_s <= self.for_s + ROUNDING_S)


class Rule(Struct, frozen=True, kw_only=True):
    """Fields that every rule has.

    Attributes:
        name: Its name in the configuration.
        target: The target that it watches.
        output: The output that it drives; None for an alert only.
        priority: Of several rules that ask something of one output, the highest wins.
        severity: How much its events matter.
        lost: What it does without its target.
        observe: It is judged, recorded and explained like any other, but drives nothing and sends nothing.
    """

    name: str
    target: str
    output: str | None = None
    priority: int = 100
    severity: Severity = Severity.WARNING
    lost: Lost = field(default_factory=Lost)
    observe: bool = False


class Pattern(Struct, frozen=True, kw_only=True):
    """A level that changes by itself while an alarm stands, such as three short buzzes.

    Attributes:
        steps: Level, 0 to 1, and how long it lasts in seconds; at least one.
        times: How often the steps are gone through; 0 for as long as the alarm stands. The level is 0 afterwards.
    """

    steps: tuple[tuple[float, float], ...]
    times: int = 0

    def level(self, since_s: float) -> float:
        """Return the level, 0 to 1, some time after the beginning."""
        period_s = sum(for_s for _, for_s in self.steps)
        since_s = max(0.0, since_s) + ROUNDING_S
        if self.times and since_s >= self.times * period_s:
            return 0.0
        left_s = since_s % period_s
        for level, for_s in self.steps:
            if left_s < for_s:
                return level
            left_s -= for_s
        return self.steps[-1][0]  # what rounding left over


class Template(Struct, frozen=True, kw_only=True):
    """A text with named gaps, such as ``{rule}: {distance_m:.2f} m``.

    Attributes:
        text: The text; for JSON an object or a list as JSON, with gaps in its strings.
        is_json: Whether it is JSON.
    """

    text: str
    is_json: bool = False


class Send(Struct, frozen=True, kw_only=True):
    """Something to send: over the messenger, or to people with a notifier.

    Attributes:
        template: What.
        topic: The messenger's topic, below its base topic; empty for a notifier.
        notifier: The name of the notifier; empty for the messenger.
        title: The title of a notification; empty for the rule's name.
        retain: Whether the broker keeps it.
    """

    template: Template
    topic: str = ""
    notifier: str = ""
    title: str = ""
    retain: bool = False


class EscalationStep(Struct, frozen=True, kw_only=True):
    """Something that an alarm does, once, after it was raised or cleared.

    What is not due yet when an alarm clears is not done any more; likewise for steps after clearing, when it is raised.

    Attributes:
        on: After being raised, or after being cleared.
        after_s: How long after.
        only_unacknowledged: Not if the alarm was acknowledged by then.
        output: An output that it drives; None for none.
        level: The level that an actuator gets. A base gets a stop.
        pattern: Levels that change by themselves, in place of `level`; None for none.
        for_s: For how long; infinite for as long as the alarm stands, which after clearing is no time at all.
        send: What it sends; None for nothing.
        when: A condition that is judged once, when the step is due; None for always. If it does not hold, the step is
            left out; if that is not known, what it sends is sent, and its output does not act.
    """

    on: Literal["raised", "cleared"] = "raised"
    after_s: float = 0.0
    only_unacknowledged: bool = False
    output: str | None = None
    level: float = 1.0
    pattern: Pattern | None = None
    for_s: float = math.inf
    send: Send | None = None
    when: Condition | None = None


# An alarm that is raised more often within a minute chatters, unless its configuration says otherwise.
RAISES_PER_MIN_MAX = 10


class AlarmRule(Rule, Struct, frozen=True, kw_only=True):
    """Act while a condition holds.

    Attributes:
        condition: The condition. Parts of it that name no target are about the rule's target.
        on_delay: How long it must hold first.
        off_delay_s: How long it must no longer hold, throughout, before the alarm clears.
        delay_tolerance: What does not start these delays over.
        level: The level that an actuator gets while the alarm is active. A base gets a stop.
        at_start: Whether an alarm that is raised by the very first sight of the target moves its output, or is only
            announced.
        pattern: Levels that change by themselves while the alarm is active, in place of `level`; None for none.
        latch: It stays active until it is reset, though its condition may have ended.
        ack_resets: Of one that latches, an acknowledgement resets it too, now or as soon as its condition ends.
        ack: Whether a person must acknowledge it; until then it is not over, even when its condition has ended.
        realarm_s: After being active for this long it is reported again, and unacknowledged again; None for never.
        cooldown_s: The least time between two notifications of the rule. What the alarm does is not delayed.
        shelve_max_s: The longest time that it can be shelved for; 0 forbids shelving.
        raises_per_min_max: An alarm that came so often within a minute chatters: it stays active until it has calmed
            down. 0 for no such limit.
        group: Of the alarms of one group, the first one is marked until all have cleared; empty for none.
        suppress_when: While this holds, the alarm drives nothing and notifies no one; None for never.
        escalation: What else it does, and when.
    """

    condition: Condition
    on_delay: OnDelay = field(default_factory=OnDelay)
    off_delay_s: float = 1.0
    delay_tolerance: DelayTolerance = field(default_factory=DelayTolerance)
    level: float = 1.0
    at_start: Literal["act", "announce"] = "act"
    pattern: Pattern | None = None
    latch: bool = False
    ack_resets: bool = False
    ack: Literal["required", "none"] = "none"
    realarm_s: float | None = None
    cooldown_s: float = 10.0
    shelve_max_s: float = 8 * 3600.0
    raises_per_min_max: int = RAISES_PER_MIN_MAX
    group: str = ""
    suppress_when: Condition | None = None
    escalation: tuple[EscalationStep, ...] = ()

    def __post_init__(self) -> None:
        """Make every part of the conditions name its target."""
        force_setattr(self, "condition", about(self.condition, self.target, self.name))
        if self.suppress_when is not None:
            force_setattr(self, "suppress_when", about(self.suppress_when, self.target, self.name))
        if any(step.when is not None for step in self.escalation):
            steps = [
                step if step.when is None else replace(step, when=about(step.when, self.target, self.name))
                for step in self.escalation
            ]
            force_setattr(self, "escalation", tuple(steps))


# A condition that always holds.
ALWAYS = AllOf(conditions=())


class GatedRule(Rule, Struct, frozen=True, kw_only=True):
    """A rule that acts all the time, in proportion to something, or at times, as far as its gate lets it.

    Attributes:
        gate: An alarm without delays that drives nothing: the rule acts only while its condition holds. What keeps an
            alarm quiet keeps the rule quiet. Its name, target, severity and `observe` are those of the rule.
    """

    gate: AlarmRule = AlarmRule(name="", target="", condition=ALWAYS)

    def __post_init__(self) -> None:
        """Make the gate one of this rule."""
        force_setattr(self, "gate", self.owning(self.gate))

    def owning(self, gate: AlarmRule) -> AlarmRule:
        """Return a gate as one of this rule."""
        return replace(gate, name=self.name, target=self.target, severity=self.severity, observe=self.observe)


Bias = Literal["neutral", "cautious", "quiet"]


class RampRule(GatedRule, Struct, frozen=True, kw_only=True):
    """Act the more strongly the larger, or the smaller, a quantity of the target is, such as its distance.

    Attributes:
        start: Where the output begins, in the SI unit of the quantity. On the other side of it the output is 0.
        full: Where the output is full. Larger than `start`: grows with the quantity; smaller: as it gets less.
        quantity: What it goes by.
        level_min: The level right after the start; a vibration motor does not turn below some level.
        level_max: The level at and beyond `full`.
        gamma: Exponent of the curve; 1 is a straight line.
        bias: Which way to err within the standard deviation: ``cautious`` gives the stronger output, ``quiet`` the
            weaker.
        points: A table instead of a curve: figures in the SI unit, in order, and the level at each; between them the
            level is interpolated, and beyond the ends it stays. Empty for the curve.
        dead_zone: Levels below this are 0.
    """

    start: float
    full: float
    quantity: QuantityName = "distance"
    level_min: float = 0.0
    level_max: float = 1.0
    gamma: float = 1.0
    bias: Bias = "neutral"
    points: tuple[tuple[float, float], ...] = ()
    dead_zone: float = 0.0


class Search(Struct, frozen=True, kw_only=True):
    """The way a base that has lost its target turns to find it: in steps, since a picture taken in a turn is blurred.

    Attributes:
        angle_rad: It turns no further than this, to the side where the target was last.
        for_s: It searches for no longer than this.
        step_rad: It turns by this, then looks; less than the camera sees.
        rate_radps: How fast it turns.
        look_s: How long it looks: enough for the wheels to stand and a target to be confirmed.
        hidden_s: A target that was lost in the middle of the view is hidden rather than gone: it waits for this long
            before it turns.
    """

    angle_rad: float = 2 * math.pi
    for_s: float = 20.0
    step_rad: float = math.pi / 6
    rate_radps: float = 0.8
    look_s: float = 0.4
    hidden_s: float = 1.5


class SlowNear(Struct, frozen=True, kw_only=True):
    """A second target near which a base drives forwards more slowly.

    Attributes:
        start_m: From this distance on it is slower.
        full_m: At this distance it stands; between them its largest speed is in proportion.
    """

    target: str
    start_m: float
    full_m: float


class FollowRule(GatedRule, Struct, frozen=True, kw_only=True):
    """Keep a base at a distance from the target, and pointed at it.

    Attributes:
        distance_m: The distance to keep.
        gain_per_s: Forward speed for each metre of distance error; None for as much as the delay allows.
        turn_gain_per_s: Rate of turn for each radian of bearing; None likewise.
        delay_s: From the picture until the wheels obey; None for the age of the frames and what wheels mostly take.
        linear_max_mps: Largest speed forwards.
        reverse_max_mps: Largest speed backwards; 0 never reverses.
        angular_max_radps: Largest rate of turn.
        deadband_m: Distance errors below this do not move the base.
        deadband_rad: Bearings below this do not turn it.
        search: What it does when the target is lost; None for standing still.
        tether_m: It drives no further than this from where it began; None for any distance.
        slow: A target near which it is slow; None for none.
    """

    distance_m: float
    gain_per_s: float | None = None
    turn_gain_per_s: float | None = None
    delay_s: float | None = None
    linear_max_mps: float = 0.3
    reverse_max_mps: float = 0.0
    angular_max_radps: float = 1.0
    deadband_m: float = 0.03
    deadband_rad: float = 0.03
    search: Search | None = field(default_factory=Search)
    tether_m: float | None = None
    slow: SlowNear | None = None


class ReportRule(GatedRule, Struct, frozen=True, kw_only=True):
    """Send messages at times, those of the steps of its gate. It drives nothing, and is never active.

    Attributes:
        every_s: Once within this time, from the first cycle on; None for one that goes by the time of day.
        at_seconds: At these seconds of the day, local time.
    """

    every_s: float | None = None
    at_seconds: tuple[float, ...] = ()


AnyRule = AlarmRule | RampRule | FollowRule | ReportRule


def gate_of(rule: AnyRule) -> AlarmRule:
    """Return the part of a rule that operators may keep quiet: an alarm itself, or the gate of another rule."""
    return rule if isinstance(rule, AlarmRule) else rule.gate


def conditions_of(rule: AnyRule) -> Iterator[Condition]:
    """Go through the conditions that a rule, or its gate, is judged by, and those of its steps."""
    alarm = gate_of(rule)
    yield alarm.condition
    for condition in (alarm.suppress_when, *(step.when for step in alarm.escalation)):
        if condition is not None:
            yield condition


# The step of one rule in a cycle: what it does, and wants of outputs --------------------------------------------------

# The inhibit of a rule that is only observed.
OBSERVED = "observed"


class LevelRequest(Struct, frozen=True, kw_only=True, tag=True):
    """A rule wants an actuator to act, at a level from 0 to 1. Of several requests the highest priority wins.

    With `by`, a person who holds the output wants it, and no rule; likewise below.
    """

    rule: str
    output: str
    priority: int
    level: float
    by: str = ""


class TwistRequest(Struct, frozen=True, kw_only=True, tag=True):
    """A rule wants a base to move, or to stand still; signs as of `TwistCommand`.

    With `is_gentle`, it slows down no faster than it speeds up; else it stands as soon as it shall.
    """

    rule: str
    output: str
    priority: int
    linear_mps: float
    angular_radps: float
    tilt_radps: float = 0.0
    by: str = ""
    is_gentle: bool = False


Request = LevelRequest | TwistRequest


class Step(Struct, frozen=True, kw_only=True):
    """The step of a rule in one cycle. The same object is kept from cycle to cycle while nothing about it changes."""

    trace: RuleTrace
    requests: tuple[Request, ...] = ()


def trace_of(
    rule: Rule, status: RuleStatus, before: RuleTrace | None = None, inhibits: tuple[str, ...] | None = None
) -> RuleTrace:
    """Return the trace of a rule that is active while it acts.

    Args:
        inhibits: What keeps it quiet, in words; None for no more than its own `observe`.
    """
    active = None if status is RuleStatus.UNKNOWN else status is RuleStatus.ACTIVE
    if inhibits is None:
        inhibits = (OBSERVED,) if rule.observe else ()
    now = RuleTrace(rule=rule.name, status=status, output=rule.output, inhibits=inhibits, active=active)
    return now if before is None else keep_if_same(now, before)


def keep_if_same(now: RuleTrace, before: RuleTrace) -> RuleTrace:
    """Return a trace; that of the cycle before if it says the same. Which alarm came first is marked elsewhere."""
    if now.first_out is not before.first_out:
        now = replace(now, first_out=before.first_out)
    return before if now == before else now
