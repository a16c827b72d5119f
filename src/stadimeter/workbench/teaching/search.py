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
import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter, itemgetter
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.config.units import parse_duration
from stadimeter.core.alarms.settings import move, thresholds_of
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import ROUNDING_S, AlarmRule, DelayTolerance, OnDelay
from stadimeter.core.words import figure_in_words
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.replay.comparison import SAME_WITHIN_S
from stadimeter.workbench.replay.what_if import KeptCycle

# When an alarm would have fired on the signal of a recording, quickly enough to try thousands of settings -------------
#
# The figures of the rule's condition are gathered once. For one setting, whether the condition would begin and
# whether it would go on are two comparisons of whole arrays; delays are then counted over runs, not over samples.
# This leaves out what seldom matters (inhibits, chattering, the policy for a lost target), so what is found is
# always checked by the rules themselves.

# Marks in recordings: where an alarm should have fired, and where not -------------------------------------------------

# A person who points at a moment is this far off.
MOMENT_S = 1.0

# An alarm goes on from one moment to another that is at most this much later; longer, and it would be another visit.
JOINED_S = 30.0

# When it was raised, and when it was cleared, since the beginning of the recording.
Firing = tuple[float, float]

_MARK = re.compile(r"(?P<recording>[^@]+)@(?P<from>[^@]+?)(?:\.\.(?P<to>[^@]+?))?\s+(?P<what>fire|no)")


class FiringMark(Struct, frozen=True, kw_only=True):
    """A moment or a span of a recording.

    A span that should have fired wants an alarm raised in it; a moment, one that stands. Where it should not have, no
    alarm may stand, except one that goes on from shortly before, and that another mark wants there.

    Attributes:
        recording: The name of its file.
        to_s: The end of a span; equal to `from_s` for a moment.
    """

    recording: str
    from_s: float
    to_s: float
    should_fire: bool

    @property
    def is_moment(self) -> bool:
        """True if it is a moment, not a span."""
        return self.from_s == self.to_s

    @property
    def words(self) -> str:
        """The mark as it is written for ``teach --mark``."""
        span = "" if self.is_moment else f"..{self.to_s:.4g}s"
        return f"{self.recording}@{self.from_s:.4g}s{span} {'fire' if self.should_fire else 'no'}"

    def touches(self, firing: Firing) -> bool:
        """Check whether an alarm stood in it, or nearly."""
        off_s = MOMENT_S if self.is_moment else 0.0
        return firing[0] <= self.to_s + off_s and firing[1] >= self.from_s - off_s

    def wants(self, firing: Firing) -> bool:
        """Check whether an alarm is the one that should have fired."""
        if not self.should_fire:
            return False
        return self.touches(firing) if self.is_moment else self.from_s <= firing[0] <= self.to_s

    def off(self, firing: Firing) -> float:
        """Return the distance of an alarm from the middle of a span, as a share of half of it; 0 for a moment."""
        return 0.0 if self.is_moment else abs(2 * firing[0] - self.from_s - self.to_s) / (self.to_s - self.from_s)


def parse_mark(text: str) -> FiringMark:
    """Read a mark such as ``run.mcap@14.2s fire`` or ``run.mcap@14s..20s no``; `ConfigError` if it is none."""
    hint = 'write a moment, "run.mcap@14.2s fire", or a span, "run.mcap@14s..20s no"'
    match = _MARK.fullmatch(text.strip())
    if match is None:
        raise ConfigError([Problem(f"{text!r} is no mark", hint=hint)])
    try:
        from_s, to_s = (parse_duration(each) for each in (match["from"], match["to"] or match["from"]))
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is no mark: {error}", hint=hint)]) from error
    if to_s < from_s:
        raise ConfigError([Problem(f"{text!r} ends before it begins", hint=hint)])
    return FiringMark(recording=match["recording"], from_s=from_s, to_s=to_s, should_fire=match["what"] == "fire")


def is_met(mark: FiringMark, firings: Sequence[Firing], marks: Sequence[FiringMark]) -> bool:
    """Check whether an alarm did what a mark says.

    Args:
        firings: Those in its recording.
        marks: All marks.
    """
    if mark.should_fire:
        return any(mark.wants(firing) for firing in firings)
    here = [each for each in marks if each.recording == mark.recording]
    before = [each for each in here if mark.from_s - JOINED_S <= each.from_s < mark.from_s]
    return not any(mark.touches(firing) and not any(each.wants(firing) for each in before) for firing in firings)


Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Signal(Struct, frozen=True, kw_only=True, eq=False):
    """The figure of a condition in the frames of a recording in which it was known.

    Attributes:
        at_s: Since the beginning of the recording.
        judged_s: The same without the time in which it was not known, which counts for no delay.
        begins: The positions before which it was not known for longer than the grace: delays begin anew.
    """

    at_s: Floats
    judged_s: Floats
    value: Floats
    sigma: Floats
    noise: Floats
    begins: Floats

    def within(self, condition: LimitsCondition, *, is_on: bool) -> Flags:
        """Return where a condition would begin, or, if `is_on`, go on."""
        low, high = condition.limits
        sure = condition.probability_on
        if sure is not None and is_on:
            sure = min(sure, condition.probability_off)
        guard = self._guard(sure)
        inside = np.ones(len(self.value), np.bool_)
        for limit, side in ((high, 1.0), (low, -1.0)):
            if np.isfinite(limit):
                band = self._deadband(condition, limit) if is_on else 0.0
                inside &= side * (self.value - limit) + guard <= band
        return inside

    def crossed_at(self, condition: LimitsCondition, side: float) -> Floats:
        """Return the least threshold, times the side (-1 for a lower one), with which a condition would begin there."""
        found: Floats = side * self.value + self._guard(condition.probability_on)
        return found

    def lengths(self, flags: Flags, tolerance: DelayTolerance) -> set[float]:
        """Return the length of each stretch that holds."""
        return {float(self.judged_s[last] - self.judged_s[first]) for first, last in self.runs(flags, tolerance)}

    def way_off(self, condition: LimitsCondition, from_s: float, to_s: float) -> float:
        """Measure how far beyond a threshold the figure went in a time."""
        begin, end = np.searchsorted(self.at_s, [from_s, to_s])
        low, high = condition.limits
        gone = np.maximum(self.value - high, low - self.value)[begin:end]
        return float(gone.max(initial=0.0))

    def _guard(self, sure: float | None) -> Floats:
        """Return by how much a figure must be inside: p's quantile of standard deviations, for a probability p."""
        found: Floats = (0.0 if sure is None else NormalDist().inv_cdf(sure)) * self.sigma
        return found

    def _deadband(self, condition: LimitsCondition, limit: float) -> Floats:
        scale = np.ones(len(self.value))
        if isinstance(condition, DistanceCondition):  # its noise grows with the square of the distance
            scale = np.clip(limit / np.maximum(self.value, 1e-9), 0.5, 2.0) ** 2
        found: Floats = np.maximum(condition.deadband, condition.deadband_sigmas * self.noise * scale)
        return found

    def runs(self, flags: Flags, tolerance: DelayTolerance) -> list[tuple[int, int]]:
        """Return the first and the last position of each stretch that holds, forgiven noise included."""
        edges = np.flatnonzero(np.diff(flags, prepend=False, append=False)).tolist()
        found: list[tuple[int, int]] = []
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            parts = [first, *self.begins[(self.begins > first) & (self.begins < end)].astype(int).tolist(), end]
            for start, stop in pairwise(parts):
                if found and start == first and self._is_forgiven(found[-1][1], start, tolerance):
                    found[-1] = found[-1][0], stop - 1
                else:
                    found.append((start, stop - 1))
        return found

    def _is_forgiven(self, before: int, after: int, tolerance: DelayTolerance) -> bool:
        if np.any((self.begins > before) & (self.begins <= after)):
            return False
        return tolerance.forgives(after - before - 1, float(self.judged_s[after - 1] - self.judged_s[before]))

    def firings(self, rule: AlarmRule, condition: LimitsCondition) -> list[Firing]:
        """Return when a rule would have been raised and cleared with this condition."""
        begins = self.within(condition, is_on=False)
        ends = ~(self.within(condition, is_on=True) | begins)
        frames, of_frames = rule.on_delay.frames, rule.on_delay.of_frames
        if frames:
            begins = begins & (np.convolve(begins, np.ones(of_frames, int))[: len(begins)] >= frames)
        on, off = self.runs(begins, rule.delay_tolerance), self.runs(ends, rule.delay_tolerance)
        found: list[Firing] = []
        at, count = -1, len(self.at_s)
        while (raised := self._due(begins, on, at + 1, rule.on_delay.hold_s)) < count:
            at = self._due(ends, off, raised + 1, rule.off_delay_s)
            found.append((float(self.at_s[raised]), float(self.at_s[min(at, count - 1)])))
        return found

    def _due(self, flags: Flags, runs: Sequence[tuple[int, int]], begin: int, delay_s: float) -> int:
        """Return the first position, counted from one on, at which a flag was set for as long as a delay; the end."""
        for first, last in runs[max(0, bisect_right(runs, begin, key=itemgetter(0)) - 1) :]:
            start = max(first, begin)
            if start <= last:
                due = max(start, int(np.searchsorted(self.judged_s, self.judged_s[start] + delay_s - ROUNDING_S)))
                there = np.flatnonzero(flags[due : last + 1])
                if len(there):
                    return due + int(there[0])
        return len(flags)


def signal_of(cycles: Sequence[KeptCycle], rule: AlarmRule, condition: LimitsCondition) -> Signal:
    """Return the figure of a rule's condition through a recording."""
    rows: list[tuple[float, float, float, float, float]] = []
    begins: list[int] = []
    judged_s, unknown_s, was_known = 0.0, 0.0, False
    for at_s, by, _ in cycles:
        if by.sample is None:
            continue
        known = condition.uncertain(by.inputs)
        if known is None:
            was_known, unknown_s = False, unknown_s + by.sample.since_s
            continue
        if by.inputs.tracks[rule.target].rejected > 0:  # passed over: its own time counts for no delay
            continue
        judged_s += by.sample.since_s if was_known else 0.0
        if unknown_s > rule.lost.grace_s:
            begins.append(len(rows))
        rows.append((at_s, judged_s, *known))
        unknown_s, was_known = 0.0, True
    table = np.array(rows, np.float64).reshape(-1, 5)
    at, judged, value, sigma, noise = table.T
    return Signal(at_s=at, judged_s=judged, value=value, sigma=sigma, noise=noise, begins=np.array(begins, np.float64))


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
