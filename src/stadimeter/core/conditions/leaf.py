"""A simple condition, the base of every kind, and all that conditions are judged by.

A kind is one class in this package. It states whether it holds, and the figure and the thresholds that it was judged
by. `stadimeter.core.condition_words` words conditions: a kind that it does not name by its noun, unit and limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from msgspec import Struct, field

from stadimeter.core.command import BaseReport, Command
from stadimeter.core.decision import SafetyMode
from stadimeter.core.measurement import Sighting, Track
from stadimeter.core.observation import WallTime
from stadimeter.core.tracking.transverse import AskedMotion, TransverseMotion, Viewpoint


class RuleInputs(Struct, frozen=True, kw_only=True):
    """All that conditions are judged by in one cycle.

    Attributes:
        tracks: The targets, by name.
        now_s: The run's monotonic clock.
        wall: The local time of day; None while it is not known.
        active: Whether each rule is active, by its name; None for one that has nothing to judge by.
        before: The targets as they were in the cycle before, by name.
        base: What the robot base reported last; None without a base, and while it is out of order.
        is_after_gap: Whether the program stood still before this cycle: unobserved time counts for no timer.
        sightings: The last measurement of each target that was accepted, by its name; None for none.
        frame_at_s: When the newest frame was taken; None before the first.
        commands: What each output was commanded in the cycle before, by its name.
        safety: Whether outputs may act, as far as it is known before the rules are judged.
        undelivered_since_s: As in `stadimeter.core.observation.Observation`.
        motions: How targets move across the line of sight, by name: those that some rule asks it of.
        viewpoint: From where the camera looks.
        raised_at_s: When each rule that a sequence names was raised last, by its name; and when each sequence was last
            complete, by its key.
        figures: What is remembered over windows of time, by name; None for what is not known.
    """

    tracks: Mapping[str, Track]
    now_s: float
    wall: WallTime | None = None
    active: Mapping[str, bool | None] = field(default_factory=dict)
    before: Mapping[str, Track] = field(default_factory=dict)
    base: BaseReport | None = None
    is_after_gap: bool = False
    sightings: Mapping[str, Sighting | None] = field(default_factory=dict)
    frame_at_s: float | None = None
    commands: Mapping[str, Command] = field(default_factory=dict)
    safety: SafetyMode = SafetyMode.ACTIVE
    undelivered_since_s: float | None = None
    motions: Mapping[str, TransverseMotion] = field(default_factory=dict)
    viewpoint: Viewpoint = Viewpoint()
    raised_at_s: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, float | None] = field(default_factory=dict)


class JudgedFigure(Struct, frozen=True, kw_only=True):
    """The figure that a condition was judged by and what it was compared with, in the SI unit.

    Attributes:
        sigma: The standard deviation of `value`; None where that is not known.
        low: The lower threshold, deadband included where that counts; -∞ for none.
        high: The upper threshold; ∞ for none.
        probability: That the figure is within them; None where the figures alone are compared.
    """

    value: float
    sigma: float | None = None
    low: float = -math.inf
    high: float = math.inf
    probability: float | None = None


class Threshold(NamedTuple):
    """A threshold of a simple condition that an operator may move while it runs, and what the configuration takes."""

    key: str
    """As it is called in the table of a condition, such as ``closing_speed.above``."""
    field: str
    """The field of the condition that holds it."""
    low: float
    """The least value, in the SI unit."""
    high: float


class Leaf:
    """A simple condition. Each kind is a frozen dataclass in SI units."""

    __slots__ = ()

    is_by_cycle: ClassVar[bool] = False
    """Whether it may change though no frame comes, so that it is judged in every cycle."""
    is_always_known: ClassVar[bool] = False
    """Whether it holds or does not, whatever is seen and reported."""
    has_figures: ClassVar[bool] = False
    """Whether it asks for a figure that is not known while its target is out of sight."""

    probability_on: float | None = None
    """How likely it must be to begin; None compares the figures alone."""
    probability_off: float = 0.5
    """How likely it may be, deadband included, once it has ended."""

    @property
    def noun(self) -> str:
        """The quantity that it is about, such as ``distance``."""
        raise NotImplementedError

    @property
    def unit(self) -> str:
        """The SI unit of its figures; empty for those without."""
        return ""

    @property
    def is_signed(self) -> bool:
        """True if its figure may be below zero."""
        return self.unit != "m"

    @property
    def limits(self) -> tuple[float, float]:
        """The thresholds within which it begins, in the SI unit; infinite where there is none."""
        return -math.inf, math.inf

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The thresholds that it has and that may be moved; none for a kind whose thresholds are fixed."""
        return ()

    @property
    def rules_named(self) -> tuple[str, ...]:
        """The rules that it names."""
        return ()

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The targets that it names."""
        return ()

    @property
    def motion(self) -> AskedMotion | None:
        """The motion across the line of sight that its figure takes: worked out only where some condition takes it."""
        return None

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Check whether it holds; None if that cannot be known.

        Args:
            is_on: Whether it is judged by what ends it, where that differs from what begins it.
        """
        raise NotImplementedError

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return the figure behind `holds`; None where there is none."""
        return None

    def turning_points(self, inputs: RuleInputs, *, is_on: bool) -> tuple[float, ...]:  # noqa: ARG002
        """Return the figures at which it begins, or ends if `is_on`, with the standard deviations as they are now.

        None, one or two, the smaller first; none if it can never do so since the figure is too unsure everywhere.
        """
        return ()
