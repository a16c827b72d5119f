"""Conditions in words, and the figures behind a verdict: each simple condition words itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from msgspec import Struct

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, JudgedLeaf, Not, judged_leaves
from stadimeter.core.conditions.leaf import ANSWERS, Leaf, RuleInputs
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.words import short_figure


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
        is_on = next(parts).is_on
        return condition.verdict(inputs, is_on, names_target=False, with_probability=with_probability)
    return _whole_words(condition, inputs, parts, with_probability=with_probability)


def collect_evidence(
    condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool
) -> tuple[Evidence, ...]:
    """Return the figures behind what `judge` returns for the same arguments: one for each part, from left to right."""
    return tuple(_evidence(part, inputs) for part in judged_leaves(condition, held, is_active=is_active))


def _whole_words(
    condition: Condition, inputs: RuleInputs, parts: Iterator[JudgedLeaf], *, with_probability: bool
) -> str:
    if isinstance(condition, Leaf):
        part = next(parts)
        words = condition.verdict(inputs, part.is_on, names_target=True, with_probability=with_probability)
        return f"{words} [{ANSWERS[condition.holds(inputs, part.is_on)]}]"
    if isinstance(condition, Not):
        return f"not ({_whole_words(condition.condition, inputs, parts, with_probability=with_probability)})"
    within = [_whole_words(part, inputs, parts, with_probability=with_probability) for part in condition.conditions]
    return f"{'all' if isinstance(condition, AllOf) else 'any'} of ({'; '.join(within)})"


def _evidence(part: JudgedLeaf, inputs: RuleInputs) -> Evidence:
    leaf, is_on = part.leaf, part.is_on
    reading = leaf.reading(inputs, is_on)
    # Below a `not` the whole begins when this part ends.
    begin, end = (_turning_points(leaf, inputs, is_on=side) for side in (part.is_inverted, not part.is_inverted))
    return Evidence(
        quantity=leaf.noun,
        about=leaf.rules_named or leaf.targets_named,
        words=leaf.verdict(inputs, is_on, names_target=True, with_probability=True) + leaf.doubt,
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


def describe_begin(condition: Condition) -> str:
    r"""Return a clause such as ``\`ball\` is nearer than 0.50 m (1.6 ft) with a probability of 80%``."""
    match condition:
        case Leaf():
            words = condition.begins
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
    return condition.ends if isinstance(condition, Leaf) else "that has ended"


# The figures of tracks that rules are judged by, and their standard deviations ----------------------------------------
#
# A figure is known only while its target is in sight and every number behind it is finite.

Quantity = Literal["distance", "depth"]
Direction = Literal["bearing", "elevation"]

# A value, its standard deviation, and the part of that which differs from frame to frame (noise).
Uncertain = tuple[float, float, float]

_TRACKING, _COASTING = TrackStatus.TRACKING, TrackStatus.COASTING
_ROOT_2 = math.sqrt(2)


def quantity_of(track: Track, quantity: Quantity) -> Uncertain | None:
    """Return the distance or the depth of a target, in metres; None while there is no finite figure to act on.

    Where the noise is not known apart, the whole standard deviation is taken for noise.
    """
    status = track.status
    if status is not _TRACKING and status is not _COASTING:
        return None
    figure_m = track.distance_m if quantity == "distance" else track.depth_m
    sigma_m, noise_m = track.sigma_m, track.noise_m
    if figure_m is None or sigma_m is None:
        return None
    if noise_m is None:
        noise_m = sigma_m
    return (figure_m, sigma_m, noise_m) if math.isfinite(figure_m + sigma_m + noise_m) else None


def closing_of(track: Track) -> Uncertain | None:
    """Return the closing speed of a target in m/s, all of whose standard deviation is noise; None if not known."""
    return _finite(track, track.closing_mps, track.closing_sigma_mps)


def direction_of(track: Track, quantity: Direction) -> Uncertain | None:
    """Return a direction in radians, its standard deviation, which is unknown, as 0; None if it is not known."""
    return _finite(track, track.bearing_rad if quantity == "bearing" else track.elevation_rad, 0.0)


def separation_of(first: Track, second: Track) -> Uncertain | None:
    """Return the distance of two targets from each other in metres; None if not known.

    The standard deviations follow from those of the two distances, taken as independent, along the line between the
    targets. Those of the directions are not known, and do not count.
    """
    here, there = _sight(first), _sight(second)
    if here is None or there is None:
        return None
    (ax, ay, az), (here_m, sigma_here_m, noise_here_m) = here
    (bx, by, bz), (there_m, sigma_there_m, noise_there_m) = there
    x, y, z = ax * here_m - bx * there_m, ay * here_m - by * there_m, az * here_m - bz * there_m
    apart_m = math.sqrt(x * x + y * y + z * z)
    if apart_m == 0:
        return 0.0, math.hypot(sigma_here_m, sigma_there_m), math.hypot(noise_here_m, noise_there_m)
    share_here, share_there = (ax * x + ay * y + az * z) / apart_m, (bx * x + by * y + bz * z) / apart_m
    sigma_m = math.hypot(share_here * sigma_here_m, share_there * sigma_there_m)
    return apart_m, sigma_m, math.hypot(share_here * noise_here_m, share_there * noise_there_m)


def probability_between(low: float, high: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is between two thresholds, which may be infinite."""
    return probability_below(high, value, sigma) - probability_below(low, value, sigma)


def probability_below(threshold: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is below a threshold, which may be infinite."""
    if math.isinf(threshold):
        return 1.0 if threshold > 0 else 0.0
    if sigma <= 0:
        return 1.0 if value < threshold else 0.0
    return 0.5 * math.erfc((value - threshold) / (sigma * _ROOT_2))


def _finite(track: Track, value: float | None, sigma: float | None) -> Uncertain | None:
    status = track.status
    if (status is not _TRACKING and status is not _COASTING) or value is None or sigma is None:
        return None
    return (value, sigma, sigma) if math.isfinite(value + sigma) else None


def _sight(track: Track) -> tuple[tuple[float, float, float], Uncertain] | None:
    """Return the direction to a target as a vector of length 1 (x right, y down, z forward), and its distance."""
    distance = quantity_of(track, "distance")
    bearing, elevation = direction_of(track, "bearing"), direction_of(track, "elevation")
    if distance is None or bearing is None or elevation is None:
        return None
    level = math.cos(elevation[0])
    towards = (level * math.sin(bearing[0]), -math.sin(elevation[0]), level * math.cos(bearing[0]))
    return towards, distance
