"""Marks in recordings: where an alarm should have fired, and where not."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct

from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError, Problem

# A person who points at a moment is this far off.
MOMENT_S = 1.0

# An alarm goes on from one moment to another that is at most this much later; longer, and it would be another visit.
JOINED_S = 30.0

# When it was raised, and when it was cleared, since the beginning of the recording.
Firing = tuple[float, float]

_MARK = re.compile(r"(?P<recording>[^@]+)@(?P<from>[^@]+?)(?:\.\.(?P<to>[^@]+?))?\s+(?P<what>fire|no)")


class FiringMark(Struct, frozen=True, kw_only=True):
    """A moment or a span of a recording.

    A span that should have fired wants an alarm raised in it; a moment, one that stands. Where it should not have, no
    alarm may stand, except one that goes on from shortly before, and that another mark wants there.

    Attributes:
        recording: The name of its file.
        to_s: The end of a span; equal to `from_s` for a moment.
    """

    recording: str
    from_s: float
    to_s: float
    should_fire: bool

    @property
    def is_moment(self) -> bool:
        """True if it is a moment, not a span."""
        return self.from_s == self.to_s

    @property
    def words(self) -> str:
        """The mark as it is written for ``teach --mark``."""
        span = "" if self.is_moment else f"..{self.to_s:.4g}s"
        return f"{self.recording}@{self.from_s:.4g}s{span} {'fire' if self.should_fire else 'no'}"

    def touches(self, firing: Firing) -> bool:
        """Check whether an alarm stood in it, or nearly."""
        off_s = MOMENT_S if self.is_moment else 0.0
        return firing[0] <= self.to_s + off_s and firing[1] >= self.from_s - off_s

    def wants(self, firing: Firing) -> bool:
        """Check whether an alarm is the one that should have fired."""
        if not self.should_fire:
            return False
        return self.touches(firing) if self.is_moment else self.from_s <= firing[0] <= self.to_s

    def off(self, firing: Firing) -> float:
        """Return the distance of an alarm from the middle of a span, as a share of half of it; 0 for a moment."""
        return 0.0 if self.is_moment else abs(2 * firing[0] - self.from_s - self.to_s) / (self.to_s - self.from_s)


def parse_mark(text: str) -> FiringMark:
    """Read a mark such as ``run.mcap@14.2s fire`` or ``run.mcap@14s..20s no``; `ConfigError` if it is none."""
    hint = 'write a moment, "run.mcap@14.2s fire", or a span, "run.mcap@14s..20s no"'
    match = _MARK.fullmatch(text.strip())
    if match is None:
        raise ConfigError([Problem(f"{text!r} is no mark", hint=hint)])
    try:
        from_s, to_s = (parse_duration(each) for each in (match["from"], match["to"] or match["from"]))
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is no mark: {error}", hint=hint)]) from error
    if to_s < from_s:
        raise ConfigError([Problem(f"{text!r} ends before it begins", hint=hint)])
    return FiringMark(recording=match["recording"], from_s=from_s, to_s=to_s, should_fire=match["what"] == "fire")


def is_met(mark: FiringMark, firings: Sequence[Firing], marks: Sequence[FiringMark]) -> bool:
    """Check whether an alarm did what a mark says.

    Args:
        firings: Those in its recording.
        marks: All marks.
    """
    if mark.should_fire:
        return any(mark.wants(firing) for firing in firings)
    here = [each for each in marks if each.recording == mark.recording]
    before = [each for each in here if mark.from_s - JOINED_S <= each.from_s < mark.from_s]
    return not any(mark.touches(firing) and not any(each.wants(firing) for each in before) for firing in firings)
