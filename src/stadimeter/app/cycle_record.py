"""What one cycle of the loop tells those who listen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, GetPydanticSchema

from stadimeter.core.command import Command
from stadimeter.core.decision import Decision
from stadimeter.core.detection import Detection, RejectedCandidate
from stadimeter.core.observation import Observation

_NotWritten = GetPydanticSchema(lambda _type, handler: handler(Any))
"""For what is in no journal: pydantic need not know how to write it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleRecord:
    """One cycle of the loop: what was known, what was decided, and what came of it.

    Attributes:
        observation: All that the core knew.
        applied: What the drivers applied, in the order of ``decision.commands``.
        timings_s: How long each part of the cycle took, in seconds: ``capture``, ``measure``, ``decide``, ``apply``.
        rejected: By target, what was looked at in the new frame and is not the target, the most like it first; only
            targets for which there is something. It explains, and decides nothing: it is in no journal.
        detections: Where each target is in the new frame, or why it is not there; empty without a frame. Likewise in
            no journal: it is drawn.
    """

    # What is broken is recorded as it was: null would replay to something else than NaN, and a bare NaN is no JSON.
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(ser_json_inf_nan="strings")

    observation: Observation
    applied: tuple[Command, ...]
    timings_s: Mapping[str, float]
    rejected: Mapping[str, tuple[RejectedCandidate, ...]] = field(default_factory=dict)
    detections: Annotated[tuple[Detection, ...], _NotWritten] = ()
    decision: Decision

    @property
    def busy_s(self) -> float:
        """How long it was computed, without the wait for the frame."""
        return sum(self.timings_s.values()) - self.timings_s.get("capture", 0.0)
