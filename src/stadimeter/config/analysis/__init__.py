"""The subject of an analysis: compiled rules, each beside its table in the file."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from stadimeter.config.draft import Draft
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.core.rule import AlarmRule

# Frames in a second where the camera does not say: what a small computer manages.
ASSUMED_RATE_HZ = 15.0


class Subject(Struct, frozen=True, kw_only=True):
    """Everything that an analysis needs.

    Attributes:
        rules: Its rules, in the order of the file; one of each table that names several targets.
        every_rule: The same with every rule of such tables.
    """

    draft: Draft
    rules: tuple[CompiledRule, ...]
    every_rule: tuple[CompiledRule, ...]

    @property
    def alarms(self) -> Iterator[tuple[CompiledRule, AlarmRule]]:
        """Every alarm; one of each table that names several targets."""
        return ((each, each.rule) for each in self.rules if isinstance(each.rule, AlarmRule))

    @property
    def leaves(self) -> Iterator[WrittenCondition]:
        """Every simple condition of its rules, those of gates and steps included."""
        return (leaf for each in self.rules for written in each.conditions() for leaf in written.leaves())


def subject_of(draft: Draft) -> Subject:
    """Return the parts of a configuration that can be looked at: all but the rules that cannot be read at all."""
    first = {each.section: each for each in reversed(draft.compiled)}
    return Subject(
        draft=draft,
        rules=tuple(each for each in draft.compiled if first[each.section] is each),
        every_rule=draft.compiled,
    )


def delay_s(alarm: AlarmRule, rate_hz: float) -> float:
    """Return the longest time for which a condition must hold in every frame before an alarm is raised, in seconds."""
    return alarm.on_delay.frames / rate_hz if alarm.on_delay.frames else alarm.on_delay.hold_s


def frame_rate_hz(draft: Draft) -> float:
    """Return the frame rate that the camera was asked for, or else `ASSUMED_RATE_HZ`."""
    rate_hz = getattr(draft.camera.options, "rate", None) if draft.camera else None
    return rate_hz if isinstance(rate_hz, float) and rate_hz > 0 else ASSUMED_RATE_HZ
