"""A snapshot, and how the terminal shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stadimeter.app.live.snapshot import Snapshot
from stadimeter.cli.formatting import METRE, LengthUnit
from stadimeter.cli.keyboard import Key


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A snapshot, and how the terminal shows it.

    Attributes:
        keys: The keys that do something; None if the view is no more than looked at.
        is_paused: Whether a key holds the run up.
        is_explained: Whether the screen is explained instead of shown.
    """

    snapshot: Snapshot
    title: str
    unit: LengthUnit = METRE
    keys: Sequence[Key] | None = None
    is_paused: bool = False
    is_explained: bool = False
