"""What one cycle of the loop tells those who listen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stadimeter.core.command import Command
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleRecord:
    """One cycle of the loop: what was known, what was decided, and what came of it.

    Attributes:
        observation: All that the core knew.
        decision: What it decided.
        applied: What the drivers applied, in the order of ``decision.commands``.
        timings_s: How long each part of the cycle took, in seconds: ``capture``, ``detect``, ``decide``, ``apply``.
    """

    observation: Observation
    decision: Decision
    applied: tuple[Command, ...]
    timings_s: Mapping[str, float]
