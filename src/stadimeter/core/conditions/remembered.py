"""Conditions on what is remembered over a window of time: figures with a name, and what other rules did."""

from __future__ import annotations

import math
from itertools import accumulate
from struct import Struct as Packing
from typing import Literal

from msgspec import Struct

from stadimeter.core.bounds import MAX_SPEED_MPS
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.leaf import Leaf, RuleInputs, Threshold, back_words
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.quantities import QUANTITIES, Uncertain
from stadimeter.core.observation import WallTime
from stadimeter.core.words import duration, time_of_day

# The memory of a window of time: figures of targets, and how often or how long other rules were active ----------------
#
# What is kept is bounded, whatever comes: up to 256 slots of the window, each with the number of its values, their
# sum, the least and the largest. A slot begins with a value and takes those of 1/256 of the window; it leaves the
# window when its first value does. So a value leaves by up to 1/256 of the window too early, and a percentile is
# one of the means of the slots, each weighed by how many values it has: it is exact while no slot has more than
# one.
#
# Sums are exact or in the order of the cycles, so that the same run gives the same figures to the last bit.

# A clock that is put forward or back by less, as for summer time, begins no other day.
_CLOCK_CHANGE_S = 2 * 3600.0

# What is as old as the window has left it, however a sum of times was rounded.
_ROUNDING_S = 1e-6

# Ten times less memory than Python's own numbers take: a slot's beginning, number, sum, least and largest.
SLOTS = 256
_SLOT = Packing("<5d")

# Those of `QUANTITIES` that need no motion across the line of sight.
FigureQuantity = Literal[
    "distance", "depth", "bearing", "elevation", "closing_speed", "x", "y", "z", "height", "height_above_camera", "size"
]


class Window(Struct, frozen=True, kw_only=True):
    """The part of the past that counts.

    Attributes:
        for_s: The newest part of the past, this long; one day where it begins at a time of day.
        from_second: It begins at this second of the day, local time; None for one that slides.
    """

    for_s: float = DAY_S
    from_second: float | None = None

    def began_s(self, before_s: float | None, now_s: float, wall: WallTime | None) -> float | None:
        """Return when it began, on the run's clock; None while the time of day that it begins at is not known.

        Args:
            before_s: The same in the cycle before. It stays, however two clocks are read one after the other.
        """
        if self.from_second is None:
            return now_s - self.for_s + _ROUNDING_S
        if wall is None:
            return None
        began_s = now_s - (wall.second_of_day - self.from_second) % DAY_S - _ROUNDING_S
        return before_s if before_s is not None and abs(began_s - before_s) < _CLOCK_CHANGE_S else began_s

    def __str__(self) -> str:
        """Return it in words, such as ``within 1 min``."""
        if self.from_second is None:
            return f"within {duration(self.for_s)}"
        return f"since {time_of_day(self.from_second)}" if self.from_second else "today"


class RememberedFigure(Struct, frozen=True, kw_only=True):
    """A statistic of a figure of a target within a window; or the sum of what rules did.

    Attributes:
        name: Its name in the configuration; of a sum, another one.
        rules: Of a sum: any of these rules.
        owner: Of a sum: the rule whose condition it is. A reset of that rule empties it.
        quantity: Of a sum: ``times`` that the rules were raised, or ``s`` that they were active.
        percentile: In percent, for a ``percentile``; 50 is the median.
    """

    name: str
    target: str = ""
    rules: tuple[str, ...] = ()
    owner: str = ""
    quantity: str = "distance"
    statistic: str = "minimum"
    percentile: float = 50.0
    window: Window = Window()

    def for_people(self, value: float | None) -> float | None:
        """Return a value as messages tell it: in the SI unit, but an angle in degrees."""
        return value if value is None or QUANTITIES[self.quantity].unit != "rad" else math.degrees(value)


class Summary(Struct, frozen=True, kw_only=True):
    """The record that is kept of one figure.

    Attributes:
        slots: The slots, oldest first, as bytes.
        value: The statistic; None without a value, and while it is not known when the window began.
        began_s: When the window began, on the run's clock; None for one that slides, and while that is not known.
    """

    slots: bytes = b""
    value: float | None = None
    began_s: float | None = None

    @property
    def newest_from_s(self) -> float | None:
        """The time at which the newest slot began; None without one."""
        return _SLOT.unpack_from(self.slots, len(self.slots) - _SLOT.size)[0] if self.slots else None

    def resume(self, figure: RememberedFigure, shift_s: float, now_s: float) -> Summary:
        """Return the same at the beginning of a run, with its times shifted to another clock.

        Its value is known at once, unless it goes by a time of day and another day may have begun.
        """
        packed = [_SLOT.pack(from_s + shift_s, *others) for from_s, *others in _SLOT.iter_unpack(self.slots)]
        slots = b"".join(packed)
        if figure.window.from_second is None:
            return step_summary(figure, Summary(slots=slots), None, now_s, None)
        if self.began_s is None or now_s >= (began_s := self.began_s + shift_s) + DAY_S:
            return Summary(slots=slots)
        return Summary(slots=slots, value=_statistic(figure, [*_SLOT.iter_unpack(slots)]), began_s=began_s)


def step_summary(
    figure: RememberedFigure, before: Summary, new: float | None, now_s: float, wall: WallTime | None
) -> Summary:
    """Return the summary after a cycle that brought a new value, or None; the same object if nothing has changed."""
    window, slots = figure.window, before.slots
    if new is None and not slots and window.from_second is None and before.value is not None:
        return before
    began_s = window.began_s(before.began_s, now_s, wall)
    while slots and began_s is not None and _SLOT.unpack_from(slots)[0] <= began_s:
        slots = slots[_SLOT.size :]
    if new is not None:
        slots = _with_value(slots, new, now_s, window.for_s / SLOTS)[-SLOTS * _SLOT.size :]
    anchor_s = None if window.from_second is None else began_s
    if slots is before.slots and anchor_s == before.began_s and before.value is not None:
        return before
    value = None if began_s is None else _statistic(figure, [*_SLOT.iter_unpack(slots)])
    return Summary(slots=slots, value=value, began_s=anchor_s)


def _with_value(slots: bytes, value: float, now_s: float, width_s: float) -> bytes:
    if slots:
        from_s, number, total, least, most = _SLOT.unpack_from(slots, len(slots) - _SLOT.size)
        if now_s < from_s + width_s:
            newest = _SLOT.pack(from_s, number + 1, total + value, min(least, value), max(most, value))
            return slots[: -_SLOT.size] + newest
    return slots + _SLOT.pack(now_s, 1, value, value, value)


def _statistic(figure: RememberedFigure, slots: list[tuple[float, ...]]) -> float | None:
    statistic = figure.statistic
    if statistic == "sum":
        return math.fsum([slot[2] for slot in slots])
    if not slots:
        return None
    if statistic == "minimum":
        return min([slot[3] for slot in slots])
    if statistic == "maximum":
        return max([slot[4] for slot in slots])
    number = math.fsum([slot[1] for slot in slots])
    if statistic == "mean":
        return math.fsum([slot[2] for slot in slots]) / number
    means = sorted([(slot[2] / slot[1], slot[1]) for slot in slots])
    left = figure.percentile / 100 * number
    below = accumulate([of_slot for _, of_slot in means])
    return next(mean for (mean, _), count in zip(means, below, strict=True) if count >= left)


class RememberedCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A remembered figure is within thresholds, as it was after the cycle before.

    Attributes:
        name: Its name; empty for what other rules did.
        rules: Those rules: any of them. In times, how often they were raised; in seconds, how long they were active.
        window: Within which they did it.
        owner: The rule whose condition it is.
        unit: The SI unit of the thresholds, which is that of the figure.
        quantity: What the figure with a name is of.
        above: Holds above this; None for no such threshold.
        below: Holds below this.
        deadband: How far it must come back before the condition ends.
    """

    name: str = ""
    rules: tuple[str, ...] = ()
    window: Window = Window()
    owner: str = ""
    unit: str = "m"
    quantity: str = "distance"
    above: float | None = None
    below: float | None = None
    deadband: float = 0.0

    is_by_cycle = True
    has_figures = has_noise = False
    section = "figure"
    probability_on = None  # how sure a remembered figure is, is not known
    bounds = (-MAX_SPEED_MPS, MAX_SPEED_MPS)

    @property
    def noun(self) -> str:
        """Its name, or what other rules did, such as ``raises of near within 1 min``."""
        did = "raises" if self.unit == "times" else "active time"
        return f"{did} of {' or '.join(self.rules)} {self.window}" if self.rules else f"figure {self.name}"

    @property
    def is_signed(self) -> bool:
        """True if the figure may be below zero; what others did counts as such, so that it ends at zero."""
        return bool(self.rules) or QUANTITIES[self.quantity].is_signed

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """Those of a figure with a name."""
        return () if self.rules else LimitsCondition.thresholds.__get__(self)

    @property
    def targets_named(self) -> tuple[str, ...]:
        """None: it is known though its target is out of sight."""
        return ()

    @property
    def rules_named(self) -> tuple[str, ...]:
        """Those whose deeds it sums up."""
        return self.rules

    @property
    def key(self) -> str:
        """The name of the figure."""
        return self.name or f"{self.owner}: {self.noun}"

    @property
    def remembered(self) -> RememberedFigure:
        """The sum of what other rules did."""
        return RememberedFigure(
            name=self.key, rules=self.rules, owner=self.owner, quantity=self.unit, statistic="sum", window=self.window
        )

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure, its standard deviation, which is not known, as 0; see `LimitsCondition.uncertain`."""
        value = inputs.figures.get(self.key)
        return None if value is None else (value, 0.0, 0.0)

    @property
    def subject(self) -> str:
        """The figure, or what others did."""
        if not self.rules:
            return f"`{self.noun}` is"
        names = " or ".join(f"`{rule}`" for rule in self.rules)
        return f"{names} was {'raised' if self.unit == 'times' else 'active for'}"

    @property
    def within(self) -> str:
        """The thresholds; of a count, which is above n - 1, the number n itself."""
        if self.rules:
            return f"{'at least' if self.unit == 'times' else 'more than'} {self._least} {self.window}"
        return Leaf.within.fget(self)  # type: ignore[attr-defined, no-any-return]

    @property
    def _least(self) -> str:
        low, _ = self.limits
        return f"{low + 1:g} times" if self.unit == "times" else duration(low)

    @property
    def ends(self) -> str:
        """A clause on the figures that it must come back to."""
        if self.rules:
            return f"{self.subject} {'fewer' if self.unit == 'times' else 'less'} than {self._least} {self.window}"
        return f"{self.subject} {back_words(self, self.deadband, self.deadband_sigmas)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:
        """Return the figure and the thresholds; of a count, how many of how many. See `Leaf.verdict`."""
        reading = self.reading(inputs, is_on)
        if reading is not None and self.unit == "times" and math.isfinite(reading.low):
            return f"{' or '.join(self.rules)} raised {reading.value:g} of {reading.low + 1:g} times {self.window}"
        return Leaf.verdict(self, inputs, is_on, names_target=names_target, with_probability=with_probability)

    def unread(self, inputs: RuleInputs, named: str) -> str:  # noqa: ARG002 - it is about no target
        """Return that it is not known."""
        return f"{self.noun} is not known"
