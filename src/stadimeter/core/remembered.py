"""Figures that are remembered over a window of time: the nearest of today, the mean or the median of a minute.

What is kept is bounded: up to 256 slots of the window, each with the number of its values, their sum, the least and the
largest. A slot begins with a value and takes those of 1/256 of the window; it leaves the window when its first value
does. So values leave by up to 1/256 of the window too early, and a percentile is one of the means of the slots, each
weighed by how many values it has: it is exact while no slot has more than one.

All sums are exact or in the order of the frames, so that the same run gives the same figures to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

from msgspec import Struct

from stadimeter.core.conditions.figures import Uncertain, closing_of, direction_of, quantity_of
from stadimeter.core.conditions.window import Window, packed, unpacked
from stadimeter.core.observation import WallTime
from stadimeter.core.track import Track, TrackStatus

SLOTS = 256
_BYTES = 5 * 8

FigureQuantity = Literal["distance", "depth", "closing_speed", "bearing", "elevation"]
Statistic = Literal["minimum", "maximum", "mean", "percentile"]

# The SI unit of each quantity, and how it is read.
QUANTITIES: Mapping[FigureQuantity, tuple[str, Callable[[Track], Uncertain | None]]] = {
    "distance": ("m", lambda track: quantity_of(track, "distance")),
    "depth": ("m", lambda track: quantity_of(track, "depth")),
    "closing_speed": ("m/s", closing_of),
    "bearing": ("rad", lambda track: direction_of(track, "bearing")),
    "elevation": ("rad", lambda track: direction_of(track, "elevation")),
}


class RememberedFigure(Struct, frozen=True, kw_only=True):
    """A statistic of a figure of a target within a window.

    Attributes:
        percentile: In percent, for a ``percentile``; 50 is the median.
    """

    name: str
    target: str
    quantity: FigureQuantity = "distance"
    statistic: Statistic = "minimum"
    percentile: float = 50.0
    window: Window = Window()

    @property
    def unit(self) -> str:
        """Its SI unit."""
        return QUANTITIES[self.quantity][0]

    def for_people(self, value: float | None) -> float | None:
        """Return a value as messages tell it: in the SI unit, but an angle in degrees."""
        return math.degrees(value) if value is not None and self.unit == "rad" else value


class Slot(NamedTuple):
    """Some values that follow one another."""

    from_s: float
    number: float
    total: float
    least: float
    most: float


class Summary(Struct, frozen=True, kw_only=True):
    """What is kept of the values of one figure. Times are on the run's clock.

    Attributes:
        past: The slots that are over, oldest first; see `packed`.
        newest: The slot that goes on; None before the first value.
        began_s: When the window began that begins at a time of day; None for another, and while that is not known.
    """

    past: bytes = b""
    newest: Slot | None = None
    began_s: float | None = None

    def slots(self) -> list[Slot]:
        """Return all slots, oldest first."""
        numbers = unpacked(self.past)
        past = [Slot(*numbers[at : at + 5]) for at in range(0, len(numbers) - 4, 5)]
        return past if self.newest is None else [*past, self.newest]

    def resume(self, shift_s: float) -> Summary:
        """Return the same with its times shifted to another clock."""
        slots = [slot._replace(from_s=slot.from_s + shift_s) for slot in self.slots()]
        return Summary(past=_past(slots[:-1]), newest=slots[-1] if slots else None)


def step_summary(
    figure: RememberedFigure, before: Summary, value: float | None, now_s: float, wall: WallTime | None
) -> Summary:
    """Return what is kept after a cycle; the same object if nothing has changed.

    Args:
        value: The value that is new in this cycle; None for none.
    """
    past, newest, window = before.past, before.newest, figure.window
    began_s = window.began_s(before.began_s, now_s, wall)
    start_s = window.start_s(began_s, now_s)
    if start_s is not None:
        while past and unpacked(past[:8])[0] <= start_s:
            past = past[_BYTES:]
        newest = None if newest is not None and newest.from_s <= start_s else newest
    if value is not None:
        if newest is not None and now_s < newest.from_s + window.for_s / SLOTS:
            least, most = min(newest.least, value), max(newest.most, value)
            newest = Slot(newest.from_s, newest.number + 1, newest.total + value, least, most)
        else:
            past = (past + packed(newest or ()))[-_BYTES * (SLOTS - 1) :]
            newest = Slot(now_s, 1.0, value, value, value)
    is_same = past is before.past and newest is before.newest and began_s == before.began_s
    return before if is_same else Summary(past=past, newest=newest, began_s=began_s)


def value_of_summary(figure: RememberedFigure, summary: Summary) -> float | None:
    """Return the statistic; None without a value, and while it is not known when the window began."""
    slots = summary.slots()
    if not slots or (figure.window.from_second is not None and summary.began_s is None):
        return None
    match figure.statistic:
        case "minimum":
            return min([slot.least for slot in slots])
        case "maximum":
            return max([slot.most for slot in slots])
        case "mean":
            return math.fsum([slot.total for slot in slots]) / math.fsum([slot.number for slot in slots])
        case _:
            return _percentile(slots, figure.percentile)


def _percentile(slots: list[Slot], percent: float) -> float:
    """Return the least mean of a slot that so many of the values are no larger than, slot by slot."""
    means = sorted([(slot.total / slot.number, slot.number) for slot in slots])
    left = percent / 100 * math.fsum([count for _, count in means])
    for mean, count in means:
        left -= count
        if left <= 0:
            return mean
    return means[-1][0]


def values_of(figures: tuple[RememberedFigure, ...], summaries: tuple[Summary, ...]) -> dict[str, float | None]:
    """Return the statistics by the names of the figures."""
    return {figure.name: value_of_summary(figure, each) for figure, each in zip(figures, summaries, strict=True)}


def step_summaries(
    figures: tuple[RememberedFigure, ...],
    before: tuple[Summary, ...],
    seen: Mapping[str, Track],
    now_s: float,
    wall: WallTime | None,
) -> tuple[Summary, ...]:
    """Return what is kept of all figures after a cycle.

    Args:
        seen: The targets that were measured in the frame that is new, by name.
    """
    return tuple(
        [
            step_summary(figure, summary, _value(figure, seen.get(figure.target)), now_s, wall)
            for figure, summary in zip(figures, before, strict=True)
        ]
    )


def _value(figure: RememberedFigure, track: Track | None) -> float | None:
    if track is None or track.status is not TrackStatus.TRACKING:
        return None
    found = QUANTITIES[figure.quantity][1](track)
    return None if found is None else found[0]


def _past(slots: list[Slot]) -> bytes:
    return packed(number for slot in slots for number in slot)
