"""The smallest change of a rule's threshold, delays and deadband that meets all marks.

Smallest means, in this order: the fewest alarms that change where nothing is marked, in the recordings with marks; the
fewest settings that change; and the least change of these: the sum of the logarithms of their ratios, and of the mean
time in seconds by which alarms are off the middle of marked spans. Of all values of a setting that give the same
alarms, the central one is taken, rounded as far as they allow: the furthest from being wrong on either side.

Thresholds come from the order statistics of the signal: alarms change only where the threshold passes a figure that the
signal keeps to for as long as the delay. Delays come from how long the signal stayed, deadbands and off-delays from how
far and for how long it left between two alarms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, product
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.alarms.settings import move, thresholds_of
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.core.words import figure_in_words
from stadimeter.workbench.replay.comparison import SAME_WITHIN_S
from stadimeter.workbench.teaching.marks import JOINED_S, MOMENT_S, Firing, FiringMark, is_met
from stadimeter.workbench.teaching.signal import Floats, Signal

# How many values of each kind are tried: thresholds and on-delays all with each other, then off-delays and deadbands
# with the best of these. These 1,000 settings take 4 s on a recording of ten minutes (x86, 3 GHz).
THRESHOLDS_MAX, ON_DELAYS_MAX, OFF_DELAYS_MAX, DEADBANDS_MAX, BEST_MAX = 40, 12, 6, 6, 12

# Thresholds are sought once in this time of the signal, if it is a turning point there.
BLOCK_S = 2.0

# Delays (s) and deadbands (as a share of the threshold) are compared as if they were longer by this: from 0 to a tenth
# of it is no larger a change than of a threshold from 1 m to 1.1 m.
DELAY_SIZE_S, BAND_SIZE = 1.0, 0.1

# Figures and times that differ by less than this share are not separated, unless the marks leave no other way: noise
# would decide between them.
APART = 0.05

DELAYS = ("on_delay", "off_delay")
_BISECTIONS = 9
Values = Mapping[str, float]
SoughtCondition = DistanceCondition | FigureCondition


class Taught(Struct, frozen=True, kw_only=True, eq=False):
    """A recording with marks, and the alarms of the rule as it is."""

    signal: Signal
    marks: Sequence[FiringMark]
    before: Sequence[Firing]


class Score(NamedTuple):
    """How good settings are; the least is the best."""

    unmet: int
    elsewhere: int
    changed: int
    size: float


class Tried(NamedTuple):
    """Settings that were tried: those that differ from the rule's, by name; and which marks they meet."""

    values: Values
    score: Score
    met: tuple[bool, ...]


class SettingSearch(Struct, kw_only=True):
    """Tries settings of an alarm on one limit, on recordings with marks."""

    rule: AlarmRule
    condition: SoughtCondition
    taught: Sequence[Taught]
    tried: dict[tuple[tuple[str, float], ...], Tried] = field(default_factory=dict)

    def best(self) -> Iterator[Values]:
        """Yield settings that meet all marks, the smallest change first."""
        for least in (APART, 0.0):
            self._try_all(least)
            good = [each for each in self._best(BEST_MAX) if not each.score.unmet]
            if good:
                break
        for each in good:
            yield self._centred(each)
        yield from (each.values for each in good)

    def _try_all(self, least: float) -> None:
        self.attempt({})
        for values in self._other_thresholds({}, least):
            for delay_s in self._delays("on_delay", values, least):
                self.attempt({**values, "on_delay": delay_s})
        for tried in self._best(BEST_MAX):
            off_delays = self._delays("off_delay", tried.values, least)
            for off_s, band in product(off_delays, self._deadbands(tried.values, least)):
                self.attempt({**tried.values, "off_delay": off_s, **band})
        for tried in self._best(BEST_MAX // 2):  # once more around what came out, one setting after the other
            for values in self._other_thresholds(tried.values, least):
                self.attempt(values)
            for delay_s in self._delays("on_delay", tried.values, least):
                self.attempt({**tried.values, "on_delay": delay_s})

    def _best(self, count: int) -> list[Tried]:
        return sorted(self.tried.values(), key=attrgetter("score"))[:count]

    def attempt(self, values: Values) -> Tried:
        """Return how good settings are; those that are the rule's own do not count as changed."""
        changed = {key: value for key, value in values.items() if value != self._own[key]}
        asked = tuple(sorted(changed.items()))
        if asked not in self.tried:
            rule, condition = self._with(changed)
            met: list[bool] = []
            elsewhere, off_s = 0, [0.0]
            for each in self.taught:
                firings = each.signal.firings(rule, condition)
                met += [is_met(mark, firings, each.marks) for mark in each.marks]
                elsewhere += _count_elsewhere(each, firings)
                off_s += [mark.off_s(firing) for mark in each.marks for firing in firings if mark.wants(firing)]
            size = sum(abs(self._place(key, value) - self._place(key, self._own[key])) for key, value in asked)
            self.tried[asked] = Tried(
                changed, Score(met.count(False), elsewhere, len(changed), size + sum(off_s) / len(off_s)), tuple(met)
            )
        return self.tried[asked]

    @property
    def _band_key(self) -> str:
        return f"{self.condition.section}.deadband" if self.condition.section else "deadband"

    @property
    def _sigmas_key(self) -> str:
        return f"{self._band_key}_sigmas"

    @property
    def _own(self) -> dict[str, float]:
        found = {key: each.value for key, each in thresholds_of(self.rule).items()}
        found |= {"on_delay": self.rule.on_delay.hold_s, "off_delay": self.rule.off_delay_s}
        return found | {self._band_key: self.condition.deadband, self._sigmas_key: self.condition.deadband_sigmas}

    def _with(self, values: Values) -> tuple[AlarmRule, SoughtCondition]:
        rule = move(self.rule, values)
        if "on_delay" in values:
            rule = replace(rule, on_delay=OnDelay(hold_s=values["on_delay"]))
        rule = replace(rule, off_delay_s=values.get("off_delay", rule.off_delay_s))
        condition = rule.condition
        if not isinstance(condition, SoughtCondition):
            raise TypeError(f"the rule {rule.name} has no limit on one figure")  # checked before
        name = "deadband_m" if isinstance(condition, DistanceCondition) else "deadband"
        band = values.get(self._band_key, condition.deadband)
        sigmas = values.get(self._sigmas_key, condition.deadband_sigmas)
        return rule, replace(condition, **{name: band, "deadband_sigmas": sigmas})

    def _place(self, key: str, value: float) -> float:
        """Return where a value is on the scale on which changes are compared: that of ratios."""
        limits = [abs(limit) for limit in self.condition.limits if math.isfinite(limit)]
        scales = {**dict.fromkeys(DELAYS, DELAY_SIZE_S), self._sigmas_key: 1.0, self._band_key: BAND_SIZE * limits[0]}
        if key in scales or value <= 0:
            return math.log(max(value, 0.0) + (scales.get(key) or limits[0] or 1.0))
        return math.log(value)

    def _other_thresholds(self, values: Values, least: float) -> Iterator[Values]:
        return ({**values, key: at} for key in thresholds_of(self.rule) for at in self._thresholds(key, least))

    def _thresholds(self, key: str, least: float) -> list[float]:
        """Return a threshold between each two figures at which alarms change, and the rule's own."""
        side = 1.0 if thresholds_of(self.rule)[key].place.field == self.condition.ends[1] else -1.0
        turns: set[float] = set()
        for each in self.taught:
            crossed = each.signal.crossed_at(self.condition, side)
            for mark in each.marks:
                marked = crossed[_in_span(each.signal.at_s, mark)]
                turns |= {side * float(marked.min())} if len(marked) else set()
            turns |= {side * float(lowest) for lowest in _turning_points(each.signal.at_s, crossed)}
        return [self._own[key], *_thin(_between(turns, least, is_open=True), THRESHOLDS_MAX)]

    def _delays(self, key: str, values: Values, least: float) -> list[float]:
        """Return delays between the lengths of visits; off-delays, of the gaps within one, and one beyond each end."""
        rule, condition = self._with(values)
        is_off = key == "off_delay"
        lengths: set[float] = set()
        for each in self.taught:
            flags = each.signal.within(condition, is_on=is_off) != is_off
            lengths |= each.signal.lengths(flags, rule.delay_tolerance)
        if not is_off:
            return [self._own[key], 0.0, *_thin(_between(lengths, least), ON_DELAYS_MAX)]
        gaps = {length for length in lengths if length < JOINED_S}
        return [self._own[key], *_thin(_between(gaps, least, is_open=True), OFF_DELAYS_MAX)]

    def _deadbands(self, values: Values, least: float) -> list[Values]:
        """Return deadbands between the ways that the figure went off from one alarm to the next."""
        none: Values = {self._band_key: 0.0, self._sigmas_key: 0.0}
        rule, condition = self._with({**values, **none})
        ways: set[float] = set()
        for each in self.taught:
            for (_, cleared_s), (raised_s, _) in pairwise(each.signal.firings(rule, condition)):
                if raised_s - cleared_s < JOINED_S:
                    ways.add(each.signal.way_off(condition, cleared_s - rule.off_delay_s, raised_s))
        found = _thin(_between(ways, least, is_open=True), DEADBANDS_MAX)
        return [{}, none, {self._band_key: 0.0}, *({self._band_key: max(0.0, way)} for way in found)]

    def _centred(self, found: Tried) -> Values:
        """Return the same settings with each value central among those that give the same alarms."""
        values = dict(found.values)
        for key, value in found.values.items():
            if key == self._sigmas_key:
                continue
            floor = 0.0 if key in {*DELAYS, self._band_key} else value - abs(value) / 2

            def is_same(other: float, key: str = key) -> bool:
                return self.attempt({**values, key: other}).score[:2] == found.score[:2]

            low, is_low_open = _edge(is_same, value, floor)
            high, is_high_open = _edge(is_same, value, value + abs(value) + DELAY_SIZE_S / 10)
            own = self._own[key]
            if is_high_open and own < low:  # nothing speaks against more, so no more is taken than half as much again
                high = min(high, low + (low - own))
            if is_low_open and own > high and key not in DELAYS:
                low = max(low, high - (own - high))
            rounded = _roundest(low, high)
            if is_same(rounded):
                values[key] = rounded
        return values

    def contradiction(self) -> list[FiringMark]:
        """Return two marks that no settings that were tried meet both; or one; none if it is more than two."""
        marks = [mark for each in self.taught for mark in each.marks]
        met = np.array([each.met for each in self.tried.values()], bool)
        alone = [mark for column, mark in enumerate(marks) if not met[:, column].any()]
        pairs = (
            (abs(first.from_s - second.from_s), [first, second])
            for row, first in enumerate(marks)
            for column, second in enumerate(marks[row + 1 :], row + 1)
            if not np.any(met[:, row] & met[:, column])
        )
        return alone[:1] or min(pairs, key=lambda pair: pair[0], default=(0.0, []))[1]

    def describe(self, mark: FiringMark) -> str:
        """Say how the figure was at a mark: how far it went, and for how long it was within the threshold."""
        signal = next(each.signal for each in self.taught if mark in each.marks)
        there = _in_span(signal.at_s, mark)
        if not there.any():
            return f"at {mark.words} the {self.condition.noun} was not known"
        values = signal.value[there]
        extreme = values.min() if math.isfinite(self.condition.limits[1]) else values.max()
        within = signal.within(self.condition, is_on=False) & there
        for_s = max(signal.lengths(within, self.rule.delay_tolerance), default=0.0)
        far = figure_in_words(float(extreme), self.condition.unit)
        return (
            f"at {mark.words} the {self.condition.noun} reached {far}, and was within the threshold for {for_s:.1f} s"
        )


def _count_elsewhere(taught: Taught, after: Sequence[Firing]) -> int:
    """Return how many alarms that no mark is about came or went."""
    return sum(
        not any(mark.touches(firing) for mark in taught.marks)
        and not any(abs(firing[0] - other[0]) <= SAME_WITHIN_S for other in others)
        for firings, others in ((taught.before, after), (after, taught.before))
        for firing in firings
    )


def _in_span(at_s: Floats, mark: FiringMark) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    off_s = MOMENT_S if mark.is_moment else 0.0
    return (at_s >= mark.from_s - off_s) & (at_s <= mark.to_s + off_s)


def _turning_points(at_s: Floats, crossed: Floats) -> Iterator[float]:
    """Yield the least figure of each block of time whose neighbours have none that is less."""
    if len(at_s):
        starts = np.unique(np.searchsorted(at_s, np.arange(at_s[0], at_s[-1], BLOCK_S)))
        least = np.minimum.reduceat(crossed, starts) if len(starts) else crossed[:1]
        padded = np.concatenate([[np.inf], least, [np.inf]])
        yield from least[(padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])]


def _between(values: Iterable[float], least: float, *, is_open: bool = False) -> list[float]:
    """Return a value between each two that follow each other and are apart; if `is_open`, one beyond each end too.

    Args:
        least: How far apart at least, as a share of the larger.
    """
    found = sorted(values)
    between = [(low + high) / 2 for low, high in pairwise(found) if high - low > least * abs(high)]
    return [found[0] - abs(found[0]) / 20, *between, found[-1] + abs(found[-1]) / 20] if is_open and found else between


def _thin(values: Sequence[float], most: int) -> list[float]:
    """Return at most this number of some values, evenly out of their order."""
    if len(values) <= most:
        return list(values)
    return [values[round(each)] for each in np.linspace(0, len(values) - 1, most)]


def _edge(is_same: Callable[[float], bool], inside: float, outside: float) -> tuple[float, bool]:
    """Return up to where a value may go on the way outside, and whether that is all the way."""
    if is_same(outside):
        return outside, True
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if is_same(middle) else (inside, middle)
    return inside, False


def _roundest(low: float, high: float) -> float:
    """Return the number with the fewest digits in the central third of a range."""
    middle, third = (low + high) / 2, abs(high - low) / 6
    rounded = (float(f"{middle:.{digits}g}") for digits in range(1, 7))
    return next((each for each in rounded if abs(each - middle) <= third), middle)
