"""The smallest change of a rule's threshold, delays and deadband that meets all marks.

Smallest means, in this order: the fewest alarms that change where nothing is marked, in the recordings with marks; the
least cost, which is the number of settings that change, times `SETTING_COST`, and how far alarms are off the middle of
marked spans, each as a share of half its span; and the least change, as the sum of the logarithms of ratios. Of those
that do as well, the centre is taken, rounded as far as they allow: the furthest from being wrong on any side.

Thresholds come from the order statistics of the signal: alarms change only where the threshold passes a figure that the
signal keeps to for as long as the delay. On-delays come from how long the signal stayed, and had stayed halfway through
a mark; deadbands and off-delays from how far and for how long it left between two alarms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
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

# How many values of each kind are tried: thresholds and on-delays all with each other; then each setting by itself
# around the best of these, and once more around the best of those. These 600 settings, and 500 to find the centre, take
# 1.3 s for three recordings of eight minutes at five frames a second (x86, 3 GHz).
THRESHOLDS_MAX, DELAYS_MAX, MARKED_MAX, BEST_MAX, ROUNDS = 40, 12, 4, 12, 2

# A further setting changes only if that brings alarms nearer to the middle of marked spans by more than this many half
# spans in all. An alarm that meets its mark is at most one off, so two spans alone never show it: people mark some
# widely. In the benchmark, 1 in place of 2 gave as many equal scenes (seeds 1101 to 1160).
SETTING_COST = 2.0

# The centre is sought for this many sets of settings, as each takes half a second, if they may cost less than the best.
CENTRED_MAX = 4

# Thresholds are sought once in this time of the signal, if it is a turning point there.
BLOCK_S = 2.0

# Delays (s), deadbands (as a share of the threshold) and standard deviations are compared as if they were larger by
# this: from 0 to a tenth of it is no larger a change than of a threshold from 1 m to 1.1 m.
DELAY_SIZE_S, BAND_SIZE, SIGMAS_SIZE = 1.0, 0.1, 1.0

# Figures and times that differ by less than this share are not separated, unless the marks leave no other way: noise
# would decide between them.
APART = 0.05

# The centre is sought among this many settings, drawn this many times from a box that shrinks around the best. It ends
# where a setting changes by this many times what is needed: where nothing speaks against more, there is a limit.
DRAWS, SHRINKS, NEEDED_TIMES = 60, 8, 3
_BISECTIONS = 9

Values = Mapping[str, float]
SoughtCondition = DistanceCondition | FigureCondition


class Taught(Struct, frozen=True, kw_only=True, eq=False):
    """A recording with marks, and the alarms of the rule as it is."""

    signal: Signal
    marks: Sequence[FiringMark]
    before: Sequence[Firing]


class Score(NamedTuple):
    """Rating of settings; the least is the best."""

    unmet: int
    elsewhere: int
    cost: float
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
        good: list[Tried] = []
        for least in (APART, 0.0):
            if not good:
                self._try_all(least)
                good = [each for each in self._best(len(self.tried)) if not each.score.unmet]
        by_keys = {tuple(sorted(each.values)): each for each in reversed(good)}
        smallest = sorted(map(self._nearest, by_keys.values()), key=attrgetter("score"))
        centred: list[Tried] = []
        for each in smallest:
            least_cost = min((other.score.cost for other in centred), default=math.inf)
            if len(centred) < CENTRED_MAX and SETTING_COST * len(each.values) < least_cost:
                centred.append(self._centre(each))
        centred.sort(key=attrgetter("score"))
        yield from (each.values for each in (*centred, *smallest, *good[:BEST_MAX]))

    def _try_all(self, least: float) -> None:
        self.attempt({})
        thresholds = list(thresholds_of(self.rule))
        for key in thresholds:
            for at in self._candidates(key, {}, least):
                for delay_s in self._candidates("on_delay", {key: at}, least):
                    self.attempt({key: at, "on_delay": delay_s})
        for _ in range(ROUNDS):
            for tried in self._best(BEST_MAX):
                for key in (*thresholds, "on_delay", "off_delay", self._band_key, self._sigmas_key):
                    for value in self._candidates(key, tried.values, least):
                        self.attempt({**tried.values, key: value})

    def _best(self, count: int) -> list[Tried]:
        return sorted(self.tried.values(), key=attrgetter("score"))[:count]

    def attempt(self, values: Values) -> Tried:
        """Find how good settings are; those that are the rule's own do not count as changed."""
        changed = {key: value for key, value in values.items() if value != self._own[key]}
        asked = tuple(sorted(changed.items()))
        if asked not in self.tried:
            rule, condition = self._with(changed)
            met: list[bool] = []
            elsewhere, cost = 0, SETTING_COST * len(changed)
            for each in self.taught:
                firings = each.signal.firings(rule, condition)
                met += [is_met(mark, firings, each.marks) for mark in each.marks]
                elsewhere += _count_elsewhere(each, firings)
                cost += sum(mark.off(firing) for mark in each.marks for firing in firings if mark.wants(firing))
            size = sum(abs(self._place(key, value) - self._place(key, self._own[key])) for key, value in asked)
            self.tried[asked] = Tried(changed, Score(met.count(False), elsewhere, cost, size), tuple(met))
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

    @property
    def _sizes(self) -> dict[str, float]:
        """By what settings that may be 0 are compared as if they were larger."""
        limit = next(abs(limit) for limit in self.condition.limits if math.isfinite(limit))
        delays = dict.fromkeys(("on_delay", "off_delay"), DELAY_SIZE_S)
        return {**delays, self._band_key: BAND_SIZE * (limit or 1.0), self._sigmas_key: SIGMAS_SIZE}

    def _with(self, values: Values) -> tuple[AlarmRule, SoughtCondition]:
        rule = move(self.rule, values)
        if "on_delay" in values:
            rule = replace(rule, on_delay=OnDelay(hold_s=values["on_delay"]))
        rule = replace(rule, off_delay_s=values.get("off_delay", rule.off_delay_s))
        condition = rule.condition
        if not isinstance(condition, SoughtCondition):
            raise TypeError(f"the rule {rule.name} has no limit on one figure")  # checked before
        band = values.get(self._band_key, condition.deadband)
        sigmas = values.get(self._sigmas_key, condition.deadband_sigmas)
        return rule, replace(condition, deadband=band, deadband_sigmas=sigmas)

    def _place(self, key: str, value: float) -> float:
        """Return where a value is on the scale on which changes are compared: that of ratios."""
        size = self._sizes.get(key, 0.0 if value > 0 else abs(self._own[key]) or 1.0)
        return math.log(max(value, 0.0) + size)

    def _candidates(self, key: str, values: Values, least: float) -> list[float]:
        """Return values of a setting between which alarms change, and the rule's own; see the module."""
        own = self._own[key]
        if key in thresholds_of(self.rule):
            return [own, *_thin(_between(self._crossings(key), least), THRESHOLDS_MAX)]
        if key == self._sigmas_key:
            return [own, 0.0]
        is_band = key == self._band_key
        figures = self._ways_off(values) if is_band else self._lengths(values, is_off=key == "off_delay")
        found = _thin(_between(figures, least), DELAYS_MAX)
        if key == "on_delay":
            found += _thin(sorted(self._waited(values)), MARKED_MAX)
        return [own, 0.0, *(max(0.0, each) for each in found)]

    def _crossings(self, key: str) -> set[float]:
        side = 1.0 if thresholds_of(self.rule)[key].place.field == "below" else -1.0
        found: set[float] = set()
        for each in self.taught:
            crossed = each.signal.crossed_at(self.condition, side)
            marked = (crossed[_in_span(each.signal.at_s, mark)] for mark in each.marks)
            found |= {side * float(figures.min()) for figures in marked if len(figures)}
            found |= {side * float(lowest) for lowest in _turning_points(each.signal.at_s, crossed)}
        return found

    def _lengths(self, values: Values, *, is_off: bool) -> set[float]:
        """Return for how long the figure stayed within the threshold, or off it between two alarms."""
        rule, condition = self._with(values)
        return {
            length
            for each in self.taught
            for length in each.signal.lengths(
                each.signal.within(condition, is_on=is_off) != is_off, rule.delay_tolerance
            )
            if not is_off or length < JOINED_S
        }

    def _waited(self, values: Values) -> set[float]:
        """Return for how long the figure had been within the threshold halfway through each mark that should fire."""
        rule, condition = self._with(values)
        found = set[float]()
        for each in self.taught:
            middles_s = [(mark.from_s + mark.to_s) / 2 for mark in each.marks if mark.should_fire]
            for first, last in each.signal.runs(each.signal.within(condition, is_on=False), rule.delay_tolerance):
                begin_s, end_s = map(float, each.signal.at_s[[first, last]])
                found |= {at_s - begin_s for at_s in middles_s if begin_s <= at_s <= end_s}
        return found

    def _ways_off(self, values: Values) -> set[float]:
        """Measure how far the figure went off from one alarm to the next."""
        rule, condition = self._with({**values, self._band_key: 0.0})
        return {
            each.signal.way_off(condition, cleared_s - rule.off_delay_s, raised_s)
            for each in self.taught
            for (_, cleared_s), (raised_s, _) in pairwise(each.signal.firings(rule, condition))
            if raised_s - cleared_s < JOINED_S
        }

    def _nearest(self, found: Tried) -> Tried:
        """Return settings that are as good, each the rule's own or as near to it as it may be."""
        for key in found.values:
            near, middle, far = self._own[key], self._own[key], found.values[key]
            for _ in range(_BISECTIONS):
                tried = self.attempt({**found.values, key: middle})
                if tried.score < found.score:
                    far, found = middle, tried
                else:
                    near = middle
                middle = (near + far) / 2
        return found

    def _centre(self, found: Tried) -> Tried:
        """Return the centre of the settings that are as good, and best in time."""
        keys, random = list(found.values), np.random.default_rng(0)
        own, value = (np.array([source[key] for key in keys]) for source in (self._own, found.values))
        floor, ceiling = np.sort([own, own + NEEDED_TIMES * (value - own)], axis=0)
        low, high, centre = floor, ceiling, dict(found.values)
        good = [found]
        for _ in range(SHRINKS if keys else 0):
            tried = [self._attempt_at(keys, draw) for draw in random.uniform(low, high, (DRAWS, len(keys)))]
            good += [each for each in tried if each.score[:2] == found.score[:2]]
            best = [each for each in good if each.score.cost == min(other.score.cost for other in good)]
            near = np.array([[each.values[key] for key in keys] for each in best])
            wider = (high - low) / 4
            low, high = np.maximum(floor, near.min(0) - wider), np.minimum(ceiling, near.max(0) + wider)
            centre = dict(zip(keys, map(_roundest, near.mean(0), near.max(0) - near.min(0)), strict=True))
        middle = self.attempt(centre)
        return middle if middle.score[:2] == found.score[:2] else best[0]

    def _attempt_at(self, keys: Sequence[str], draw: Floats) -> Tried:
        """Try settings that were drawn; what may not be below 0 is 0 then."""
        values = zip(keys, map(float, draw), strict=True)
        return self.attempt({key: max(value, 0.0) if key in self._sizes else value for key, value in values})

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
    """Count the alarms that came or went and that no mark is about."""
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


def _between(values: Iterable[float], least: float) -> list[float]:
    """Return a value between each two that follow each other and are apart, and one beyond each end.

    Args:
        least: How far apart at least, as a share of the larger.
    """
    found = sorted(values)
    between = [(low + high) / 2 for low, high in pairwise(found) if high - low > least * abs(high)]
    return [found[0] - abs(found[0]) / 20, *between, found[-1] + abs(found[-1]) / 20] if found else []


def _thin(values: Sequence[float], most: int) -> list[float]:
    """Return at most this number of some values, evenly out of their order."""
    return (
        list(values) if len(values) <= most else [values[round(each)] for each in np.linspace(0, len(values) - 1, most)]
    )


def _roundest(middle: float, width: float) -> float:
    """Return the number with the fewest digits in the central third of a range; none has more than six."""
    rounded = (float(f"{middle:.{digits}g}") for digits in range(1, 7))
    return next((each for each in rounded if abs(each - middle) <= width / 6), float(f"{middle:.6g}"))
