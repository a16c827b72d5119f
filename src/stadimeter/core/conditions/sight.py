"""Conditions on what is in sight: whether a target is, and how many are."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_DURATION_S, MIN_QUANTITY
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs, Threshold
from stadimeter.core.conditions.limits import ends_of
from stadimeter.core.decision import SafetyMode
from stadimeter.core.words import duration, length


class PresenceCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on whether the target is in sight.

    Attributes:
        seen: True: holds while the target is tracked. False: holds while it is lost or was never seen.
        for_s: Only when that has been so for this long without a break.
        target: The target; empty for that of the rule.
    """

    seen: bool
    for_s: float = 0.0
    target: str = ""

    noun = "presence"
    is_by_cycle = is_on_sight = True

    @property
    def unit(self) -> str:
        """Seconds, for one that takes time."""
        return "s" if self.for_s else ""

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The time, for one that takes time; one that takes none is another condition, ``seen`` or ``lost``."""
        key = "seen" if self.seen else "lost"
        return (Threshold(key, "for_s", MIN_QUANTITY, MAX_DURATION_S),) if self.for_s else ()

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; see `Leaf.holds`."""
        track = inputs.tracks[self.target]
        if track.is_valid is not self.seen:
            return False
        return not self.for_s or (track.since_s is not None and inputs.now_s >= track.since_s + self.for_s)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds it has been so, for one that takes time."""
        if not self.for_s:
            return None
        track = inputs.tracks[self.target]
        is_so = track.is_valid is self.seen and track.since_s is not None
        held_s = inputs.now_s - track.since_s if is_so and track.since_s is not None else 0.0
        return JudgedFigure(value=held_s, low=self.for_s)

    @property
    def begins(self) -> str:
        """A clause on sight, and on the time."""
        since = f" for {duration(self.for_s)}" if self.for_s else ""
        return f"`{self.target}` is {'in' if self.seen else 'out of'} sight{since}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the state of the track, and since when; see `Leaf.verdict`."""
        track = inputs.tracks[self.target]
        words = f"{track.target} is {track.status.value}"
        if self.for_s and track.is_valid is self.seen and track.since_s is not None:
            words += f" for {inputs.now_s - track.since_s:.1f} s of {self.for_s:g} s"
        return words + (f": {track.reason}" if track.reason else "")


class CountCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on the number of targets in sight.

    Attributes:
        targets: Of these; empty for all.
        at_least: Holds with no fewer than this; None for no such threshold.
        at_most: Holds with no more than this.
        below_m: Only those that are nearer than this count; None for all that are in sight.
    """

    targets: tuple[str, ...] = ()
    at_least: int | None = None
    at_most: int | None = None
    below_m: float | None = None

    noun = "count"
    is_by_cycle = is_on_sight = True

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Those that it counts; empty for all."""
        return self.targets

    @property
    def where(self) -> str:
        """The place of those that count, in words."""
        return "in sight" if self.below_m is None else f"nearer than {length(self.below_m)}"

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`. Unknown while no fresh frame says what is in sight."""
        count = self.count(inputs)
        if count is None:
            return None
        least, most = self.at_least, self.at_most
        return (least is None or count >= least) and (most is None or count <= most)

    def count(self, inputs: RuleInputs) -> int | None:
        """Count its targets that are in sight, and near enough to count; None while the camera is stale."""
        if inputs.safety is SafetyMode.STALE:
            return None
        tracks = [inputs.tracks[target] for target in self.targets or inputs.tracks]
        if self.below_m is None:
            return sum([track.is_valid for track in tracks])
        return sum([track.is_valid and (track.distance_m or math.inf) < self.below_m for track in tracks])

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return the count; None where it is not known."""
        low, high = ends_of(self.at_least, self.at_most)
        count = self.count(inputs)
        return None if count is None else JudgedFigure(value=float(count), low=low, high=high)

    @property
    def begins(self) -> str:
        """A clause on the number, and of which targets."""
        least, most = self.at_least, self.at_most
        if least is None or most is None:
            number = f"at most {most}" if least is None else f"at least {least}"
        else:
            number = f"{least}" if least == most else f"{least} to {most}"
        counted = f"of {', '.join(f'`{each}`' for each in self.targets)}" if self.targets else "targets"
        return f"{number} {counted} are {self.where}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the number in sight; see `Leaf.verdict`."""
        pairs = (("at least", self.at_least), ("at most", self.at_most))
        thresholds = [f"{word} {limit}" for word, limit in pairs if limit is not None]
        counted = self.count(inputs)
        words = "unknown how many" if counted is None else f"{counted}"
        return f"{words} of {len(self.targets or inputs.tracks)} {self.where}, {' and '.join(thresholds)}"
