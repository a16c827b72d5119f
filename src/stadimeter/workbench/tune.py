"""Tuning an alarm on recordings: thresholds, delays and deadbands are tried, and the few best are shown.

With marks ("should have fired", "should not") a setting is good if it meets them all. Without, it is good if the alarm
is raised whenever the figure was truly within the thresholds, and only then, as a mean over half a second says that no
noise moves: then thresholds stay as they are, and delays and deadband are tried. Of settings that are as good, those
are better that change fewer other alarms, then fewer settings, then these least.

Hundreds of settings are tried on arrays. What is shown, saved and held against marks is always the core's own verdict.
"""

from __future__ import annotations

import json
import math
import re
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, count, pairwise
from operator import attrgetter, itemgetter
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple, cast

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import encode
from stadimeter.app.recordings.journal import FORMAT, cycle_json
from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.toml_lines import KeyPath, dotted, set_value
from stadimeter.config.units import parse_any_quantity, parse_duration
from stadimeter.core.alarms.machine import move, thresholds_of
from stadimeter.core.conditions.compounds import named_leaves
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.decision import EventKind
from stadimeter.core.plan import Plan
from stadimeter.core.rule import ROUNDING_S, AlarmRule, DelayTolerance, OnDelay
from stadimeter.core.words import counted, figure_in_words
from stadimeter.errors import ConfigError, NotThereError, Problem
from stadimeter.workbench.replay import read_recording
from stadimeter.workbench.rule_tests import run_rule_test
from stadimeter.workbench.trial import (
    EARLY_S,
    KEPT_CYCLES_MAX,
    SAME_WITHIN_S,
    EventChange,
    Floats,
    KeptCycle,
    KeptRecording,
    RuleFigures,
    Span,
    Trial,
    TrialDiff,
    compare,
    run,
    stays,
)

# Parts of a rule that may be changed alone: thresholds, deadbands and delays, and where each is written -------------
#
# Names follow the keys of `when`, as those of the thresholds that operators set: ``below``, ``between.near``,
# ``closing_speed.above``, ``any.0.deadband``; and ``on_delay`` and ``off_delay``.


class RuleSetting(Struct, frozen=True, kw_only=True):
    """One that can be changed.

    Attributes:
        value: As it is now, in the SI unit; an on-delay in frames counts as 0.
        unit: The SI unit.
    """

    path: KeyPath
    value: float
    unit: str


def alarm_named(configuration: Configuration, name: str) -> tuple[CompiledRule, AlarmRule]:
    """Return an alarm and its table.

    Raises:
        ConfigError: There is none of that name; of a rule that is none, nothing is to be changed by itself.
    """
    alarms = {rule.name: (each, rule) for each in configuration.rules if isinstance(rule := each.rule, AlarmRule)}
    alarms |= {each.section: (each, rule) for each, rule in reversed(alarms.values())}
    if name not in alarms:
        hint = did_you_mean_or_list(name, alarms)
        raise ConfigError([Problem(f"there is no alarm '{name}'", str(configuration.path), hint=hint)])
    return alarms[name]


def settings_of(configuration: Configuration, name: str) -> dict[str, RuleSetting]:
    """Return the settings that may be changed of an alarm, by name; `ConfigError` if there is no such alarm."""
    compiled, alarm = alarm_named(configuration, name)
    written = list(next(compiled.conditions()).leaves())
    found = {
        key: RuleSetting(path=_path_of(written[each.leaf], each.place.key), value=each.value, unit=each.unit)
        for key, each in thresholds_of(alarm).items()
        if not _is_comparison(written[each.leaf])
    }
    found |= _deadbands(alarm, written)
    for key, value_s in (("on_delay", alarm.on_delay.hold_s), ("off_delay", alarm.off_delay_s)):
        found[key] = RuleSetting(path=compiled.at(key), value=value_s, unit="s")
    return found


def with_settings(configuration: Configuration, text: str, name: str, values: Mapping[str, float | str]) -> str:
    """Return the text of a configuration in which an alarm has other settings, and all else is as it was.

    Args:
        text: What `configuration` was loaded from; its own has no secrets.
        values: By their names, in the SI unit, or as they are written, such as ``"60 cm"``.

    Raises:
        ConfigError: There is no such setting, a value has another unit, or it is written in a form of its own.
    """
    known = settings_of(configuration, name)
    for key, value in values.items():
        if key not in known:
            words = f"'{key}' is nothing that can be changed of '{name}' by itself"
            raise ConfigError([Problem(words, str(configuration.path), hint=did_you_mean_or_list(key, known))])
        # Six digits are more than any camera measures.
        text = set_value(text, known[key].path, f'"{_in_si(known[key], key, value):.6g} {known[key].unit}"')
    return text


def _in_si(setting: RuleSetting, key: str, value: float | str) -> float:
    if not isinstance(value, str):
        return value
    try:
        parsed, unit = parse_any_quantity(value)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key=key)]) from error
    if unit != setting.unit:
        raise ConfigError([Problem(f"{value!r} is in {unit}, and '{key}' is in {setting.unit}", key=key)])
    return parsed


def _deadbands(alarm: AlarmRule, written: list[WrittenCondition]) -> dict[str, RuleSetting]:
    """Return the deadbands; those of several conditions begin with where the condition stands, as thresholds do."""
    parts = zip(named_leaves(alarm.condition), written, strict=True)
    limits = [
        (within, leaf, each)
        for (within, leaf), each in parts
        if isinstance(leaf, LimitsCondition) and leaf.section not in {"still", "base"}  # which have none
    ]
    found = {}
    for within, leaf, each in limits:
        key = f"{within if len(limits) > 1 else ''}{f'{leaf.section}.' if leaf.section else ''}deadband"
        found[key] = RuleSetting(path=(*each.limits_path, "deadband"), value=leaf.deadband, unit=leaf.unit)
    return found


def _is_comparison(written: WrittenCondition) -> bool:
    """Check whether it compares two targets: its threshold has one sign in the file and another in the core."""
    return isinstance(written.condition, FigureCondition) and written.condition.is_comparison


def _path_of(written: WrittenCondition, key: str) -> KeyPath:
    """Return where a threshold stands, which may be one of the two of ``between``."""
    path = written.limits_path
    last = key.rpartition(".")[2]
    if "between" not in key:
        return (*path, last)
    table = written.table if path == written.path else written.table[str(path[-1])]
    is_upper = last in {"far", "high"}
    return (*path, "between", int(is_upper)) if "between" in table else (*path, "below" if is_upper else "above")


# Marks in recordings: where an alarm should have fired, and where not -------------------------------------------------

# A person who points at a moment is this far off.
MOMENT_S = 1.0

# An alarm goes on from one moment to another that is at most this much later; longer, and it would be another visit.
JOINED_S = 30.0

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
        """The mark as it is written for ``tune --mark``."""
        span = "" if self.is_moment else f"..{self.to_s:.4g}s"
        return f"{self.recording}@{self.from_s:.4g}s{span} {'fire' if self.should_fire else 'no'}"

    def touches(self, firing: Span) -> bool:
        """Check whether an alarm stood in it, or nearly."""
        off_s = MOMENT_S if self.is_moment else 0.0
        return firing[0] <= self.to_s + off_s and firing[1] >= self.from_s - off_s

    def wants(self, firing: Span) -> bool:
        """Check whether an alarm is the one that should have fired."""
        if not self.should_fire:
            return False
        return self.touches(firing) if self.is_moment else self.from_s <= firing[0] <= self.to_s


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


def is_met(mark: FiringMark, firings: Sequence[Span], marks: Sequence[FiringMark]) -> bool:
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


# When an alarm would have fired on the signal of a recording, quickly enough to try hundreds of settings --------------
#
# The figures of the rule's condition are gathered once. For one setting, whether the condition would begin and whether
# it would go on are two comparisons of whole arrays; delays are then counted over runs, not over samples. This leaves
# out what seldom matters (inhibits, chattering, the policy for a lost target), so the core judges what is found.

Flags = NDArray[np.bool_]
SoughtCondition = DistanceCondition | FigureCondition


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
        sure = condition.probability_on
        if sure is not None and is_on:
            sure = min(sure, condition.probability_off)
        guard = self._guard(sure)
        inside = np.ones(len(self.value), np.bool_)
        for limit, side in zip(condition.limits, (-1.0, 1.0), strict=True):
            if np.isfinite(limit):
                band = self._deadband(condition, limit) if is_on else 0.0
                inside &= side * (self.value - limit) + guard <= band
        return inside

    def crossed_at(self, condition: LimitsCondition, side: float) -> Floats:
        """Return the least threshold, times the side (-1 for a lower one), with which a condition would begin there."""
        found: Floats = side * self.value + self._guard(condition.probability_on)
        return found

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

    def firings(self, rule: AlarmRule, condition: LimitsCondition) -> list[Span]:
        """Return when a rule would have been raised and cleared with this condition."""
        begins = self.within(condition, is_on=False)
        ends = ~(self.within(condition, is_on=True) | begins)
        frames, of_frames = rule.on_delay.frames, rule.on_delay.of_frames
        if frames:
            begins = begins & (np.convolve(begins, np.ones(of_frames, int))[: len(begins)] >= frames)
        on, off = self.runs(begins, rule.delay_tolerance), self.runs(ends, rule.delay_tolerance)
        found: list[Span] = []
        at, length = -1, len(self.at_s)
        while (raised := self._due(begins, on, at + 1, rule.on_delay.hold_s)) < length:
            at = self._due(ends, off, raised + 1, rule.off_delay_s)
            found.append((float(self.at_s[raised]), float(self.at_s[min(at, length - 1)])))
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
    for at_s, by in cycles:
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
    at, judged, value, sigma, noise = np.array(rows, np.float64).reshape(-1, 5).T
    return Signal(at_s=at, judged_s=judged, value=value, sigma=sigma, noise=noise, begins=np.array(begins, np.float64))


# The search: settings between which alarms change, each kind alone and with the others --------------------------------

# How many thresholds are tried, with all on-delays; then each setting around the best of these, and once more.
THRESHOLDS_MAX, BEST_MAX, ROUNDS = 40, 12, 2

# The delays and the deadbands, as shares of the threshold, that are tried.
DELAYS_S = (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0)
BANDS = (0.0, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3)

# The few that are shown: the best of each set of settings that change, and that needs them all.
SHOWN_MAX = 4

# Thresholds are sought once in this time of the signal, if it is a turning point there.
BLOCK_S = 2.0

# Figures that differ by less than this share are not separated, unless the marks leave no other way: noise
# would decide between them.
APART = 0.05

# A setting goes to the middle of the values that do as well, up to this many times the change that is needed.
FAR_TIMES = 3

Values = Mapping[str, float]


class Evidence(Struct, frozen=True, kw_only=True, eq=False):
    """A recording with what an alarm should have done in it.

    Attributes:
        before: When the alarm stood as it is, where no mark is; none where all is known that it should have done.
    """

    signal: Signal
    marks: Sequence[FiringMark]
    before: Sequence[Span] = ()

    def elsewhere(self, firings: Sequence[Span]) -> int:
        """Count the alarms that come or go though no mark is about them, or are too many or too few for the marks."""
        wanted = [sum(mark.wants(firing) for firing in firings) for mark in self.marks if not mark.is_moment]
        return sum(max(0, each - 1) for each in wanted) + sum(
            not any(mark.touches(firing) for mark in self.marks)
            and not any(abs(firing[0] - other[0]) <= SAME_WITHIN_S for other in others)
            for each, others in ((firings, self.before), (self.before, firings))
            for firing in each
        )


class Score(NamedTuple):
    """Rating of settings; the least is the best."""

    unmet: int
    elsewhere: int
    changed: int


class Tried(NamedTuple):
    """Settings that were tried: those that differ from the rule's, by name; and which marks they meet."""

    values: Values
    score: Score
    met: tuple[bool, ...]


class Search(Struct, kw_only=True):
    """Tries settings of an alarm on one figure, on evidence."""

    rule: AlarmRule
    condition: SoughtCondition
    evidence: Sequence[Evidence]
    keys: Sequence[str]
    tried: dict[tuple[tuple[str, float], ...], Tried] = msgspec.field(default_factory=dict)

    def best(self) -> list[Tried]:
        """Return the best few, each of another set of settings that change, amid where it does as well."""
        for least in (APART, 0.0):
            self._try_all(least)
            if not self._best(1)[0].score.unmet:
                break
        found: list[Tried] = []
        for each in self._best(len(self.tried)):
            # What changes the same settings, or more of them, and does no better than one before, is none of its own.
            if not any(other.values.keys() <= each.values.keys() for other in found):
                found.append(each)
        return [self._amid(each, least) for each in found[:SHOWN_MAX]]

    def _try_all(self, least: float) -> None:
        self.attempt({})
        thresholds = [key for key in self.keys if key in thresholds_of(self.rule)]
        for delay_s in self._candidates("on_delay", least):
            for key in thresholds:
                for at in self._candidates(key, least):
                    self.attempt({"on_delay": delay_s, key: at})
        for _ in range(ROUNDS):
            for tried in self._best(BEST_MAX):
                for key in self.keys:
                    for value in self._candidates(key, least):
                        self.attempt({**tried.values, key: value})

    def _best(self, number: int) -> list[Tried]:
        return sorted(self.tried.values(), key=attrgetter("score"))[:number]

    def attempt(self, values: Values) -> Tried:
        """Find how good settings are; those that are the rule's own do not count as changed."""
        own = self._own
        changed = {key: value for key, value in values.items() if value != own[key]}
        asked = tuple(sorted(changed.items()))
        if asked not in self.tried:
            rule, condition = self._with(changed)
            met: list[bool] = []
            elsewhere = 0
            for each in self.evidence:
                firings = each.signal.firings(rule, condition)
                met += [is_met(mark, firings, each.marks) for mark in each.marks]
                elsewhere += each.elsewhere(firings)
            self.tried[asked] = Tried(changed, Score(met.count(False), elsewhere, len(changed)), tuple(met))
        return self.tried[asked]

    @property
    def _own(self) -> dict[str, float]:
        return {
            **{key: each.value for key, each in thresholds_of(self.rule).items()},
            "on_delay": self.rule.on_delay.hold_s,
            "off_delay": self.rule.off_delay_s,
            band_key(self.condition): self.condition.deadband,
        }

    def _with(self, values: Values) -> tuple[AlarmRule, SoughtCondition]:
        rule = move(self.rule, values)
        if "on_delay" in values:
            rule = replace(rule, on_delay=OnDelay(hold_s=values["on_delay"]))
        rule = replace(rule, off_delay_s=values.get("off_delay", rule.off_delay_s))
        condition = cast(SoughtCondition, rule.condition)
        return rule, replace(condition, deadband=values.get(band_key(condition), condition.deadband))

    def _candidates(self, key: str, least: float) -> list[float]:
        """Return values of a setting, the nearest to the rule's own first; thresholds between the signal's turns."""
        own = self._own[key]
        values: Sequence[float] = DELAYS_S
        if key in thresholds_of(self.rule):
            values = _thin(_between(self._crossings(key), least), THRESHOLDS_MAX)
        elif key == band_key(self.condition):
            limit = next((abs(limit) for limit in self.condition.limits if math.isfinite(limit)), 0.0)
            values = [share * (limit or 1.0) for share in BANDS]
        return sorted([own, *values], key=lambda value: abs(value - own))

    def _crossings(self, key: str) -> set[float]:
        side = 1.0 if thresholds_of(self.rule)[key].place.field == "below" else -1.0
        found: set[float] = set()
        for each in self.evidence:
            crossed = each.signal.crossed_at(self.condition, side)
            marked = (crossed[_in_span(each.signal.at_s, mark)] for mark in each.marks)
            found |= {side * float(figures.min()) for figures in marked if len(figures)}
            found |= {side * float(lowest) for lowest in _turning_points(each.signal.at_s, crossed)}
        return found

    def _amid(self, found: Tried, least: float) -> Tried:
        """Return settings as good as these, each changed one in the middle of the values that do as well."""
        for key, value in found.values.items():
            own = self._own[key]
            further = [each for each in self._candidates(key, least) if 1 < (each - own) / (value - own) <= FAR_TIMES]
            tried = [self.attempt({**found.values, key: each}) for each in (value, *further)]
            as_good = next((number for number, each in enumerate(tried) if each.score != found.score), len(tried))
            found = tried[as_good // 2]
        return found

    def contradiction(self) -> list[FiringMark]:
        """Return a mark that no settings that were tried meet, or else two, or none."""
        marks = [mark for each in self.evidence for mark in each.marks]
        met = np.array([each.met for each in self.tried.values()], bool)
        for number in (1, 2):
            found = [each for each in combinations(range(len(marks)), number) if not met[:, each].all(axis=1).any()]
            if found:
                nearest = min(found, key=lambda each: abs(marks[each[0]].from_s - marks[each[-1]].from_s))
                return [marks[each] for each in nearest]
        return []

    def describe(self, mark: FiringMark) -> str:
        """Say how the figure was at a mark: how far it went, and for how long it was within the threshold."""
        signal = next(each.signal for each in self.evidence if mark in each.marks)
        there = _in_span(signal.at_s, mark)
        if not there.any():
            return f"at {mark.words} the {self.condition.noun} was not known"
        values = signal.value[there]
        extreme = values.min() if math.isfinite(self.condition.limits[1]) else values.max()
        stretches = signal.runs(signal.within(self.condition, is_on=False) & there, self.rule.delay_tolerance)
        for_s = max((float(signal.judged_s[last] - signal.judged_s[first]) for first, last in stretches), default=0.0)
        far = figure_in_words(float(extreme), self.condition.unit)
        return (
            f"at {mark.words} the {self.condition.noun} reached {far}, and was within the threshold for {for_s:.1f} s"
        )


def band_key(condition: LimitsCondition) -> str:
    """Return the name of the deadband among the settings of a rule on one figure."""
    return f"{condition.section}.deadband" if condition.section else "deadband"


def _in_span(at_s: Floats, mark: FiringMark) -> Flags:
    off_s = MOMENT_S if mark.is_moment else 0.0
    return (at_s >= mark.from_s - off_s) & (at_s <= mark.to_s + off_s)


def _turning_points(at_s: Floats, crossed: Floats) -> Iterator[float]:
    """Yield the least figure of each block of time whose neighbours have none that is less."""
    if len(at_s):
        starts = np.flatnonzero(np.diff(np.floor(at_s / BLOCK_S), prepend=-np.inf))
        least = np.minimum.reduceat(crossed, starts)
        padded = np.concatenate([[np.inf], least, [np.inf]])
        yield from least[(padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])]


def _between(values: Iterable[float], least: float) -> list[float]:
    """Return a round value between each two that follow each other and are apart, and one beyond each end.

    Args:
        least: How far apart at least, as a share of the larger.
    """
    found = sorted(values)
    between = [
        _roundest((low + high) / 2, (high - low) / 2) for low, high in pairwise(found) if high - low > least * abs(high)
    ]
    return [found[0] - abs(found[0]) / 20, *between, found[-1] + abs(found[-1]) / 20] if found else []


def _thin(values: Sequence[float], most: int) -> list[float]:
    """Return at most this number of some values, evenly out of their order."""
    if len(values) <= most:
        return list(values)
    return [values[round(each)] for each in np.linspace(0, len(values) - 1, most)]


def _roundest(middle: float, width: float) -> float:
    """Return the number with the fewest digits in the central third of a range; none has more than six."""
    rounded = (float(f"{middle:.{digits}g}") for digits in range(1, 7))
    return next((each for each in rounded if abs(each - middle) <= width / 6), float(f"{middle:.6g}"))


# A configuration with its recordings: what other settings would have done, and the test that holds them ---------------

# A test begins this long before its first mark, or before the alarm that stood then: the least that will do. It ends
# this long after the last.
BEFORE_S, AFTER_S = (20.0, 80.0, 320.0), 5.0


class Answer(Struct, frozen=True, kw_only=True, eq=False):
    """The effect that a rule with other settings would have had on one recording, beside what it does."""

    name: str
    kept: KeptRecording
    rule: str
    after: Trial
    difference: TrialDiff

    def count(self, change: str) -> int:
        """Count the alarms of the rule that are ``added`` or ``lost``."""
        return sum(each.change == change for each in self.alarms())

    def alarms(self) -> Iterator[EventChange]:
        """Yield the alarms of the rule that came, went or moved."""
        return (each for each in self.difference.changes if each.event.kind.value == "raised")

    @property
    def figures(self) -> RuleFigures:
        """The figures that the rule would have had."""
        return next(each.new for each in self.difference.rules if each.new is not None)

    @property
    def before(self) -> list[Span]:
        """The times in which the alarm stood, in seconds of the recording."""
        return self.kept.trial.spans(self.rule)

    @property
    def spans(self) -> list[Span]:
        """The times in which it would have stood."""
        return self.after.spans(self.rule)


class Proposal(Struct, frozen=True, kw_only=True, eq=False):
    """Settings that change, by name, in the SI unit or as they are written; and what they would have done."""

    values: Mapping[str, float | str]
    answers: Sequence[Answer]


@dataclass(slots=True, kw_only=True)
class Tuning:
    """A configuration, its text, and recordings that are kept between questions.

    Attributes:
        recordings: By their names, the most important first: of them all, `KEPT_CYCLES_MAX` cycles are kept.
    """

    configuration: Configuration
    text: str
    recordings: dict[str, KeptRecording] = field(default_factory=dict)

    def add(self, name: str, path: Path, from_s: float = 0.0) -> None:
        """Add a recording, or what follows a time in it; `JournalError` if it cannot be read."""
        recording = read_recording(path)
        self.recordings[name] = KeptRecording(recording=recording, configuration=self.configuration, from_s=from_s)

    def go_on(self, for_s: float) -> bool:
        """Read on for this long; return whether all are read, as far as they are kept."""
        until_s = time.monotonic() + for_s
        room = KEPT_CYCLES_MAX // max(1, len(self.configuration.plan.targets))
        for each in self.recordings.values():
            each.cycles_max = room
            each.go_on(until_s - time.monotonic())
            room -= len(each.cycles)
        return all(each.is_done for each in self.recordings.values())

    def propose(self, rule: str, values: Mapping[str, float | str]) -> Proposal:
        """Return the result of settings on each recording; `ConfigError` if they cannot be used."""
        name = alarm_named(self.configuration, rule)[1].name
        text = with_settings(self.configuration, self.text, rule, values)
        place = self.configuration.path
        plan = load_configuration(place, texts={place: text}).plan if values else self.configuration.plan
        answers = []
        for recording, kept in self.recordings.items():
            after = kept.with_plan(plan, name)
            difference = compare(_only(name, kept.trial), _only(name, after))
            answers.append(Answer(name=recording, kept=kept, rule=name, after=after, difference=difference))
        return Proposal(values=values, answers=answers)

    def best(self, rule: str, marks: Sequence[FiringMark]) -> list[Proposal]:
        """Return the few best settings of an alarm: those that meet all marks, or, without, those that are most right.

        Raises:
            ConfigError: There is none, with the marks that contradict each other; or the rule is not on one figure.
            NotThereError: A mark is in a recording that is not there.
        """
        search = self._search(rule, marks)
        tried = search.best()
        if marks:
            proposals = (self.propose(rule, each.values) for each in tried if not each.score.unmet)
            found = [each for each in proposals if not self._unmet(marks, each)]
            if not found:
                raise ConfigError([_contradiction(search, str(self.configuration.path))])
            return found
        own = search.attempt({}).score
        return [self.propose(rule, each.values) for each in tried if each.score[:2] < own[:2]]

    def _unmet(self, marks: Sequence[FiringMark], proposal: Proposal) -> list[FiringMark]:
        """Return the marks that settings do not meet, by the core's own verdict."""
        found = []
        for each in proposal.answers:
            here = self._whole(each.rule, [mark for mark in marks if mark.recording == each.name])
            found += [mark for mark in here if not is_met(mark, each.spans, here)]
        return found

    def _search(self, name: str, marks: Sequence[FiringMark]) -> Search:
        _, alarm = alarm_named(self.configuration, name)
        condition = alarm.condition
        if not isinstance(condition, DistanceCondition | FigureCondition):
            message = f"the rule '{name}' is not on one figure alone, so nothing says which part of it to change"
            raise ConfigError([Problem(message, str(self.configuration.path), hint="try settings of yours with --set")])
        if missing := [mark.words for mark in marks if mark.recording not in self.recordings]:
            raise NotThereError(f"there is no such recording here: {', '.join(missing)}")
        for mark in marks:
            if mark.from_s > (end_s := self.recordings[mark.recording].seconds) + MOMENT_S:
                raise NotThereError(f"{mark.words!r} is after the end of what was read of it, {end_s:.1f} s")
        evidence = []
        for recording, kept in self.recordings.items():
            signal = signal_of(kept.cycles, alarm, condition)
            if here := self._whole(alarm.name, [mark for mark in marks if mark.recording == recording]):
                evidence.append(Evidence(signal=signal, marks=here, before=kept.trial.spans(alarm.name)))
            elif not marks:
                true = stays(signal.at_s.tolist(), signal.value.tolist(), condition.limits)
                spans = ((each.from_s - EARLY_S, each.to_s) for each in true)
                here = [FiringMark(recording=recording, from_s=at, to_s=to, should_fire=True) for at, to in spans]
                evidence.append(Evidence(signal=signal, marks=here))
        keys = [*(thresholds_of(alarm) if marks else ()), "on_delay", "off_delay", band_key(condition)]
        return Search(rule=alarm, condition=condition, evidence=evidence, keys=keys)

    def _whole(self, rule: str, marks: Sequence[FiringMark]) -> list[FiringMark]:
        """Return marks, those on a moment that should not have fired as one on all of the alarm that stood there."""
        found = []
        for mark in marks:
            firings = self.recordings[mark.recording].trial.spans(rule)
            stood = (firing for firing in firings if mark.is_moment and not mark.should_fire and mark.touches(firing))
            from_s, to_s = next(stood, (mark.from_s, mark.to_s))
            found.append(replace(mark, from_s=from_s, to_s=to_s))
        return found

    def write(
        self, rule: str, values: Mapping[str, float | str], marks: Sequence[FiringMark]
    ) -> tuple[dict[str, str], list[str]]:
        """Return files to save, by name: the text with other settings, and what its tests need; and the tests' names.

        A test for each recording with marks holds what the alarm does there; without marks, one test holds what the
        change adds and takes away, in the recording where that is most.

        Raises:
            ConfigError: The text cannot be used, marks are not met, or a test that passes would fail.
        """
        place = self.configuration.path
        text = with_settings(self.configuration, self.text, rule, values).rstrip("\n") + "\n"
        proposal = self.propose(rule, values)
        found = load_configuration(place, texts={place: text})
        failed = {each.name for each in self.configuration.tests if not run_rule_test(self.configuration, each).passed}
        wrong = [mark.words for mark in self._unmet(marks, proposal)]
        failing = (each.name for each in found.tests if not run_rule_test(found, each).passed)
        wrong += [name for name in failing if name not in failed]
        files, tests = {}, []
        answers = proposal.answers
        if not marks:
            answers = sorted(answers, key=lambda each: each.count("added") + each.count("lost"), reverse=True)[:1]
        for each in answers:
            here = self._whole(each.rule, [mark for mark in marks if mark.recording == each.name])
            if here := here or ([] if marks else list(_changes_as_marks(each))):
                cut = _cut(each, here, found.plan)
                if cut is None:
                    wrong += [mark.words for mark in here]
                    continue
                name = _free_name(place.parent, f"{each.rule.replace(':', '-')}-{Path(each.name).stem}")
                cycles, trial, moved = cut
                files[name] = _journal(each.kept, cycles)
                tests.append(f"{each.rule} as tuned: {Path(name).stem}")
                text += _test(tests[-1], name, each.rule, trial, moved)
        if wrong:
            words = f"nothing was saved, for with these settings this would fail: {', '.join(wrong)}"
            raise ConfigError([Problem(words, str(place), key="tests")])
        return {**files, place.name: text}, tests


def _only(name: str, trial: Trial) -> Trial:
    """Return a trial with the events of one rule alone."""
    rules = tuple(rule for rule in trial.plan.rules if rule.name == name)
    events = [event for event in trial.events if event.source == name]
    return replace(trial, plan=replace(trial.plan, rules=rules), events=events)


def in_words(rule: str, answers: Sequence[Answer]) -> str:
    """Say how often a rule would have fired, how many of that are new, and how many of its alarms are gone."""
    raised = sum(len(each.spans) for each in answers)
    new, gone = (sum(each.count(change) for each in answers) for change in ("added", "lost"))
    minutes = round(sum(each.difference.minutes for each in answers))
    times, of = counted(raised, "time"), f"{counted(minutes, 'minute')} of {counted(len(answers), 'recording')}"
    return f"{rule} would have fired {times} in {of}: {new} of them new, {gone} of yours gone."


def _changes_as_marks(answer: Answer) -> Iterator[FiringMark]:
    """Yield marks that say that what a change adds and takes away is right: for a threshold that was dragged."""
    for change in answer.alarms():
        if change.change != "moved":
            at_s = change.event.at_s - answer.kept.began_s
            yield FiringMark(recording=answer.name, from_s=at_s, to_s=at_s, should_fire=change.change == "added")


def _cut(
    answer: Answer, marks: Sequence[FiringMark], plan: Plan
) -> tuple[Sequence[CycleRecord], Trial, Sequence[FiringMark]] | None:
    """Cut the shortest part that will do out of a recording; None if none shows what the marks say.

    A test knows nothing of what was before, so the part begins earlier until the alarm does there what marks say.

    Returns:
        Its cycles, what the plan does on them, and the marks by its own time.
    """
    from_s = min(mark.from_s for mark in marks)
    from_s = min([from_s, *(begin for begin, end in answer.spans if begin < from_s <= end)])
    to_s, kept = max(mark.to_s for mark in marks) + AFTER_S, answer.kept
    for before_s in BEFORE_S:
        begin_s = max(kept.from_s, from_s - before_s) + kept.began_s
        inside = [each.record() for each in kept.recording.cycles() if begin_s <= each.now_s() <= kept.began_s + to_s]
        trial = run(plan, (each.observation for each in inside))
        off_s = trial.began_s - kept.began_s
        moved = [replace(mark, from_s=mark.from_s - off_s, to_s=mark.to_s - off_s) for mark in marks]
        firings = trial.spans(answer.rule)
        if all(is_met(mark, firings, moved) for mark in moved):
            return inside, trial, moved
    return None


def _free_name(folder: Path, stem: str) -> str:
    names = (f"tests/{stem}{f'-{number}' if number > 1 else ''}.jsonl" for number in count(1))
    taken = {f"tests/{each.name}" for each in folder.glob("tests/*")}
    return next(name for name in names if name not in taken)


def _journal(kept: KeptRecording, cycles: Iterable[CycleRecord]) -> str:
    """Return a journal of some cycles, without pictures."""
    header = replace(kept.recording.header, stadimeter_journal=FORMAT, resumed="")
    return "".join(f"{line.decode()}\n" for line in (encode(header), *map(cycle_json, cycles)))


def _test(name: str, journal: str, rule: str, trial: Trial, marks: Sequence[FiringMark]) -> str:
    """Return a test as TOML; no time in it is after the end of its recording."""
    firings = trial.spans(rule)
    raised = sum(each.kind is EventKind.RAISED and each.source == rule for each in trial.events)

    def at(at_s: float) -> str:
        return f'"{math.floor(min(max(at_s, 0.0), trial.seconds) * 100) / 100:.2f} s"'

    def during(mark: FiringMark) -> str:
        for_s = math.floor((min(mark.to_s, trial.seconds) - max(mark.from_s, 0.0)) * 100) / 100 - 0.01
        return at(mark.from_s) if for_s <= 0 else f'{{ from = {at(mark.from_s)}, for = "{for_s:.2f} s" }}'

    key = f"expect.{dotted((rule,))}"
    lines = ["", "[[tests]]", f"name = {json.dumps(name)}", f"input = {{ journal = {json.dumps(journal)} }}"]
    lines.append(f"{key}.raised = {raised}")
    wanted = [firing for mark in marks for firing in firings if mark.wants(firing)]
    if wanted:
        lines.append(f"{key}.active_at = [{', '.join(sorted({at((begin + end) / 2) for begin, end in wanted}))}]")
    silent = [mark for mark in marks if not mark.should_fire and not any(map(mark.touches, firings))]
    if silent:
        lines.append(f"{key}.inactive_at = [{', '.join(map(during, silent))}]")
    return "\n".join([*lines, ""])


def _contradiction(search: Search, file: str) -> Problem:
    marks = search.contradiction()
    if len(marks) == 2:
        first, second = marks
        message = f"{first.words!r} and {second.words!r} contradict each other: no settings that were tried meet both"
    elif marks:
        message = f"no settings that were tried meet {marks[0].words!r}"
    else:
        message = "no settings that were tried meet all marks together, though any two of them"
    why = "; ".join(search.describe(mark) for mark in marks)
    return Problem(message, file, hint=why or "take one back")
