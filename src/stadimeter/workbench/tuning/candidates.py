"""The settings of an alarm that are tried, and how an alarm looks with them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.loader import Configuration
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.tuning.noise import Floats

PROBABILITIES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999)
ON_DELAYS = (OnDelay(), OnDelay(frames=2, of_frames=3), OnDelay(frames=3, of_frames=5))
DEADBANDS_SIGMAS = (0.0, 1.0, 2.0, 3.0, 4.0)
OFF_DELAYS_S = (0.0, 0.5, 1.0, 2.0)


class Settings(Struct, frozen=True, kw_only=True):
    """The settings of an alarm that can be tuned.

    Attributes:
        probability: The probability of its condition from which it begins; None compares the figures alone.
        deadband_sigmas: Hysteresis: how far the target must come back, in standard deviations.
    """

    probability: float | None
    on_delay: OnDelay
    deadband_sigmas: float
    off_delay_s: float


class Tuned(Struct, frozen=True, kw_only=True):
    """The alarm that is tuned.

    Attributes:
        threshold_m: The threshold that the target may cross.
        side: 1 if the alarm is raised by a target that is nearer than the threshold, -1 if by one that is further.
    """

    rule: AlarmRule
    condition: DistanceCondition
    threshold_m: float
    side: int

    @property
    def settings(self) -> Settings:
        """The settings that it has."""
        return Settings(
            probability=self.condition.probability_on,
            on_delay=self.rule.on_delay,
            deadband_sigmas=self.condition.deadband_sigmas,
            off_delay_s=self.rule.off_delay_s,
        )

    def with_settings(self, settings: Settings, name: str) -> AlarmRule:
        """Return the alarm with other settings, and without all that does not say when it is raised."""
        on, off = settings.probability, self.condition.probability_off
        condition = replace(
            self.condition,
            probability_on=on,
            probability_off=off if on is None else min(off, on),
            deadband_sigmas=settings.deadband_sigmas,
        )
        return self._alarm(name, condition, settings.on_delay, settings.off_delay_s)

    def ending_at_once(self, settings: Settings, name: str) -> AlarmRule:
        """Return the alarm with these settings, but ending as soon as it can: so it is raised often enough to count."""
        on = settings.probability
        condition = replace(
            self.condition,
            probability_on=on,
            probability_off=0.5 if on is None else on,
            deadband=0.0,
            deadband_sigmas=0.0,
        )
        return self._alarm(name, condition, settings.on_delay, off_delay_s=0.0)

    def _alarm(self, name: str, condition: DistanceCondition, on_delay: OnDelay, off_delay_s: float) -> AlarmRule:
        return AlarmRule(
            name=name,
            target=condition.target,
            severity=self.rule.severity,
            lost=self.rule.lost,
            condition=condition,
            on_delay=on_delay,
            off_delay_s=off_delay_s,
            raises_per_min_max=0,  # each time that it comes is to be counted
        )


def candidate_beginnings(tuned: Tuned) -> list[Settings]:
    """Return the settings to try for when the alarm begins, its own first; a safety alarm does not wait."""
    delays = ON_DELAYS[:1] if tuned.rule.severity is Severity.SAFETY else ON_DELAYS
    tried = [
        replace(tuned.settings, probability=probability, on_delay=delay)
        for probability, delay in product(PROBABILITIES, delays)
    ]
    return _with_first(tuned.settings, tried)


def candidate_endings(begin: Settings) -> list[Settings]:
    """Return the settings to try for when the alarm ends, its own first, with the chosen beginning."""
    tried = [
        replace(begin, deadband_sigmas=band, off_delay_s=off_s)
        for band, off_s in product(DEADBANDS_SIGMAS, OFF_DELAYS_S)
    ]
    return _with_first(begin, tried)


def _with_first(first: Settings, others: Sequence[Settings]) -> list[Settings]:
    return [first, *(each for each in others if each != first)]


def rule_to_tune(configuration: Configuration, name: str, typical_m: float | None = None) -> Tuned:
    """Return the alarm to tune.

    Args:
        typical_m: The usual distance of the target. Of two thresholds, the one that is nearer to it is tuned.

    Raises:
        ConfigError: There is no such rule, or it is none on a distance alone.
    """
    rules = {rule.name: rule for rule in configuration.plan.rules}
    rule = rules.get(name)
    if rule is None:
        raise ConfigError([_problem(configuration, f"there is no rule '{name}'", did_you_mean_or_list(name, rules))])
    if not isinstance(rule, AlarmRule) or not isinstance(rule.condition, DistanceCondition):
        what = f"the rule '{name}' is none that a distance alone raises: only such alarms can be tuned"
        raise ConfigError([_problem(configuration, what, "its `when` must be above, below or between, and no more")])
    threshold_m, side = _limit(rule.condition, typical_m)
    return Tuned(rule=rule, condition=rule.condition, threshold_m=threshold_m, side=side)


def _limit(condition: DistanceCondition, typical_m: float | None) -> tuple[float, int]:
    limits = [(condition.below, 1), (condition.above, -1)]
    there = [(threshold_m, side) for threshold_m, side in limits if threshold_m is not None]
    return min(there, key=lambda each: 0.0 if typical_m is None else abs(math.log(each[0] / typical_m)))


def _problem(configuration: Configuration, message: str, hint: str) -> Problem:
    return Problem(message, file=str(configuration.path), hint=hint)


# Bootstrap draws of the counts, for the confidence of the line.
SURE = 0.95
DRAWS = 400

# Where nothing was counted, half a count stands for it: the logarithm of zero is not a number.
_SIGMAS_OF_SURE = 1.645
_HALF = 0.5

# An alarm gets rare where it is raised less than this share as often as anywhere.
OFTEN_SHARE = 0.5


class Count(Struct, frozen=True, kw_only=True):
    """The raises of an alarm while the target stood at one clearance.

    Attributes:
        clearance: Distance from the threshold, in standard deviations of the noise.
    """

    clearance: float
    raises: int
    duration_s: float


class Slope(Struct, frozen=True, kw_only=True):
    """The fall of the logarithm of a rate, for each standard deviation further away.

    Attributes:
        per_sigma: The change of the logarithm, zero or less.
    """

    per_sigma: float
    sigma: float


class Rate(Struct, frozen=True, kw_only=True):
    """False alarms a day.

    Attributes:
        at_most_a_day: It is at most this, with 95 % confidence, as far as the counts go.
    """

    a_day: float
    at_most_a_day: float


def at_most(count: int) -> float:
    """Return the 95 % upper limit of a Poisson variable's mean, where `count` events were counted.

    For none it is 3.0, the "rule of three". The formula is that of Wilson and Hilferty, "The distribution of
    chi-square", PNAS 17 (12), 1931.
    """
    more = count + 1
    return float(more * (1 - 1 / (9 * more) + _SIGMAS_OF_SURE / (3 * math.sqrt(more))) ** 3)


def slope_of(all_counts: Iterable[Sequence[Count]]) -> Slope:
    """Return the slope that all settings have together."""
    tails = [_tail(counts) for counts in all_counts]
    rise = spread = 0.0
    for at, raises, duration_s in tails:
        logs = np.log(raises / duration_s)
        off = at - np.average(at, weights=raises)
        rise += float(np.sum(raises * off * logs))
        spread += float(np.sum(raises * off * off))
    # All settings were tried on the same noise: together they tell no more than one of them.
    return Slope(per_sigma=min(rise / spread, 0.0), sigma=math.sqrt(len(tails) / spread))


def rate_at(
    counts: Sequence[Count], slope: Slope, clearances: Floats, far: Count | None, random: np.random.Generator
) -> Rate:
    """Compute how often a day an alarm is raised by a target that spends the same time at each clearance.

    Args:
        counts: By growing clearance.
        clearances: Distances from the threshold, in standard deviations of the noise.
        far: The count at the median clearance, if that is further away than all else; else None.
    """
    at, raises, duration_s = _tail(counts)
    nearer = np.array(
        [count.raises / count.duration_s for count in counts if count.clearance < at[0]], dtype=np.float64
    )
    most_often = max(float(nearer.max(initial=0.0)), raises[0] / duration_s[0])
    likeliest = _a_day((at, raises, duration_s), slope.per_sigma, clearances, most_often)
    slopes = np.minimum(random.normal(slope.per_sigma, slope.sigma, DRAWS), 0.0)
    # A parametric bootstrap: counts and slope are drawn anew; the 95th percentile of the drawn rates is the limit.
    again = np.maximum(random.poisson(raises, (DRAWS, len(raises))), _HALF)
    drawn = [
        _a_day((at, each, duration_s), float(by), clearances, most_often)
        for each, by in zip(again, slopes, strict=True)
    ]
    most = float(np.quantile(drawn, SURE))
    if far is not None and far.raises:
        likeliest = max(likeliest, far.raises / far.duration_s * DAY_S)
        most = max(most, at_most(far.raises) / far.duration_s * DAY_S)
    return Rate(a_day=likeliest, at_most_a_day=max(likeliest, most))


def _tail(counts: Sequence[Count]) -> tuple[Floats, Floats, Floats]:
    """Return clearances, raises and durations, from where it gets rare to where it is never raised.

    Nearer than that it is raised about as often wherever the target stands, or more seldom because it hardly ever ends.
    """
    raises = [count.raises for count in counts]
    often = max(index for index, each in enumerate(raises) if each >= OFTEN_SHARE * max(raises))
    first = min(often, len(raises) - 2)
    empty = next((index for index in range(first, len(raises)) if not raises[index]), len(raises) - 1)
    used = counts[first : max(empty + 1, first + 2)]
    return (
        np.array([count.clearance for count in used]),
        np.array([max(count.raises, _HALF) for count in used]),
        np.array([count.duration_s for count in used]),
    )


def _a_day(tail: tuple[Floats, Floats, Floats], per_sigma: float, clearances: Floats, most_often: float) -> float:
    """Return the rate, by the line, and nowhere more than where it is raised most often."""
    at, raises, duration_s = tail
    # The likeliest height of a Poisson rate exp(height + slope · clearance), given the slope: counts over exposure.
    height = math.log(raises.sum() / np.sum(duration_s * np.exp(per_sigma * at)))
    rates = np.minimum(np.exp(height + per_sigma * clearances), most_often)
    return float(DAY_S * np.mean(rates))
