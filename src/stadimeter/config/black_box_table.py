"""The section ``[black_box]``: what a run keeps in memory, and writes around what happens."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from stadimeter.config.models import Section
from stadimeter.config.units import Bytes, Duration, Frequency


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
        """Return what it does, in words."""
        on = " and ".join(self.on) or "order"
        keeps = f"Keeps the last {self.before:g} s with pictures in at most {self.memory / 1e6:g} MB of memory"
        return f"{keeps}, and writes a clip on each {on}: {self.max_total / 1e6:g} MB of clips at most."
