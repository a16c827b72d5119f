"""Sections that a configuration may do without; of these, what a run keeps of itself, and its mounting."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from stadimeter.config.models import PlaceTable, SafetyTable, Section, TrackingTable, WebTable
from stadimeter.config.units import Bytes, Duration, Frequency
from stadimeter.core.clock import DAY_S

# How long a timeline is kept unless the configuration says otherwise, and the longest.
TIMELINE_S, TIMELINE_MAX_S = 7 * DAY_S, 31 * DAY_S


class RecordingTable(Section):
    """The things a run keeps by itself of what it saw and did."""

    last: Annotated[Duration, Field(ge=60.0, le=DAY_S)]
    """For how long at least it keeps each cycle, without pictures."""


class TimelineTable(Section):
    """The past that a run keeps for the timeline of the page: distances second by second, and states of rules."""

    keep: Annotated[Duration, Field(le=TIMELINE_MAX_S)] = TIMELINE_S
    """For how long; `"0 s"` keeps nothing."""


class MountingTable(Section):
    """Settings for watching that the camera stays where it was when its view was saved."""

    watch: bool | None = None
    """Whether it is watched; by default as soon as a view was saved."""
    when_moved: Literal["mark", "stop"] = "mark"
    """What happens beside the event: distances are marked as unconfirmed, or nothing moves either."""


class BlackBoxTable(Section):
    """The last seconds in memory, with pictures, of which a clip is written around what happens."""

    before: Annotated[Duration, Field(ge=1.0, le=600.0)] = 20.0
    """In seconds; how much a clip holds of what came before."""
    after: Annotated[Duration, Field(le=600.0)] = 10.0
    """In seconds; how much it holds of what comes after the last event."""
    on: list[Literal["alarm", "fault", "button"]] = Field(default=["alarm", "fault"])
    """What writes a clip by itself: an alarm that notifies people, a fault, the press of any button."""
    rate: Annotated[Frequency, Field(gt=0)] = 10.0
    """In hertz; the most pictures a second."""
    quality: Annotated[int, Field(ge=1, le=100)] = 80
    """Of their JPEGs, in percent."""
    memory: Annotated[Bytes, Field(ge=4e6, le=4e9)] = 64e6
    """In bytes; the most that it takes of the computer's memory."""
    max_total: Annotated[Bytes, Field(ge=10e6)] = 500e6
    """In bytes; while all clips together take more of the disk, the oldest is deleted."""

    def describe(self) -> str:
        """Describe what it does, in words."""
        on = " and ".join(self.on) or "order"
        keeps = f"Keeps the last {self.before:g} s with pictures in at most {self.memory / 1e6:g} MB of memory"
        return f"{keeps}, and writes a clip on each {on}: {self.max_total / 1e6:g} MB of clips at most."


# By the attribute of a draft that has each.
OPTIONAL_TABLES: dict[str, type[Section]] = {
    "tracking": TrackingTable,
    "safety": SafetyTable,
    "mounting": MountingTable,
    "web": WebTable,
    "place": PlaceTable,
    "recording": RecordingTable,
    "timeline": TimelineTable,
    "black_box": BlackBoxTable,
}
