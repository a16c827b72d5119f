"""The tables of what rules do: patterns, steps of an escalation, ramps and following; and what the core has of them."""

import datetime as dt
import json
import math
import re
from typing import Annotated, Any, ClassVar, Literal, Self, TypedDict

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.models import DurationAboveZero, Section, Share
from stadimeter.config.rules.conditions import WhenTable
from stadimeter.config.units import AngleOrZero, Duration, Length, LengthOrZero, Speed, TurnRate
from stadimeter.core import rule, templates
from stadimeter.core.decision import Severity
from stadimeter.core.message import OWN_FIRST_LEVELS

# A level changes with a frame at the earliest: at 30 frames a second a shorter one may be passed over.
MIN_STEP_S = 0.05

# Greatest depth of lists and tables in a JSON template.
JSON_MAX_DEPTH = 20

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
    """The level."""
    for_: Annotated[StepDuration, Field(alias="for")]
    """How long it lasts, in seconds, written ``for``."""


class PatternTable(Section):
    """A level that changes by itself; see `stadimeter.core.rule.Pattern`."""

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
    _only_json(value, JSON_MAX_DEPTH)
    _checked(rule.Template(text=json.dumps(value), is_json=True), info)
    return value


def _only_json(value: object, depth_left: int) -> None:
    if depth_left == 0:
        raise ValueError(f"it is nested deeper than {JSON_MAX_DEPTH} levels")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("JSON knows no such number as inf or nan")
    if isinstance(value, dt.date | dt.time):
        raise ValueError(f"JSON knows no dates and times; put {value} in quotes")
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _only_json(inner, depth_left - 1)


def _check_topic(topic: str) -> str:
    if not topic or topic[0] in "/$" or topic[-1] == "/" or re.search(r"[+#\s\x00{}]", topic):
        raise ValueError(f"{topic!r} is not a topic; write it such as 'door/alert', without '+', '#', gaps or spaces")
    first = topic.partition("/")[0]
    if first in OWN_FIRST_LEVELS:
        raise ValueError(f"{topic!r}: topics below '{first}' are the program's own; choose another")
    return topic


Text = Annotated[str, Field(min_length=1), AfterValidator(_check_text)]


class StepTable(Section):
    """One thing that an alarm does after it was raised or cleared; see `stadimeter.core.rule.EscalationStep`."""

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

    written_elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("turn_rate", "look", "hidden"), "leave it out: it is fixed"
    )

    angle_rad: AngleOrZero = Field(default=_SEARCH.angle_rad, alias="angle")
    """In radians; it turns no further."""
    for_s: DurationAboveZero = Field(default=_SEARCH.for_s, alias="for")
    """In seconds, written ``for``; it searches no longer."""
    step_rad: Annotated[AngleOrZero, Field(ge=math.radians(5))] = Field(default=_SEARCH.step_rad, alias="step")
    """In radians; it turns by this, then looks. Less than the camera sees."""


class SlowTable(Section):
    """A target near which a base is slow; see `stadimeter.core.rule.SlowNear`."""

    target: str
    """Its name."""
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
    """In metres."""
    gain_per_s: Factor | None = Field(default=_FOLLOW.gain_per_s, alias="gain")
    """Forward speed for each metre of distance error, in 1/s; None for as much as the delay allows."""
    turn_gain_per_s: Factor | None = Field(default=_FOLLOW.turn_gain_per_s, alias="turn_gain")
    """Rate of turn for each radian of bearing, in 1/s; None for as much as the delay allows."""
    delay_s: DurationAboveZero | None = Field(default=_FOLLOW.delay_s, alias="delay")
    """From the picture until the wheels obey, in seconds; None for what is measured and usual."""
    linear_max_mps: Speed = Field(default=_FOLLOW.linear_max_mps, alias="max_speed")
    """In m/s, forwards."""
    reverse_max_mps: Speed = Field(default=_FOLLOW.reverse_max_mps, alias="max_reverse_speed")
    """In m/s, backwards; 0 never reverses."""
    angular_max_radps: TurnRate = Field(default=_FOLLOW.angular_max_radps, alias="max_turn_rate")
    """In rad/s."""
    deadband_m: LengthOrZero = Field(default=_FOLLOW.deadband_m, alias="deadband")
    """In metres."""
    deadband_rad: AngleOrZero = Field(default=_FOLLOW.deadband_rad, alias="turn_deadband")
    """In radians."""
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
