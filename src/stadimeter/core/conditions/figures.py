"""The figures that rules are judged by, and how sure each of them is.

A figure is known only while its target is in sight and every number behind it is finite. What is not known is None
where a pair is returned, and NaN where a plain number is: a figure that came or went is noticed like one that moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from stadimeter.core.condition import Direction, Quantity
from stadimeter.core.conditions.contact import Pace, approach_of, pace_of
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.thresholds import Uncertain
from stadimeter.core.track import Track, TrackStatus

_TRACKING, _COASTING = TrackStatus.TRACKING, TrackStatus.COASTING


def quantity_of(track: Track, quantity: Quantity) -> Uncertain | None:
    """Return the figure that a rule is about, and how sure it is.

    Args:
        track: The target.
        quantity: Distance or depth.

    Returns:
        The figure, its standard deviation and that of its noise, in metres; None while there is no finite figure to act
        on. Where the noise is not known apart, all is taken for noise.
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
    """Return how fast a target comes nearer, and how sure that is.

    Args:
        track: The target.

    Returns:
        The speed and its standard deviation, all of it noise, in m/s; None while there is no finite figure to act on.
    """
    return _finite(track, track.closing_mps, track.closing_sigma_mps)


def direction_of(track: Track, quantity: Direction) -> Uncertain | None:
    """Return in which direction a target is. How sure that is, nobody knows: the standard deviation is given as 0.

    Args:
        track: The target.
        quantity: Bearing or elevation.

    Returns:
        The angle in radians, 0 and 0; None while there is no finite figure to act on.
    """
    return _finite(track, track.bearing_rad if quantity == "bearing" else track.elevation_rad, 0.0)


def separation_of(first: Track, second: Track) -> Uncertain | None:
    """Return how far two targets are from each other, and how sure that is.

    The standard deviations follow from those of the two distances, taken as independent, along the line between the
    targets. Those of the directions are not known, and do not count.

    Args:
        first: A target.
        second: Another one.

    Returns:
        The separation, its standard deviation and that of its noise, in metres; None while there is no finite figure to
        act on.
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


def no_figures(track: Track) -> str:
    """Return in words that there is no distance to act on.

    Args:
        track: The target.

    Returns:
        The words.
    """
    return f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"


class Figure(Protocol):
    """One of the figures that rules are judged by. Equal figures are the same figure."""

    def of(self, known: Known) -> float:
        """Return the figure.

        Args:
            known: What is known in this cycle.

        Returns:
            The figure; NaN while it is not known.
        """
        ...


@dataclass(frozen=True, slots=True)
class DistanceFigure:
    """The distance or the depth of a target, in metres."""

    target: str
    quantity: Quantity

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return _value(quantity_of(known.tracks[self.target], self.quantity))


@dataclass(frozen=True, slots=True)
class DirectionFigure:
    """The bearing or the elevation of a target, in radians."""

    target: str
    quantity: Direction

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return _value(direction_of(known.tracks[self.target], self.quantity))


@dataclass(frozen=True, slots=True)
class ClosingFigure:
    """The closing speed of a target, in m/s."""

    target: str

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return _value(closing_of(known.tracks[self.target]))


@dataclass(frozen=True, slots=True)
class ContactFigure:
    """The time until a target is at a distance, in seconds; infinite for one that does not come nearer."""

    target: str
    contact_m: float

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        approach = approach_of(known.tracks[self.target])
        return math.nan if approach is None else approach.time_s(self.contact_m)


@dataclass(frozen=True, slots=True)
class PaceFigure:
    """What is known of a target's closing speed, as the number of a `Pace`."""

    target: str
    closing_min_mps: float
    speed_sigmas: float

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        approach = approach_of(known.tracks[self.target])
        return math.nan if approach is None else float(pace_of(approach, self.closing_min_mps, self.speed_sigmas))


@dataclass(frozen=True, slots=True)
class SeparationFigure:
    """How far two targets are from each other, in metres."""

    first: str
    second: str

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return _value(separation_of(known.tracks[self.first], known.tracks[self.second]))


@dataclass(frozen=True, slots=True)
class PresenceFigure:
    """Whether a target is in sight: 1 or 0. It is always known."""

    target: str

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return float(known.tracks[self.target].is_valid)


@dataclass(frozen=True, slots=True)
class CountFigure:
    """How many targets are in sight: of some, or, if none are named, of all. It is always known."""

    targets: tuple[str, ...]

    def of(self, known: Known) -> float:
        """Return the figure; see `Figure.of`."""
        return float(in_sight(known, self.targets))


def in_sight(known: Known, targets: tuple[str, ...]) -> int:
    """Count the targets that are in sight.

    Args:
        known: What is known in this cycle.
        targets: Of these; empty for all.

    Returns:
        How many.
    """
    tracks = known.tracks
    return sum([tracks[target].is_valid for target in targets or tracks])


PACE_LIMITS = (Pace.SLOW + 0.5, Pace.UNSURE + 0.5)
"""Where a `PaceFigure` goes from one kind of knowledge to the next."""


def _finite(track: Track, value: float | None, sigma: float | None) -> Uncertain | None:
    status = track.status
    if (status is not _TRACKING and status is not _COASTING) or value is None or sigma is None:
        return None
    return (value, sigma, sigma) if math.isfinite(value + sigma) else None


def _value(figures: Uncertain | None) -> float:
    return math.nan if figures is None else figures[0]


def _sight(track: Track) -> tuple[tuple[float, float, float], Uncertain] | None:
    """Return the direction to a target as a vector of length 1 (right, down, forward), and its distance."""
    distance = quantity_of(track, "distance")
    bearing, elevation = direction_of(track, "bearing"), direction_of(track, "elevation")
    if distance is None or bearing is None or elevation is None:
        return None
    level = math.cos(elevation[0])
    towards = (level * math.sin(bearing[0]), -math.sin(elevation[0]), level * math.cos(bearing[0]))
    return towards, distance
