"""A simple condition, the base of every kind, and all that conditions are judged by.

A kind is one class in this package. It states whether it holds, and the figure and the thresholds that it was judged
by, and words them: what a kind does not word itself follows from its noun, unit and limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

from msgspec import Struct, field

from stadimeter.core.command import BaseReport, Command
from stadimeter.core.decision import SafetyMode
from stadimeter.core.measurement import Sighting, Track
from stadimeter.core.observation import WallTime
from stadimeter.core.tracking.transverse import AskedMotion, TransverseMotion, Viewpoint
from stadimeter.core.words import figure_in_words, short_figure

ANSWERS = {True: "yes", False: "no", None: "unknown"}


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

    has_noise: ClassVar[bool] = True
    """Whether one wrong frame can change it: without a delay and a probability it must then hold in several frames."""
    is_on_sight: ClassVar[bool] = False
    """Whether it is on what is in sight and what is not: an alarm of it waits for a first sight."""

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

    # In words ---------------------------------------------------------------------------------------

    sides: ClassVar[tuple[str, str]] = ("below ", "above ")
    """The words before a threshold from which on a figure is too low, and too high."""
    doubt: ClassVar[str] = ""
    """Words behind a figure on what it does not count."""

    @property
    def subject(self) -> str:
        """The beginning of a clause about thresholds, such as ``the bearing of `ball` is``."""
        named = " and ".join(f"`{target}`" for target in self.targets_named) or "the base"
        return f"the {self.noun} of {named} is"

    @property
    def begins(self) -> str:
        r"""A clause on when it begins, such as ``\`ball\` is nearer than 0.50 m (1.6 ft)``."""
        return f"{self.subject} {self.within}"

    @property
    def ends(self) -> str:
        """A clause on when it ends, such as ``its bearing is below 18.9°``."""
        return "that has not held"

    @property
    def within(self) -> str:
        """Its thresholds, such as ``nearer than 0.50 m (1.6 ft)``."""
        (low, high), (below, above) = self.limits, self.sides
        if math.isfinite(low) and math.isfinite(high):
            return f"between {figure_in_words(low, self.unit)} and {figure_in_words(high, self.unit)}"
        is_low = math.isfinite(low)
        return f"{above if is_low else below}{figure_in_words(low if is_low else high, self.unit)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:
        """Return the figure that it is judged by and the thresholds, in words.

        Args:
            is_on: As in `holds`.
            names_target: Whether to begin with the target.
            with_probability: Whether to add how likely it is, and from which probability on it begins or ends.
        """
        named = f"{self.targets_named[0]} " if names_target and self.targets_named else ""
        reading = self.reading(inputs, is_on)
        if reading is None:
            return self.unread(inputs, named)
        words = f"{named}{self.value_words(reading)}, {_threshold_words(reading, self.unit)}"
        if not with_probability or reading.probability is None:
            return words
        turns = f"ends at {self.probability_off:.2f}" if is_on else f"begins at {self.probability_on:.2f}"
        return f"{words}: P {reading.probability:.2f}, {turns}"

    def value_words(self, reading: JudgedFigure) -> str:
        """Return its figure in words, such as ``battery voltage 11.20 V``."""
        return f"{self.noun} {figure_in_words(reading.value, self.unit)}"

    def unread(self, inputs: RuleInputs, named: str) -> str:  # noqa: ARG002 - by some kinds
        """Return in words why there is no figure."""
        if not self.targets_named:
            return f"the base does not report its {self.noun}"
        return describe_unread([inputs.tracks[target] for target in self.targets_named], self.noun)


def describe_unread(tracks: Sequence[Track], noun: str) -> str:
    """Return in words why there is no figure of some targets."""
    return " and ".join(describe_unseen(track) for track in tracks if not track.is_valid) or f"the {noun} is not known"


def describe_unseen(track: Track) -> str:
    """Return in words that there is no distance to act on."""
    return f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"


def back_words(leaf: Leaf, deadband: float, sigmas: float) -> str:
    """Return where a condition ends, which a deadband, also in standard deviations, moves away from where it begins."""
    (low, high), (below, above) = leaf.limits, leaf.sides
    fixed = 0.0 if sigmas else deadband - (leaf.unit == "times")  # a count that ends is below n, above n - 1 no more
    there = [f"{below}{figure_in_words(low - fixed, leaf.unit)}"] if math.isfinite(low) else []
    there += [f"{above}{figure_in_words(high + fixed, leaf.unit)}"] if math.isfinite(high) else []
    if not sigmas:
        return " or ".join(there)
    noise = f"{sigmas:g} standard deviations of the noise"
    width = f"{deadband:g} {leaf.unit} or {noise}, whichever is more," if deadband else noise
    return f"{' or '.join(there)} by {width}"


def closing_words(closing_mps: float, sigma_mps: float) -> str:
    """Return a closing speed such as ``closing at 0.42 m/s ± 0.03``."""
    return f"closing at {closing_mps:.2f} m/s ± {sigma_mps:.2f}"


def _threshold_words(reading: JudgedFigure, unit: str) -> str:
    """Return the thresholds, with "not" before them where the figure by itself is not within."""
    is_within = "" if reading.low < reading.value < reading.high else "not "
    if math.isinf(reading.low):
        return f"{is_within}below {short_figure(reading.high, unit)}"
    if math.isinf(reading.high):
        return f"{is_within}above {short_figure(reading.low, unit)}"
    return f"{is_within}between {short_figure(reading.low, unit)} and {short_figure(reading.high, unit)}"
