"""The table of a rule, and how it becomes the core's rules. Its defaults are those of `stadimeter.core.rule`."""

import json
import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypedDict

from msgspec.structs import replace
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.models import DurationAboveZero, Section, Share
from stadimeter.config.rules.conditions import Every, TimesOfDay, WhenTable, WrittenFigure, parse_figure
from stadimeter.config.units import AngleOrZero, Duration, Length, LengthOrZero, Speed, TurnRate
from stadimeter.core import rule, templates
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import Condition, leaves, targets_of
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.quantities import QuantityName
from stadimeter.core.decision import Severity
from stadimeter.core.message import OWN_FIRST_LEVELS
from stadimeter.core.rules.ramp import LATE_S

# The tables of what rules do: patterns, steps of an escalation, ramps and following; and what the core has of them.

# A level changes with a frame at the earliest: at 30 frames a second a shorter one may be passed over.
MIN_STEP_S = 0.05

DEFAULT_TITLE = "{rule}: {event}"
DEFAULT_TEXT = "{reason}"

# For each key, those of `_DOES` beside which it has a meaning.
_STEP = rule.EscalationStep()
_DOES = ("actuator", "notify", "topic")
_ONLY_FOR = {
    "level": ("actuator",), "pattern": ("actuator",), "for_": ("actuator",),
    "title": ("notify",), "text": ("notify", "topic"), "json_": ("topic",), "retain": ("topic",),
}  # fmt: skip


def _long_enough(seconds: float) -> float:
    if seconds < MIN_STEP_S:
        raise ValueError(
            f"{seconds * 1000:g} ms is too short for a step of a pattern: levels change with the frames; "
            f"choose at least '{MIN_STEP_S * 1000:g} ms'"
        )
    return seconds


StepDuration = Annotated[Duration, AfterValidator(_long_enough)]


class PatternStepTable(Section):
    """One level of a pattern."""

    level: Share
    """The level of the output, from 0 to 1."""
    for_: Annotated[StepDuration, Field(alias="for")]
    """How long it lasts, in seconds, written ``for``."""


class PatternTable(Section):
    """A level that changes by itself while the alarm stands: on and off, or steps of 50 ms or more."""

    on: StepDuration | None = None
    """For how long the output is on, in seconds."""
    off: StepDuration | None = None
    """For how long it is off after that."""
    steps: Annotated[list[PatternStepTable], Field(min_length=1, max_length=100)] | None = None
    """Several levels instead of on and off."""
    times: Annotated[int, Field(ge=0)] = 0
    """How often to repeat all of it; 0 for as long as the alarm stands."""

    @model_validator(mode="after")
    def _one_form_only(self) -> Self:
        has_on_and_off = [key for key in ("on", "off") if getattr(self, key) is not None]
        if self.steps is not None and has_on_and_off:
            raise ValueError(f"a pattern with steps has no '{has_on_and_off[0]}'; leave one of the two out")
        if self.steps is None and len(has_on_and_off) < 2:
            raise ValueError('a pattern has on and off, such as { on = "0.2 s", off = "0.3 s" }, or steps')
        return self

    @property
    def period_s(self) -> float:
        """Time one pass takes, in seconds."""
        return sum(for_s for _, for_s in self.to_plan(level=1.0).steps)

    def to_plan(self, level: float) -> rule.Pattern:
        """Return the pattern as the core sees it.

        Args:
            level: The level while it is on, where the pattern names none.
        """
        if self.steps is not None:
            return rule.Pattern(steps=tuple((step.level, step.for_) for step in self.steps), times=self.times)
        return rule.Pattern(steps=((level, self.on or 0.0), (0.0, self.off or 0.0)), times=self.times)


# The key of the validation context under which the names of remembered figures stand: each is a gap of a template.
GAPS = "gaps"


def _checked(template: rule.Template, info: ValidationInfo) -> None:
    figures = (info.context or {}).get(GAPS, ())
    try:
        templates.check(template, figures)
    except templates.TemplateError as error:
        hint = did_you_mean_or_list(error.field, (*templates.FIELDS, *figures)) if error.field else ""
        raise ValueError(f"{error}; {hint}" if hint else str(error)) from error


def _check_text(text: str, info: ValidationInfo) -> str:
    _checked(rule.Template(text=text), info)
    return text


def _check_json(value: Any, info: ValidationInfo) -> Any:
    if not isinstance(value, dict | list):
        raise ValueError('json is a table or a list, such as { distance = "{distance_m}" }; write a text as text')
    try:
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"JSON has no such value as inf, nan, a date or a time; put it in quotes ({error})") from error
    _checked(rule.Template(text=text, is_json=True), info)
    return value


def _check_topic(topic: str) -> str:
    if not topic or topic[0] in "/$" or topic[-1] == "/" or re.search(r"[+#\s\x00{}]", topic):
        raise ValueError(f"{topic!r} is not a topic; write it such as 'door/alert', without '+', '#', gaps or spaces")
    first = topic.partition("/")[0]
    if first in OWN_FIRST_LEVELS:
        raise ValueError(f"{topic!r}: topics below '{first}' are the program's own; choose another")
    return topic


Text = Annotated[str, Field(min_length=1), AfterValidator(_check_text)]


class StepTable(Section):
    """One thing that an alarm does after it was raised or cleared; exactly one of `actuator`, `notify` and `topic`.

    Steps with `after` are an escalation: those that are not due when the alarm clears are dropped.
    """

    after: Duration = _STEP.after_s
    """How long after, in seconds."""
    on: Literal["raised", "cleared"] = _STEP.on
    """After being raised, or after being cleared."""
    only_unacknowledged: bool = _STEP.only_unacknowledged
    """Skipped if the alarm has been acknowledged by then."""
    when: WhenTable | None = None
    """Skipped if this does not hold by then."""
    actuator: str | None = None
    """An actuator that it drives, or ``base``."""
    level: Share = _STEP.level
    """The level that the actuator gets."""
    pattern: PatternTable | None = None
    """How that level changes."""
    for_: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    """For how long, in seconds, written ``for``; None for as long as the alarm stands."""
    notify: str | None = None
    """The notifier that tells people."""
    title: Text | None = None
    """The title of the notification, with gaps; None for the rule and what happened to it."""
    topic: Annotated[str, AfterValidator(_check_topic)] | None = None
    """The messenger's topic, below its base topic."""
    text: Text | None = None
    """What it says, with gaps."""
    json_: Annotated[Any, BeforeValidator(_check_json), Field(alias="json")] = None
    """The same as JSON, with gaps in its texts, written ``json``."""
    retain: bool = False
    """Whether the broker keeps the message."""

    @model_validator(mode="after")
    def _one_thing_only(self) -> Self:
        does = [key for key in _DOES if getattr(self, key) is not None]
        if len(does) != 1:
            has = f"has {' and '.join(does)}" if does else "does nothing"
            raise ValueError(f"this step {has}; a step has exactly one of actuator, notify and topic")
        for key, beside in _ONLY_FOR.items():
            if key in self.model_fields_set and does[0] not in beside:
                raise ValueError(f"'{key.rstrip('_')}' has no meaning beside {does[0]}; leave it out")
        if self.topic is not None and (self.text is None) is (self.json_ is None):
            raise ValueError("a message has exactly one of text and json")
        if self.on == "cleared" and self.actuator is not None and self.for_ is None:
            raise ValueError("after the alarm has cleared an actuator needs an end: add for, such as for = '2 s'")
        return self

    def to_plan(self, severity: Severity) -> rule.EscalationStep:
        """Return the step as the core sees it; a default of its condition depends on how much the rule matters."""
        return rule.EscalationStep(
            on=self.on,
            after_s=self.after,
            only_unacknowledged=self.only_unacknowledged,
            output=self.actuator,
            level=self.level,
            pattern=self.pattern.to_plan(self.level) if self.pattern else None,
            for_s=_STEP.for_s if self.for_ is None else self.for_,
            send=None if self.actuator else self._send(),
            when=None if self.when is None else self.when.to_plan(severity),
        )

    def _send(self) -> rule.Send:
        if self.json_ is not None:
            template = rule.Template(text=json.dumps(self.json_, ensure_ascii=False), is_json=True)
        else:
            template = rule.Template(text=DEFAULT_TEXT if self.text is None else self.text)
        return rule.Send(
            template=template,
            topic=self.topic or "",
            notifier=self.notify or "",
            title=(DEFAULT_TITLE if self.title is None else self.title) if self.notify else "",
            retain=self.retain,
        )


_SEARCH = rule.Search()
_FOLLOW = rule.FollowRule(name="", target="", distance_m=1.0)

Factor = Annotated[float, Field(gt=0)]


class RuleCommon(TypedDict):
    """The keys that every rule of the core has, whatever its kind; see `stadimeter.core.rule.Rule`."""

    name: str
    target: str
    output: str | None
    priority: int
    severity: Severity
    lost: rule.Lost
    observe: bool


class SearchTable(Section):
    """The way a base turns to find its target; see `stadimeter.core.rule.Search`."""

    angle_rad: AngleOrZero = Field(default=_SEARCH.angle_rad, alias="angle")
    """It turns no further, to either side."""
    for_s: DurationAboveZero = Field(default=_SEARCH.for_s, alias="for")
    """In seconds, written ``for``; it searches no longer."""
    step_rad: Annotated[AngleOrZero, Field(ge=math.radians(5))] = Field(default=_SEARCH.step_rad, alias="step")
    """In radians; it turns by this, then looks. Less than the camera sees."""


class SlowTable(Section):
    """A target near which a base is slow; see `stadimeter.core.rule.SlowNear`."""

    target: str
    """The target near which it is slow."""
    from_: Annotated[Length, Field(alias="from")]
    """In metres, written ``from``; from this distance on it is slower."""
    to: LengthOrZero
    """In metres; at this distance it stands."""

    @model_validator(mode="after")
    def _grows(self) -> Self:
        if self.to >= self.from_:
            raise ValueError(f"it is slow from {self.from_:g} m to {self.to:g} m: from must be further away than to")
        return self


class FollowTable(Section):
    """A base that keeps its distance; see `stadimeter.core.rule.FollowRule`."""

    distance_m: Length = Field(alias="distance")
    """The distance to keep, along the straight line from the camera."""
    gain_per_s: Factor | None = Field(default=_FOLLOW.gain_per_s, alias="gain")
    """Forward speed for each metre of distance error, in 1/s; None for as much as the delay allows."""
    turn_gain_per_s: Factor | None = Field(default=_FOLLOW.turn_gain_per_s, alias="turn_gain")
    """Rate of turn for each radian of bearing, in 1/s; None for as much as the delay allows."""
    delay_s: DurationAboveZero | None = Field(default=_FOLLOW.delay_s, alias="delay")
    """From the picture until the wheels obey, in seconds; None for what is measured and usual."""
    linear_max_mps: Speed = Field(default=_FOLLOW.linear_max_mps, alias="max_speed")
    """No faster forwards."""
    reverse_max_mps: Speed = Field(default=_FOLLOW.reverse_max_mps, alias="max_reverse_speed")
    """No faster backwards; 0 never reverses. Nothing sees behind the robot."""
    angular_max_radps: TurnRate = Field(default=_FOLLOW.angular_max_radps, alias="max_turn_rate")
    """No faster in turning."""
    deadband_m: LengthOrZero = Field(default=_FOLLOW.deadband_m, alias="deadband")
    """A smaller error of the distance does not set a base in motion that stands."""
    deadband_rad: AngleOrZero = Field(default=_FOLLOW.deadband_rad, alias="turn_deadband")
    """The same for an error of the direction."""
    turn: bool = True
    """Whether the base can steer; false for a slider, which only drives to and fro."""
    search: SearchTable | Literal["off"] = Field(default_factory=SearchTable)
    """What it does when the target is lost."""
    tether_m: Length | None = Field(default=_FOLLOW.tether_m, alias="tether")
    """In metres; it drives no further from where it began. None for any distance."""
    slow: SlowTable | None = None
    """A target near which it is slow."""

    @model_validator(mode="after")
    def _comes_back(self) -> Self:
        if self.deadband_m >= self.distance_m:
            raise ValueError(f"the deadband {self.deadband_m:g} m reaches past the distance {self.distance_m:g} m")
        return self

    def to_plan(self, common: RuleCommon) -> rule.FollowRule:
        """Return the rule as the core sees it."""
        values = {name: value for name, value in self if name not in {"turn", "search", "slow"}}
        if not self.turn:
            values["angular_max_radps"] = 0.0
        search = rule.Search(**dict(self.search)) if self.turn and isinstance(self.search, SearchTable) else None
        near = self.slow
        slow = rule.SlowNear(target=near.target, start_m=near.from_, full_m=near.to) if near else None
        return rule.FollowRule(**common, **values, search=search, slow=slow)


# The table of a ramp and of its points, and what the core has of it ---------------------------------
#
# Annotations are no texts here, as in every file of tables.

_RAMP = rule.RampRule(name="", target="", start=1.0, full=2.0)

# The fields that say what a table of points says by itself, and how they are written.
_OF_A_CURVE = {"start": "from", "full": "to", "min": "min", "max": "max", "gamma": "gamma"}


class PointTable(Section):
    """One line of a table of levels."""

    at: WrittenFigure
    """The figure, as it is written."""
    level: Share
    """The level there, from 0 to 1."""


def _check_order(points: list[tuple[float, float]]) -> None:
    """Refuse points that go to and fro; whether the nearest or the furthest comes first does not matter."""
    steps = [after - before for (before, _), (after, _) in pairwise(points)]
    if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
        raise ValueError("the points are not in order; write them from the nearest to the furthest, each distance once")


class RampTable(Section):
    """An output that grows with a figure, such as distance or nearness; see `stadimeter.core.rule.RampRule`."""

    of: QuantityName = _RAMP.quantity
    """What it goes by; the figures are written in its units."""
    start: Annotated[WrittenFigure | None, Field(alias="from")] = None
    """Written ``from``; where the output begins."""
    full: Annotated[WrittenFigure | None, Field(alias="to")] = None
    """Written ``to``; where it is full."""
    points: Annotated[list[PointTable], Field(min_length=2, max_length=100)] | None = None
    """A table of figures and levels instead of a curve from start to full."""
    min: Share = _RAMP.level_min
    """The level right after the start."""
    max: Share = _RAMP.level_max
    """The level at the full end and beyond."""
    gamma: Factor = _RAMP.gamma
    """Exponent of the curve."""
    bias: rule.Bias = _RAMP.bias
    """Which way to err within the standard deviation."""
    dead_zone: Share = _RAMP.dead_zone
    """Levels below this are 0."""

    @model_validator(mode="after")
    def _one_way_only(self) -> Self:
        if self.points is None:
            missing = [_OF_A_CURVE[key] for key in ("start", "full") if getattr(self, key) is None]
            if missing:
                raise ValueError(f"'{missing[0]}' is missing; a ramp has from and to, or points")
            if self.ends[0] == self.ends[1]:
                raise ValueError("the ramp ends where it begins; choose two figures, or write a rule with when")
            if self.min > self.max:
                raise ValueError(f"min {self.min:g} is above max {self.max:g}; from and to give the direction")
            return self
        also = [_OF_A_CURVE[key] for key in _OF_A_CURVE if key in self.model_fields_set]
        if also:
            raise ValueError(f"a ramp with points has no '{also[0]}': the points say it all; leave it out")
        _check_order(self.levels)
        return self

    @property
    def levels(self) -> list[tuple[float, float]]:
        """The points as they are written: figures in the SI unit, and levels; none for a curve."""
        return [(parse_figure(point.at, self.of), point.level) for point in self.points or ()]

    @property
    def ends(self) -> tuple[float, float]:
        """The values where the output begins and where it is full, in the SI unit; of points, the outer ones."""
        if self.points is None:
            return parse_figure(self.start, self.of), parse_figure(self.full, self.of)
        (first, at_first), *_, (last, at_last) = sorted(self.levels)
        return (first, last) if at_last >= at_first else (last, first)

    def to_plan(self, common: RuleCommon) -> rule.RampRule:
        """Return the rule as the core sees it.

        Returns:
            The rule; its points with the least figure first.
        """
        start, full = self.ends
        return rule.RampRule(
            **common,
            start=start,
            full=full,
            quantity=self.of,
            level_min=self.min,
            level_max=self.max,
            gamma=self.gamma,
            bias=self.bias,
            points=tuple(sorted(self.levels)),
            dead_zone=self.dead_zone,
        )


# The table of a rule --------------------------------------------------------------------------------------------------

__all__ = ["FramesTable", "RuleTable", "WhenTable"]

_LOST = rule.Lost()
_RULE = rule.Rule(name="", target="")
_DISTANCE = DistanceCondition()
_ALARM = rule.AlarmRule(name="", target="", condition=_DISTANCE)

# One wrong frame raises nothing, and one missing frame delays nothing.
FRAMES_TO_RAISE = rule.OnDelay(frames=3, of_frames=5)

UNTIL_ACKNOWLEDGED = "until-acknowledged"

# What a rule does: exactly one of these, whose gate `when` then is, or `when` alone.
AT_TIMES = ("every", "at")
GATED = ("ramp", "follow", *AT_TIMES)
KINDS = ("when", *GATED)
ONE_KIND = f"one of {', '.join(GATED)}, or when alone"
_ONLY_FOR_ALARMS = (
    "targets", "on_delay", "off_delay", "level", "pattern", "at_start", "latch", "ack", "realarm",
    "cooldown", "raises_per_min_max", "group", "escalation", "notify",
)  # fmt: skip
_SENDS = ("escalation", "notify")
_OF_ALARM_STEPS = {"actuator", "after", "on", "only_unacknowledged"}


class LostTable(Section):
    """The behaviour of a rule without its target; see `stadimeter.core.rule.Lost`."""

    grace: Duration = _LOST.grace_s
    """For how long the rule goes on as if it still saw its target."""
    policy: Annotated[rule.LostPolicy | None, Field(strict=False)] = None
    """What happens after it; None for ``hold``, or ``clear`` where the off-delay is longer than `fault_after`."""
    fault_after: Duration = _LOST.fault_after_s
    """After this time without its target, its output goes to the safe value."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.fault_after < self.grace:
            raise ValueError(f"fault_after {self.fault_after:g} s is shorter than grace {self.grace:g} s")
        return self

    def to_plan(self, off_delay_s: float) -> rule.Lost:
        """Return the table as the core sees it.

        An off-delay that `hold` would cut short says what is meant: acting for that long, and not forever.
        """
        outlasts = off_delay_s > self.fault_after
        policy = self.policy or (rule.LostPolicy.CLEAR if outlasts else _LOST.policy)
        return rule.Lost(grace_s=self.grace, policy=policy, fault_after_s=self.fault_after)


class FramesTable(Section):
    """A delay counted in frames."""

    frames: Annotated[int, Field(ge=1)]
    """In this many frames the condition must hold."""
    of: Annotated[int, Field(ge=1)]
    """Of this many newest frames."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.frames > self.of:
            raise ValueError(f"{self.frames} of {self.of} frames can never be; exchange them")
        return self


OnDelay = Annotated[
    Annotated[FramesTable, Tag("in frames")] | Annotated[Duration, Tag("in time")],
    Discriminator(lambda value: "in frames" if isinstance(value, dict | FramesTable) else "in time"),
]


class Conditions(NamedTuple):
    """The conditions of one rule table as the core sees them."""

    when: Condition | None
    suppress_when: Condition | None


class RuleTable(Section):
    """A rule: an alarm (`when`), a level (`ramp`), a base that follows (`follow`), or messages at times.

    `observe = true` is for trying it. People may acknowledge, shelve or take it out of service with `stadimeter alarm`;
    none of that works on a rule of severity `safety`, which acts at once and always.
    """

    written_elsewhere: ClassVar[dict[str, str]] = {
        **dict.fromkeys(
            ("below", "above", "between", "seen", "separation", "closing_speed"),
            'write it inside when, such as when = { below = "50 cm" }',
        ),
        **dict.fromkeys(("deadband", "hysteresis"), 'write deadband inside when: { below = "1 m", deadband = "5 cm" }'),
        **dict.fromkeys(("delay", "debounce", "for"), 'write on_delay = "2 s", or off_delay'),
        **dict.fromkeys(("topic", "text", "message"), "write it in a step: [[rules.NAME.escalation]]"),
        "distance": 'write follow = { distance = "1 m" }, or when = { below = "1 m" }',
    }

    target: str | None = None
    """The target that it watches; may be left out where there is only one."""
    targets: Annotated[list[str], Field(min_length=1)] | None = None
    """Several targets instead: one alarm for each, named after the rule and the target."""
    actuator: str | None = None
    """The actuator that it drives, or ``base``; None for an alert only."""
    priority: int = _RULE.priority
    """Of several rules that ask something of one output, the highest wins."""
    severity: Annotated[Severity, Field(strict=False)] = _RULE.severity
    """How much its events matter. A `safety` rule acts at once, and nothing inhibits it."""
    lost: LostTable = Field(default_factory=LostTable)
    """What it does without its target."""
    observe: bool = _RULE.observe
    """It is judged, recorded and explained like any other, but drives nothing and sends nothing."""
    when: WhenTable | None = None
    """A condition to act on; beside another kind, it acts only while this holds."""
    ramp: RampTable | None = None
    """An output that follows the distance."""
    follow: FollowTable | None = None
    """A distance that a base keeps."""
    every: Every | None = None
    """In seconds; sends a message once within this time."""
    at: TimesOfDay | None = None
    """In seconds since midnight; sends a message at this time of day, or at each of several."""
    on_delay: OnDelay | None = None
    """How long a condition must hold first; by default 3 of 5 frames, or no time where it has a probability."""
    off_delay: Duration = _ALARM.off_delay_s
    """How long it must no longer hold; in seconds."""
    level: Share = _ALARM.level
    """The level of an actuator while the condition holds."""
    pattern: PatternTable | None = None
    """How that level changes while the condition holds."""
    at_start: Literal["act", "announce"] = _ALARM.at_start
    """Whether an alarm that is raised by the very first sight of the target moves its output."""
    latch: bool | Literal["until-acknowledged"] = _ALARM.latch
    """Whether it stays active until an operator resets it, or acknowledges it."""
    ack: Literal["required", "none"] = _ALARM.ack
    """Whether an operator must acknowledge it."""
    realarm: DurationAboveZero | None = None
    """After being active for this long, in seconds, it is reported again; None for never."""
    cooldown: Duration | None = None
    """The least time between two notifications, by default 10 s, and none for `safety`. Outputs are not delayed."""
    shelve_max: Duration | None = None
    """The longest time that it can be shelved for, by default 8 h; 0 forbids it."""
    raises_per_min_max: Annotated[int, Field(ge=0, le=1000)] | Literal["off"] = _ALARM.raises_per_min_max
    """An alarm that came this often within a minute chatters: it stays active until it has calmed down. 0 or "off" for
    no such limit."""
    group: str = _ALARM.group
    """Of the alarms of one group, the first one is marked; empty for none."""
    suppress_when: WhenTable | None = None
    """While this holds, it drives nothing and sends no notification."""
    notify: str | None = None
    """The notifier that tells people at once: short for a step of the escalation."""
    escalation: list[StepTable] = Field(default_factory=list)
    """What else it does, and when."""

    @model_validator(mode="after")
    def _is_of_one_kind(self) -> Self:
        acts = [kind for kind in GATED if getattr(self, kind) is not None]
        if len(acts) > 1:
            raise ValueError(f"a rule has {ONE_KIND}; make a rule of its own of each of {' and '.join(acts)}")
        stray = [key for key in _ONLY_FOR_ALARMS if key in self.model_fields_set]
        if acts and acts[0] in AT_TIMES:
            stray = [key for key in stray if key not in _SENDS]
            self._sends_only()
        if acts and stray:
            raise ValueError(f"'{stray[0]}' has no meaning beside {acts[0]}; leave it out")
        return self

    def _sends_only(self) -> None:
        """Refuse a message at times that drives something, says nothing, or comes twice in one moment."""
        if self.actuator is not None or any(step.model_fields_set & _OF_ALARM_STEPS for step in self.escalation):
            raise ValueError("a rule with every or at sends at its times, and no more: it drives and awaits nothing")
        if not self.steps:
            raise ValueError("the rule sends nothing; add notify, or a step with topic")
        times = sorted(self.at or [0.0])
        if any(later - time < 2 * LATE_S for time, later in pairwise([*times, times[0] + DAY_S])):
            raise ValueError("two of the times are less than 2 min apart; leave one out")

    @model_validator(mode="after")
    def _is_safe(self) -> Self:
        if self.severity is not Severity.SAFETY:
            return self
        delay = self.on_delay.frames - 1 if isinstance(self.on_delay, FramesTable) else self.on_delay
        is_late = {"on_delay": delay, "shelve_max": self.shelve_max, "suppress_when": self.suppress_when}
        if wrong := [key for key, value in {**is_late, "observe": self.observe}.items() if value]:
            hint = 'leave it out, or write severity = "alarm"'
            raise ValueError(f"a safety rule acts at once and always, so it has no {' and no '.join(wrong)}; {hint}")
        return self

    @property
    def is_gated(self) -> bool:
        """True if it does something of its own, as far as `when` lets it, and so is no alarm."""
        return any(getattr(self, kind) is not None for kind in GATED)

    @property
    def steps(self) -> list[StepTable]:
        """The steps of the escalation, and behind them the one that `notify` is short for."""
        return [*self.escalation, *([StepTable(notify=self.notify)] if self.notify is not None else [])]

    def names(self, name: str) -> tuple[str, ...]:
        """Return the names of the rules that it stands for: with several targets one for each, ``near:ball``."""
        return (name,) if self.targets is None else tuple(f"{name}:{target}" for target in self.targets)

    def conditions(self) -> Conditions:
        """Return the conditions as the core sees them; parts that name no target are left without one."""
        return Conditions(
            when=self.when.to_plan(self.severity) if self.when else None,
            suppress_when=self.suppress_when.to_plan(self.severity) if self.suppress_when else None,
        )

    def to_plans(self, name: str, targets: Sequence[str], conditions: Conditions) -> tuple[rule.AnyRule, ...]:
        """Return every rule that the table stands for, as the core sees them.

        Args:
            targets: Every target, in the order of the file.
            conditions: What `conditions` gives.

        Returns:
            One rule; with several targets one for each. One that names no target watches the first of those that its
            condition is about, or else the first of all.
        """
        is_alarm = conditions.when is not None and not self.is_gated
        about = targets_of(conditions.when) if conditions.when is not None and is_alarm else frozenset[str]()
        default = next((target for target in targets if target in about), next(iter(targets), ""))
        watched = self.targets or (self.target or default,)
        return tuple(
            self._to_plan(each, target, conditions) for each, target in zip(self.names(name), watched, strict=True)
        )

    def _to_plan(self, name: str, target: str, conditions: Conditions) -> rule.AnyRule:
        common = RuleCommon(
            name=name,
            target=target,
            output=self.actuator,
            priority=self.priority,
            severity=self.severity,
            lost=self.lost.to_plan(0.0 if self.latch else self.off_delay),
            observe=self.observe,
        )
        if self.is_gated:
            gate = rule.AlarmRule(
                name=name,
                target=target,
                condition=rule.ALWAYS if conditions.when is None else conditions.when,
                suppress_when=conditions.suppress_when,
                shelve_max_s=self.shelve_max_s,
                escalation=tuple(step.to_plan(self.severity) for step in self.steps),
            )
            return replace(self._gated(common), gate=gate)
        if conditions.when is None:
            raise ValueError("a rule that is not gated has a condition")
        return self._alarm(common, conditions.when, conditions.suppress_when)

    def _gated(self, common: RuleCommon) -> rule.RampRule | rule.FollowRule | rule.ReportRule:
        acts = self.ramp or self.follow
        if acts is not None:
            return acts.to_plan(common)
        if "severity" not in self.model_fields_set:
            common["severity"] = Severity.INFO
        return rule.ReportRule(**common, every_s=self.every, at_seconds=tuple(sorted(set(self.at or ()))))

    def delay(self, judged: Condition) -> rule.OnDelay:
        """Return the time a condition must hold before the alarm is raised.

        Returns:
            The delay. Without a word about it there is none for safety, nor for what is judged with a probability: that
            has weighed the noise already. Figures that are compared as they are must hold in three of five frames.
        """
        if isinstance(self.on_delay, FramesTable):
            return rule.OnDelay(frames=self.on_delay.frames, of_frames=self.on_delay.of)
        if self.on_delay is not None:
            return rule.OnDelay(hold_s=self.on_delay)
        is_sure = all(leaf.probability_on is not None or not leaf.has_noise for leaf in leaves(judged))
        return rule.OnDelay() if is_sure or self.severity is Severity.SAFETY else FRAMES_TO_RAISE

    @property
    def cooldown_s(self) -> float:
        """The least time between two notifications; without a word about it none at all for safety."""
        return self._unless_safety(self.cooldown, _ALARM.cooldown_s)

    @property
    def shelve_max_s(self) -> float:
        """The longest time that it can be shelved for; a safety rule cannot be."""
        return self._unless_safety(self.shelve_max, _ALARM.shelve_max_s)

    def _unless_safety(self, written_s: float | None, default_s: float) -> float:
        if written_s is not None:
            return written_s
        return 0.0 if self.severity is Severity.SAFETY else default_s

    def _alarm(self, common: RuleCommon, when: Condition, suppress_when: Condition | None) -> rule.AlarmRule:
        return rule.AlarmRule(
            **common,
            condition=when,
            on_delay=self.delay(when),
            off_delay_s=self.off_delay,
            level=self.level,
            at_start=self.at_start,
            pattern=self.pattern.to_plan(self.level) if self.pattern else None,
            latch=bool(self.latch),
            ack_resets=self.latch == UNTIL_ACKNOWLEDGED,
            ack="required" if self.latch == UNTIL_ACKNOWLEDGED else self.ack,
            realarm_s=self.realarm,
            cooldown_s=self.cooldown_s,
            shelve_max_s=self.shelve_max_s,
            raises_per_min_max=0 if self.raises_per_min_max == "off" else self.raises_per_min_max,
            group=self.group,
            suppress_when=suppress_when,
            escalation=tuple(step.to_plan(self.severity) for step in self.steps),
        )
