"""A simple condition: the base of every kind, with all that the rest of the program may ask of one.

A kind is one file in this package. It says whether it holds, for how long it surely stays so, which figures it watches,
how it is put into words, and what `check` reasons about. Nothing outside that file knows its kind, but for its table in
the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import Box, Truth

UNKNOWN = -math.inf
"""The value of a figure that is not known. No figure that is known has it."""


class Figure(NamedTuple):
    """A number that conditions watch. Equal figures are the same figure, and are read once in a cycle."""

    read: Callable[..., float]
    """From what is known in a cycle, and `of`; `UNKNOWN` where it is not known."""
    of: tuple[Any, ...]


class Rest(NamedTuple):
    """For how long a condition surely stays as it is.

    That is while each figure stays within its interval, ends included, and until it is `due_s` on the run's clock. An
    interval from `UNKNOWN` to `UNKNOWN` lasts until the figure is known.
    """

    intervals: tuple[tuple[Figure, float, float], ...] = ()
    due_s: float = math.inf

    def __and__(self, other: Rest) -> Rest:
        """Return for how long both stay as they are."""
        return Rest(self.intervals + other.intervals, min(self.due_s, other.due_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
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
        """Where it would begin to speak for the alarm, such as ``1.91 m``; empty if it never would."""
        return self._points(self.begin_points)

    @property
    def ends_at(self) -> str:
        """Where it would cease to, such as ``2.12 m``; empty if it never would."""
        return self._points(self.end_points)

    def _points(self, points: tuple[float, ...]) -> str:
        if self.unit == "rad":
            return " or ".join(f"{math.degrees(point):.1f}°" for point in points)
        return " or ".join(f"{point:.2f} {self.unit}" for point in points)


class Band(NamedTuple):
    """The thresholds of a condition, in the unit that people write; None for no such threshold."""

    noun: str
    low: float | None
    high: float | None
    unit: str
    deadband: float = 0.0
    is_positive: bool = False
    """Whether the figure cannot be below zero."""


class Leaf:
    """A simple condition. Each kind is a frozen dataclass in SI units."""

    __slots__ = ()

    unit: ClassVar[str] = ""
    """The SI unit of its figures."""
    is_by_cycle: ClassVar[bool] = False
    """Whether it may change though no frame comes, so that it is judged in every cycle."""
    has_figures: ClassVar[bool] = False
    """Whether it asks for a figure that is not known while its target is out of sight."""

    @property
    def noun(self) -> str:
        """The quantity that it is about, such as ``distance``."""
        raise NotImplementedError

    @property
    def is_sure(self) -> bool:
        """Whether one wrong frame cannot make it hold."""
        return False

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The targets that it names."""
        return ()

    @property
    def about(self) -> tuple[str, ...]:
        """The targets, or the rule, that it is about."""
        return self.targets_named

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Return whether it holds; None if that cannot be known.

        Args:
            is_on: Whether it is judged by what ends it, where that differs from what begins it.
        """
        raise NotImplementedError

    def figures(self) -> tuple[Figure, ...]:
        """Return the figures that its rest intervals may be on."""
        return ()

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest | None:
        """Return for how long it surely stays as it is; None if it must be judged in every cycle."""
        raise NotImplementedError

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:
        """Return the figures behind `holds`.

        Args:
            is_on: As for `holds`.
            names_target: Whether to name its target, where that is not said anyway.
        """
        raise NotImplementedError

    def probability_in_words(self, inputs: RuleInputs, is_on: bool) -> str:  # noqa: ARG002
        """Return what to add to those words for whoever asks why: how likely it is, and from when on that is enough.

        Empty where it is not judged by a probability.
        """
        return ""

    def evidence(self, inputs: RuleInputs, is_on: bool) -> Evidence:
        """Return the figures behind `holds`, for whoever asks why."""
        return Evidence(
            quantity=self.noun,
            about=self.about,
            words=self.in_words(inputs, is_on, names_target=True) + self.probability_in_words(inputs, is_on),
            holds=self.holds(inputs, is_on),
            unit=self.unit,
        )

    def begins(self) -> str:
        r"""Return a clause that says when it begins, such as ``\`ball\` is nearer than 0.50 m (1.6 ft)``."""
        raise NotImplementedError

    def ends(self) -> str:
        """Return a clause that says when it has ended."""
        return "that has ended"

    def band(self) -> Band | None:
        """Return its thresholds, where they can be out of order or without an end."""
        return None

    def widened(self) -> Self:
        """Return it with each threshold moved by its deadband, standard deviations left out."""
        return self

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:
        """Yield the boxes of situations in which it is true, false or unknown, as `truth` says."""
        raise NotImplementedError
