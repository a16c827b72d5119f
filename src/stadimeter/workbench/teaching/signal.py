"""When an alarm would have fired on the signal of a recording, quickly enough to try thousands of settings.

The figures of the rule's condition are gathered once. For one setting, whether the condition would begin and whether it
would go on are two comparisons of whole arrays; delays are then counted over runs, not over samples. This leaves out
what seldom matters (inhibits, chattering, the policy for a lost target), so what is found is always checked by the
rules themselves.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter
from statistics import NormalDist

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.rule import ROUNDING_S, AlarmRule, DelayTolerance
from stadimeter.workbench.replay.what_if import KeptCycle
from stadimeter.workbench.teaching.marks import Firing

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
