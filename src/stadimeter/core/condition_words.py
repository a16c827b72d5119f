"""Conditions in words: the figures behind a verdict, and when a condition begins and ends.

Conditions state thresholds and figures. A kind that is not named here is worded by its noun, its unit and these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from msgspec import Struct

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, JudgedLeaf, Not, judged_leaves
from stadimeter.core.conditions.contact import SpeedKnowledge, TimeToContactCondition, approach_of
from stadimeter.core.conditions.discrete import (
    CountCondition,
    DateSpan,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
)
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_base import ContactSensorCondition
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.measurement import Track
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.words import day, duration, figure_in_words, length, metres, short_figure, time_of_day
from stadimeter.core.words import uncertain_figure as uncertain

# Schedules and sequences in words -------------------------------------------------------------------


def clock_words(leaf: ScheduleCondition, inputs: RuleInputs) -> str:
    """Return the time of day, and when a schedule holds."""
    if inputs.wall is None:
        return f"the time of day is not known yet, {hours(leaf)}"
    wall = inputs.wall
    today = f"{day(wall.weekday)}{f' {_month_and_day(wall.dates[1])}' if leaf.dates and wall.dates else ''}"
    return f"{today} {time_of_day(wall.second_of_day // 60 * 60)}, {hours(leaf)}{_sun_today(leaf, wall)}"


def _sun_today(leaf: ScheduleCondition, wall: WallTime) -> str:
    """Say when the sun rises and sets, where a schedule goes by it."""
    if leaf.dates and not wall.dates:
        return ": the date is not known"
    if not (leaf.from_sun or leaf.to_sun):
        return ""
    if wall.sunrise_s is None or wall.sunset_s is None:
        return ": when the sun rises and sets is not known"
    if math.isinf(wall.sunrise_s) and math.isinf(wall.sunset_s):
        return f" (the sun is {'up' if wall.sunset_s > 0 else 'down'} all day)"
    times = (("sunrise", wall.sunrise_s), ("sunset", wall.sunset_s))
    return f" ({', '.join(f'{sun} {time_of_day(at_s // 60 * 60)}' for sun, at_s in times if math.isfinite(at_s))})"


def sequence_words(leaf: SequenceCondition, inputs: RuleInputs) -> str:
    """Return when each rule of a sequence was raised last."""
    now_s, raised_at_s = inputs.now_s, inputs.raised_at_s
    ago = [
        f"{rule} was raised {now_s - raised_at_s[rule]:.1f} s ago" if rule in raised_at_s else f"{rule} was not raised"
        for rule in leaf.rules
    ]
    return f"{', '.join(ago)}; in this order within {duration(leaf.within_s)}"


def hours(leaf: ScheduleCondition) -> str:
    """Return when a schedule holds, such as ``between 22:00 and 06:00 on Monday``."""
    days = f" on {' and '.join(map(day, leaf.weekdays))}" if leaf.weekdays else ""
    spans = [_span_of_days(span) for span in leaf.dates]
    dates = f" on {' and '.join(spans)}" if spans else ""
    return f"between {_hour(leaf.from_sun, leaf.from_s)} and {_hour(leaf.to_sun, leaf.to_s)}{days}{dates}"


def _hour(sun: str, second: float) -> str:
    """Return a time of a schedule such as ``22:30`` or ``30 min after sunset``."""
    if not sun:
        return time_of_day(second)
    side = "after" if second > 0 else "before"
    return f"{duration(abs(second))} {side} {sun}" if second else sun


def _span_of_days(span: DateSpan) -> str:
    """Return days such as ``12-24 to 12-26``, as they are written."""
    first, last = _month_and_day(span.first), _month_and_day(span.last)
    return first if first == last else f"{first} to {last}"


def _month_and_day(date: MonthDay) -> str:
    return f"{date.month:02d}-{date.day:02d}"


def describe_sequence(leaf: SequenceCondition) -> str:
    r"""Return a clause such as ``\`left\` and then \`right\` are raised within 2 s``."""
    names = " and then ".join(f"`{rule}`" for rule in leaf.rules)
    lasts = "" if leaf.for_s is None else f", for {duration(leaf.for_s)} from then on"
    return f"{names} are raised within {duration(leaf.within_s)}{lasts}"


# ----------------------------------------------------------------------------------------------------

_ANSWERS = {True: "yes", False: "no", None: "unknown"}
_RULE_STATES = {True: "is active", False: "is not active", None: "has nothing to judge by"}
_CONTACT_WORDS = {"is_bumped": "the bumper of the base is pressed", "is_at_cliff": "there is no floor below the base"}
_NOT_COUNTED = {
    "bearing": "; how sure a direction is, is not known",
    "elevation": "; how sure a direction is, is not known",
    "separation": "; how sure the directions are is not known, and not counted",
}


class Evidence(Struct, frozen=True, kw_only=True):
    """The figures that a simple condition was judged by. Those that it does not have are None.

    Attributes:
        quantity: Such as ``distance``.
        about: The targets, or the rule, that it is about; empty for the time of day and a count of all targets.
        words: The figures in words.
        holds: Whether it holds; None if that cannot be known.
        unit: The SI unit of the figures; empty for those without.
        sigma: The standard deviation of `value`, where that is known.
        low: The lower threshold that it is judged by now, deadband included.
        high: The upper threshold.
        probability: That the figure is within them.
        begin_points: The figures at which it would begin to speak for the alarm.
        end_points: The figures at which it would cease to.
    """

    quantity: str
    about: tuple[str, ...]
    words: str
    holds: bool | None
    unit: str = ""
    value: float | None = None
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    probability: float | None = None
    begin_points: tuple[float, ...] = ()
    end_points: tuple[float, ...] = ()

    @property
    def begins_at(self) -> str:
        """The figure where it would begin to speak for the alarm, such as ``1.91 m``; empty if it never would."""
        return self._points(self.begin_points)

    @property
    def ends_at(self) -> str:
        """The figure where it would cease to, such as ``2.12 m``; empty if it never would."""
        return self._points(self.end_points)

    def _points(self, points: tuple[float, ...]) -> str:
        return " or ".join(short_figure(point, self.unit) for point in points)


# The figures behind a verdict ---------------------------------------------------------------------------------------


def describe_verdict(
    condition: Condition,
    inputs: RuleInputs,
    held: tuple[bool, ...],
    *,
    is_active: bool,
    with_probability: bool = False,
) -> str:
    """Return the figures behind what `judge` returns for the same arguments.

    Args:
        with_probability: Whether to add how likely each part is, and from which probability on it begins or ends.
    """
    parts = iter(judged_leaves(condition, held, is_active=is_active))
    if isinstance(condition, Leaf):
        return _part_words(next(parts), inputs, names_target=False, with_probability=with_probability)
    return _whole_words(condition, inputs, parts, with_probability=with_probability)


def collect_evidence(
    condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool
) -> tuple[Evidence, ...]:
    """Return the figures behind what `judge` returns for the same arguments: one for each part, from left to right."""
    return tuple(_evidence(part, inputs) for part in judged_leaves(condition, held, is_active=is_active))


def describe_unread(tracks: Sequence[Track], noun: str) -> str:
    """Return in words why there is no figure of some targets."""
    return " and ".join(describe_unseen(track) for track in tracks if not track.is_valid) or f"the {noun} is not known"


def describe_unseen(track: Track) -> str:
    """Return in words that there is no distance to act on."""
    return f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"


def _whole_words(
    condition: Condition, inputs: RuleInputs, parts: Iterator[JudgedLeaf], *, with_probability: bool
) -> str:
    if isinstance(condition, Leaf):
        part = next(parts)
        words = _part_words(part, inputs, names_target=True, with_probability=with_probability)
        return f"{words} [{_ANSWERS[condition.holds(inputs, part.is_on)]}]"
    if isinstance(condition, Not):
        return f"not ({_whole_words(condition.condition, inputs, parts, with_probability=with_probability)})"
    within = [_whole_words(part, inputs, parts, with_probability=with_probability) for part in condition.conditions]
    return f"{'all' if isinstance(condition, AllOf) else 'any'} of ({'; '.join(within)})"


def _evidence(part: JudgedLeaf, inputs: RuleInputs) -> Evidence:
    leaf, is_on = part.leaf, part.is_on
    reading = leaf.reading(inputs, is_on)
    words = _part_words(part, inputs, names_target=True, with_probability=True)
    # Below a `not` the whole begins when this part ends.
    begin, end = (_turning_points(leaf, inputs, is_on=side) for side in (part.is_inverted, not part.is_inverted))
    return Evidence(
        quantity=leaf.noun,
        about=leaf.rules_named or leaf.targets_named,
        words=words + _NOT_COUNTED.get(leaf.noun, ""),
        holds=leaf.holds(inputs, is_on),
        unit=leaf.unit,
        value=reading.value if reading else None,
        sigma=reading.sigma if reading else None,
        low=reading.low if reading and math.isfinite(reading.low) else None,
        high=reading.high if reading and math.isfinite(reading.high) else None,
        probability=reading.probability if reading else None,
        begin_points=begin,
        end_points=end,
    )


def _turning_points(leaf: Leaf, inputs: RuleInputs, *, is_on: bool) -> tuple[float, ...]:
    """Return the figures at which a part begins or ends; of a count, which is above n - 1, the number n itself."""
    return tuple(each + (leaf.unit == "times" and not is_on) for each in leaf.turning_points(inputs, is_on=is_on))


def _part_words(  # noqa: PLR0911 - one for each kind
    part: JudgedLeaf, inputs: RuleInputs, *, names_target: bool, with_probability: bool
) -> str:
    leaf = part.leaf
    match leaf:
        case PresenceCondition():
            return _presence_words(leaf, inputs)
        case CountCondition():
            return _count_words(leaf, inputs)
        case ScheduleCondition():
            return clock_words(leaf, inputs)
        case ContactSensorCondition():
            return f"{_CONTACT_WORDS[leaf.sensor]}: {_ANSWERS[leaf.holds(inputs, part.is_on)]}"
        case RuleCondition():
            return f"the rule {leaf.rule} {_RULE_STATES[inputs.active.get(leaf.rule)]}"
        case SequenceCondition():
            return sequence_words(leaf, inputs)
        case UndeliveredCondition():
            reading = leaf.reading(inputs, part.is_on)
            return (
                f"an alarm is undelivered for {reading.value:.1f} s of {leaf.for_s:g} s"
                if reading
                else "no alarm is undelivered"
            )
        case _:
            is_named = names_target and leaf.targets_named and leaf.noun != "separation"
            named = f"{leaf.targets_named[0]} " if is_named else ""
            return _measured_words(part, inputs, named, with_probability=with_probability)


def _measured_words(part: JudgedLeaf, inputs: RuleInputs, named: str, *, with_probability: bool) -> str:
    leaf = part.leaf
    reading = leaf.reading(inputs, part.is_on)
    if reading is None:
        return _unread_words(leaf, inputs, named)
    passed = leaf.passed_through(inputs) if isinstance(leaf, DistanceCondition) and not part.is_on else None
    if passed is not None:
        return f"{named}passed through between two frames: {passed[0]:.2f} m, then {passed[1]:.2f} m"
    words = f"{named}{_value_words(leaf, reading)}, {_threshold_words(reading, leaf.unit)}"
    if isinstance(leaf, RememberedCondition) and leaf.unit == "times" and math.isfinite(reading.low):
        return f"{' or '.join(leaf.rules)} raised {reading.value:g} of {reading.low + 1:g} times {leaf.window}"
    if not with_probability or reading.probability is None:
        return words
    turns = f"ends at {leaf.probability_off:.2f}" if part.is_on else f"begins at {leaf.probability_on:.2f}"
    return f"{words}: P {reading.probability:.2f}, {turns}"


def _unread_words(leaf: Leaf, inputs: RuleInputs, named: str) -> str:
    tracks = [inputs.tracks[target] for target in leaf.targets_named]
    approach = approach_of(tracks[0]) if isinstance(leaf, TimeToContactCondition) else None
    if isinstance(leaf, TimeToContactCondition) and approach is not None:
        speed = _closing(approach.closing_mps, approach.closing_sigma_mps)
        if leaf.speed_knowledge(approach) is SpeedKnowledge.SLOW:
            return f"{named}{speed}, slower than {leaf.closing_min_mps:.2f} m/s"
        return f"{named}{metres(approach.distance_m, approach.sigma_m)}, {speed}: too unsure for a time"
    if isinstance(leaf, RememberedCondition):
        return f"{leaf.noun} is not known"
    if not tracks:
        return f"the base does not report its {leaf.noun}"
    return describe_unread(tracks, leaf.noun)


def _value_words(leaf: Leaf, reading: JudgedFigure) -> str:  # noqa: PLR0911 - one for each kind
    value, sigma = reading.value, reading.sigma or 0.0
    match leaf:
        case DistanceCondition():
            return metres(value, sigma)
        case FigureCondition(quantity="closing_speed"):
            return _closing(value, sigma)
        case FigureCondition(quantity="separation"):
            return f"{' and '.join(leaf.targets_named)} {metres(value, sigma)} apart"
        case TimeToContactCondition():
            return f"contact in {value:.2f} s ± {sigma:.2f}"
        case FigureCondition() if reading.sigma is not None:
            return uncertain(leaf.noun + (f" to {leaf.other}" if leaf.other else ""), value, sigma, leaf.unit)
        case FigureCondition(unit="rad"):
            return f"{leaf.noun} {math.degrees(value):+.1f}°"
        case _:
            return f"{leaf.noun} {figure_in_words(value, leaf.unit)}"


def _threshold_words(reading: JudgedFigure, unit: str) -> str:
    if math.isinf(reading.low):
        return f"below {short_figure(reading.high, unit)}"
    if math.isinf(reading.high):
        return f"above {short_figure(reading.low, unit)}"
    return f"between {short_figure(reading.low, unit)} and {short_figure(reading.high, unit)}"


def _presence_words(leaf: PresenceCondition, inputs: RuleInputs) -> str:
    track = inputs.tracks[leaf.target]
    words = f"{track.target} is {track.status.value}"
    if leaf.for_s and track.is_valid is leaf.seen and track.since_s is not None:
        words += f" for {inputs.now_s - track.since_s:.1f} s of {leaf.for_s:g} s"
    return words + (f": {track.reason}" if track.reason else "")


def _count_words(leaf: CountCondition, inputs: RuleInputs) -> str:
    pairs = (("at least", leaf.at_least), ("at most", leaf.at_most))
    thresholds = [f"{word} {limit}" for word, limit in pairs if limit is not None]
    counted = leaf.count(inputs)
    words = "unknown how many" if counted is None else f"{counted}"
    return f"{words} of {len(leaf.targets or inputs.tracks)} {leaf.where}, {' and '.join(thresholds)}"


# When a condition begins and ends -----------------------------------------------------------------------------------


def describe_begin(condition: Condition) -> str:
    r"""Return a clause such as ``\`ball\` is nearer than 0.50 m (1.6 ft) with a probability of 80%``."""
    match condition:
        case Leaf():
            words = _begin_words(condition)
            on = condition.probability_on
            return words if on is None else f"{words} with a probability of {on:.0%}"
        case Not():
            return f"not ({describe_begin(condition.condition)})"
        case _:
            parts = [(part, describe_begin(part)) for part in condition.conditions]
            word = " and " if isinstance(condition, AllOf) else " or "
            return word.join(f"({words})" if isinstance(part, AllOf | AnyOf) else words for part, words in parts)


def describe_end(condition: Condition) -> str:
    """Return a clause such as ``it is further than 0.50 m (1.6 ft) by 3 standard deviations of the noise``."""
    match condition:
        case TimeToContactCondition():
            return f"contact is {_back_words(condition, condition.deadband_s)}"
        case DistanceCondition():
            return f"it is {_back_words(condition, condition.deadband)}"
        case FigureCondition(quantity="separation"):
            return f"they are {_back_words(condition, condition.deadband)}"
        case FigureCondition(quantity="still"):
            return "it has moved"
        case LimitsCondition():
            named = _subject(condition) if isinstance(condition, RememberedCondition) else f"its {condition.noun} is"
            return f"{named} {_back_words(condition, condition.deadband)}"
        case _:
            return "that has ended"


def _begin_words(leaf: Leaf) -> str:  # noqa: PLR0911 - one for each kind
    match leaf:
        case PresenceCondition():
            since = f" for {duration(leaf.for_s)}" if leaf.for_s else ""
            return f"`{leaf.target}` is {'in' if leaf.seen else 'out of'} sight{since}"
        case CountCondition():
            counted = f"of {', '.join(f'`{each}`' for each in leaf.targets)}" if leaf.targets else "targets"
            return f"{_number_words(leaf.at_least, leaf.at_most)} {counted} are {leaf.where}"
        case ScheduleCondition():
            return f"it is {hours(leaf)}"
        case ContactSensorCondition():
            return _CONTACT_WORDS[leaf.sensor]
        case RuleCondition() | SequenceCondition():
            return f"`{leaf.rule}` is active" if isinstance(leaf, RuleCondition) else describe_sequence(leaf)
        case UndeliveredCondition():
            return f"an alarm is undelivered for {duration(leaf.for_s)}"
        case TimeToContactCondition() | FigureCondition(quantity="still") | FigureCondition(is_comparison=True):
            return _words_of_own(leaf)
        case _:
            return f"{_subject(leaf)} {_within_words(leaf)}"


def _words_of_own(leaf: TimeToContactCondition | FigureCondition) -> str:
    match leaf:
        case TimeToContactCondition():
            where = f"{length(leaf.contact_m)} away" if leaf.contact_m else "here"
            slower = f"(if faster than {leaf.closing_min_mps:g} m/s)"
            return f"`{leaf.target}` will be {where} within {leaf.below_s:g} s {slower}"
        case FigureCondition(quantity="still"):
            return f"`{leaf.target}` has not moved by more than {length(leaf.within_m)} for {duration(leaf.limits[0])}"
        case _:
            by = abs(next(limit for limit in leaf.limits if math.isfinite(limit)))
            more = f" by {figure_in_words(by, leaf.unit)}" if by else ""
            return f"`{leaf.target}` is {leaf.comparison.replace('_', ' ')} `{leaf.other}`{more}"


def _subject(leaf: Leaf) -> str:
    """Return the beginning of a clause about thresholds, such as ``the bearing of `ball` is``."""
    if isinstance(leaf, RememberedCondition):
        return f"`{leaf.noun}` is"
    named = " and ".join(f"`{target}`" for target in leaf.targets_named) or "the base"
    if leaf.noun == "separation":
        return f"{named} are"
    return f"{named} is" if isinstance(leaf, DistanceCondition) else f"the {leaf.noun} of {named} is"


def _number_words(least: int | None, most: int | None) -> str:
    if least is None or most is None:
        return f"at most {most}" if least is None else f"at least {least}"
    return f"{least}" if least == most else f"{least} to {most}"


def _sides(leaf: Leaf) -> tuple[str, str]:
    """Return the words before a threshold from which on a figure is too low, and too high."""
    match leaf:
        case DistanceCondition():
            return "nearer than ", "further than "
        case FigureCondition(quantity="separation"):
            return "nearer to each other than ", "further apart than "
        case TimeToContactCondition():
            return "", "later than "
        case _:
            return "below ", "above "


def _within_words(leaf: Leaf) -> str:
    """Return thresholds such as ``nearer than 0.50 m (1.6 ft)``."""
    low, high = leaf.limits
    below, above = _sides(leaf)
    along = " along the optical axis" if leaf.noun == "depth" else ""
    if leaf.unit == "times" and math.isfinite(low):
        return f"at least {figure_in_words(low + 1, leaf.unit)}"
    if math.isfinite(low) and math.isfinite(high):
        return f"between {figure_in_words(low, leaf.unit)} and {figure_in_words(high, leaf.unit)}{along}"
    side = (
        f"{above}{figure_in_words(low, leaf.unit)}"
        if math.isfinite(low)
        else f"{below}{figure_in_words(high, leaf.unit)}"
    )
    return f"{side}{along}"


def _back_words(leaf: LimitsCondition | TimeToContactCondition, deadband: float) -> str:
    """Return where a condition ends, which the deadband moves away from where it begins."""
    (low, high), sigmas, (below, above) = leaf.limits, leaf.deadband_sigmas, _sides(leaf)
    fixed = 0.0 if sigmas else deadband - (leaf.unit == "times")  # a count that ends is below n, above n - 1 no more
    there = [f"{below}{figure_in_words(low - fixed, leaf.unit)}"] if math.isfinite(low) else []
    there += [f"{above}{figure_in_words(high + fixed, leaf.unit)}"] if math.isfinite(high) else []
    if not sigmas:
        return " or ".join(there)
    noise = f"{sigmas:g} standard deviations of the noise"
    width = f"{deadband:g} {leaf.unit} or {noise}, whichever is more," if deadband else noise
    return f"{' or '.join(there)} by {width}"


def _closing(closing_mps: float, sigma_mps: float) -> str:
    return f"closing at {closing_mps:.2f} m/s ± {sigma_mps:.2f}"
