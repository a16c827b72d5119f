"""All that a live view shows at one moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rich.text import Text

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.formatting import METRE, LengthUnit
from stadimeter.cli.glyphs import Glyphs
from stadimeter.cli.run_history import Sample
from stadimeter.core.decision import Event
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.message import Message


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """All that a live view shows at one moment.

    Attributes:
        title: What runs.
        unit: The unit of distances.
        record: The newest cycle; None before the first.
        started_s: The time of the first cycle, on the run's monotonic clock.
        frame_rate_hz: How many frames a second come.
        frame_age_s: How old the newest frame is; None before the first.
        looked_at: For each target that was not measured in the newest frame, what was looked at in vain, the most like
            it first.
        tilts_rad: How far each target that is flat, and was measured in the newest frame, is turned away.
        samples: The recent distances of each target, oldest first.
        events: The recent events, newest first.
        messages: What was sent to other programs and when, newest first.
        limits_m: Distances to mark in the chart of each target.
        trouble: What is wrong outside the loop, such as with the broker; empty if nothing.
    """

    title: str
    unit: LengthUnit = METRE
    record: CycleRecord | None = None
    started_s: float = 0.0
    frame_rate_hz: float = 0.0
    frame_age_s: float | None = None
    looked_at: Mapping[str, Sequence[RejectedCandidate]] = field(default_factory=dict)
    tilts_rad: Mapping[str, float] = field(default_factory=dict)
    samples: Mapping[str, Sequence[Sample]] = field(default_factory=dict)
    events: Sequence[Event] = ()
    messages: Sequence[tuple[float, Message]] = ()
    limits_m: Mapping[str, Sequence[float]] = field(default_factory=dict)
    trouble: str = ""


def heading(name: str, width: int, glyphs: Glyphs, *details: tuple[str, str]) -> Text:
    """Return a line across the screen with a name in it.

    Args:
        name: What comes below.
        width: How many columns the line takes.
        glyphs: The characters to draw with.
        details: More words behind the name, each with its style.

    Returns:
        The line.
    """
    line = Text.assemble((f"{glyphs.line} ", "dim"), (glyphs.words(name), "bold"), " ")
    for words, style in details:
        line.append(glyphs.words(words), style).append(" ")
    line.append(glyphs.line * max(0, width - line.cell_len), "dim")
    return glyphs.fit(line, width)
